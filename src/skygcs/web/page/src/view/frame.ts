// Latitude and longitude to metres of the fleet's frame and back, about the origin on WGS84. Pure.
// The daemon gives positions in the frame itself; this is for homes, maps, places chosen in the view, and fleets without an origin.

import type { MapPin, Origin, Vec3, VehicleState } from "../types.ts";

const SEMI_MAJOR_M = 6_378_137;
const ECCENTRICITY2 = 6.694379990141e-3;
const RAD = Math.PI / 180;
/** Each step divides the error of a place by its distance in earth radii: three give micrometres within 100 km. */
const STEPS = 3;
/** Two points of a vertical, so far apart, give its direction. */
const PLUMB_M = 10_000;
/** The cosine of 60 degrees: farther round the earth a plane about the origin says nothing of a place. */
const LEAST_RISE = 0.5;

export interface Frame extends Origin {
  /** No origin is set: the place of a vehicle stands in for it. */
  standIn: boolean;
  metresPerLatDeg: number;
  metresPerLonDeg: number;
  /** Of the origin, in the earth's own axes. */
  ecef: Vec3;
}

export function frameAt(origin: Origin, standIn = false): Frame {
  const sin = Math.sin(origin.lat_deg * RAD);
  const w = 1 - ECCENTRICITY2 * sin * sin;
  const alt_m = origin.alt_amsl_m;
  return {
    ...origin,
    standIn,
    metresPerLatDeg: ((SEMI_MAJOR_M * (1 - ECCENTRICITY2)) / w ** 1.5 + alt_m) * RAD,
    metresPerLonDeg: (SEMI_MAJOR_M / Math.sqrt(w) + alt_m) * Math.cos(origin.lat_deg * RAD) * RAD,
    ecef: ecefOf(origin.lat_deg, origin.lon_deg, alt_m),
  };
}

function ecefOf(lat_deg: number, lon_deg: number, alt_m: number): Vec3 {
  const [sinLat, cosLat] = [Math.sin(lat_deg * RAD), Math.cos(lat_deg * RAD)];
  const radius = SEMI_MAJOR_M / Math.sqrt(1 - ECCENTRICITY2 * sinLat * sinLat);
  const across = (radius + alt_m) * cosLat;
  return [across * Math.cos(lon_deg * RAD), across * Math.sin(lon_deg * RAD), (radius * (1 - ECCENTRICITY2) + alt_m) * sinLat];
}

/** x, y in metres of a place at the origin's altitude, as the station counts it (dropped.py, `WorldMap.xy`). */
export function fromGeodetic(frame: Frame, lat_deg: number, lon_deg: number): [number, number] {
  const [x, y] = fromEcef(frame, ecefOf(lat_deg, lon_deg, frame.alt_amsl_m));
  return [x, y];
}

function fromEcef(frame: Frame, [x, y, z]: Vec3): Vec3 {
  const [dx, dy, dz] = [x - frame.ecef[0], y - frame.ecef[1], z - frame.ecef[2]];
  const { sinLat, cosLat, sinLon, cosLon } = axesOf(frame);
  const outward = cosLon * dx + sinLon * dy;
  const [east, north] = [cosLon * dy - sinLon * dx, cosLat * dz - sinLat * outward];
  return [...turned(east, north, frame.x_heading_deg), cosLat * outward + sinLat * dz];
}

function axesOf({ lat_deg, lon_deg }: Frame): { sinLat: number; cosLat: number; sinLon: number; cosLon: number } {
  return { sinLat: Math.sin(lat_deg * RAD), cosLat: Math.cos(lat_deg * RAD), sinLon: Math.sin(lon_deg * RAD), cosLon: Math.cos(lon_deg * RAD) };
}

/** The place on earth of a drawn point: at x, y of the plane up = 0, as the station reads a drawing (dropped.py,
 *  `WorldMap.lat_lon`). Bowring's formula (Survey Review 23, 1976), one step. */
export function drawnToGeodetic(frame: Frame, x: number, y: number): { lat_deg: number; lon_deg: number } {
  const [east, north] = turned(x, y, 180 - frame.x_heading_deg);
  const { sinLat, cosLat, sinLon, cosLon } = axesOf(frame);
  const outward = -sinLat * north;
  const px = frame.ecef[0] + cosLon * outward - sinLon * east;
  const py = frame.ecef[1] + sinLon * outward + cosLon * east;
  const pz = frame.ecef[2] + cosLat * north;
  const axial = Math.hypot(px, py);
  const semiMinorM = SEMI_MAJOR_M * Math.sqrt(1 - ECCENTRICITY2);
  const reduced = Math.atan2(pz * SEMI_MAJOR_M, axial * semiMinorM);
  const second2 = ECCENTRICITY2 / (1 - ECCENTRICITY2);
  const lat = Math.atan2(pz + second2 * semiMinorM * Math.sin(reduced) ** 3, axial - ECCENTRICITY2 * SEMI_MAJOR_M * Math.cos(reduced) ** 3);
  return { lat_deg: lat / RAD, lon_deg: Math.atan2(py, px) / RAD };
}

/** The inverse of `drawnToGeodetic`; null: the plane does not pass over the place, on another side of the earth. */
export function geodeticToDrawn(frame: Frame, lat_deg: number, lon_deg: number): [number, number] | null {
  const low = fromEcef(frame, ecefOf(lat_deg, lon_deg, 0));
  const high = fromEcef(frame, ecefOf(lat_deg, lon_deg, PLUMB_M));
  const rises = (high[2] - low[2]) / PLUMB_M; // the cosine between the two verticals
  if (rises < LEAST_RISE) return null;
  const share = -low[2] / rises / PLUMB_M;
  return [low[0] + (high[0] - low[0]) * share, low[1] + (high[1] - low[1]) * share];
}

/** The place at the origin's altitude that has x, y; the inverse of `fromGeodetic`. */
export function toGeodetic(frame: Frame, x: number, y: number): { lat_deg: number; lon_deg: number } {
  let lat_deg = frame.lat_deg;
  let lon_deg = frame.lon_deg;
  const turn = (90 - frame.x_heading_deg) * RAD;
  for (let step = 0; step <= STEPS; step++) {
    const [isX, isY] = fromGeodetic(frame, lat_deg, lon_deg);
    const [dx, dy] = [x - isX, y - isY];
    lat_deg += (dx * Math.sin(turn) + dy * Math.cos(turn)) / frame.metresPerLatDeg;
    lon_deg = wrapDeg(lon_deg + (dx * Math.cos(turn) - dy * Math.sin(turn)) / frame.metresPerLonDeg);
  }
  return { lat_deg, lon_deg };
}

/** A vector of true east and north along the frame's axes. */
export function turned(east: number, north: number, xHeadingDeg: number): [number, number] {
  const turn = (90 - xHeadingDeg) * RAD;
  return [east * Math.cos(turn) + north * Math.sin(turn), -east * Math.sin(turn) + north * Math.cos(turn)];
}

function wrapDeg(deg: number): number {
  return ((((deg + 180) % 360) + 360) % 360) - 180;
}

/** Where a vehicle is in the frame; null if it is not known. */
export function placeOf(frame: Frame | null, vehicle: Pick<VehicleState, "position">): Vec3 | null {
  const position = vehicle.position;
  if (position === null) return null;
  if (position.enu_m !== null) return position.enu_m;
  if (frame === null || position.lat_deg === null || position.lon_deg === null) return null;
  const [x, y] = fromGeodetic(frame, position.lat_deg, position.lon_deg);
  return [x, y, position.alt_rel_m ?? 0];
}

/** Its horizontal velocity along the frame's axes. */
export function velocityOf(frame: Frame | null, vehicle: Pick<VehicleState, "position">): Vec3 | null {
  const position = vehicle.position;
  if (position === null) return null;
  if (position.vel_world_mps !== null) return position.vel_world_mps;
  if (frame === null || position.vel_enu_mps === null) return null;
  const [east, north, up] = position.vel_enu_mps;
  return [...turned(east, north, frame.x_heading_deg), up];
}

/** Its nose, radians from the x axis, counter-clockwise; null if it is not known. */
export function yawOf(frame: Frame | null, vehicle: Pick<VehicleState, "position" | "attitude">): number | null {
  const yaw = vehicle.position?.yaw_world_deg;
  if (yaw !== null && yaw !== undefined) return yaw * RAD;
  const heading = vehicle.position?.heading_deg ?? vehicle.attitude?.yaw_deg;
  return heading === undefined ? null : ((frame?.x_heading_deg ?? 90) - heading) * RAD;
}

/** Six numbers of a canvas transform: pixels of an image to metres of the frame. */
export interface ImagePlacement {
  a: number;
  b: number;
  c: number;
  d: number;
  e: number;
  f: number;
}

/** Where an image lies that two points pin: moved, turned and scaled, never sheared. Null if the points are one. */
export function placeImage(frame: Frame, pins: readonly [MapPin, MapPin]): ImagePlacement | null {
  const [p, q] = pins;
  const [px, py] = fromGeodetic(frame, p.lat_deg, p.lon_deg);
  const [qx, qy] = fromGeodetic(frame, q.lat_deg, q.lon_deg);
  // the image's y runs down: its points are x - iy
  const dx = q.x_px - p.x_px;
  const dy = -(q.y_px - p.y_px);
  const length2 = dx * dx + dy * dy;
  if (length2 === 0) return null;
  const re = ((qx - px) * dx + (qy - py) * dy) / length2;
  const im = ((qy - py) * dx - (qx - px) * dy) / length2;
  if (re === 0 && im === 0) return null;
  return { a: re, b: im, c: im, d: -re, e: px - re * p.x_px - im * p.y_px, f: py - im * p.x_px + re * p.y_px };
}
