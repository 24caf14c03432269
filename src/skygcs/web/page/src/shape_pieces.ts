// Squares, circles and paths as trajectories: pieces of polynomials for trajectory.load, from rest to rest. Pure.

import type { Vec3 } from "./types.ts";

/** A piece as trajectory.load takes it: ascending coefficients of the seconds since it began. */
export interface Piece {
  duration_s: number;
  x: readonly number[];
  y: readonly number[];
  up: readonly number[];
}

/** Along the path, and across it on a circle: together 1.4 m/s², half of what control.trajectory.acceleration_mps2 allows. */
const MOST_ACC_MPS2 = 1;
/** Of 10 s³ - 15 s⁴ + 6 s⁵ from 0 to 1 in 1 s: the largest speed, and acceleration. */
const PEAK_SPEED = 1.875;
const PEAK_ACC = 10 / Math.sqrt(3);
/** Of 3 s² - 2 s³, with which the speed on a circle grows and falls: its steepest. */
const PEAK_RAMP = 1.5;
/** A piece of a circle turns by so much at most: it is off the circle by less than a ten-thousandth of the radius. */
const MOST_TURN_RAD = Math.PI / 9;
/** Shorter legs are none. */
const LEAST_LEG_M = 0.01;

/** Straight legs from point to point with a stop at each; speed: the largest on the way. */
export function pathPieces(points: readonly Vec3[], speed: number): Piece[] {
  return points.slice(1).flatMap((to, n) => {
    const from = points[n] ?? to;
    const legM = Math.hypot(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
    if (legM < LEAST_LEG_M) return [];
    const duration_s = Math.max((PEAK_SPEED * legM) / speed, Math.sqrt((PEAK_ACC * legM) / MOST_ACC_MPS2));
    const axis = (k: 0 | 1 | 2): number[] => {
      const by = to[k] - from[k];
      return [from[k], 0, 0, (10 * by) / duration_s ** 3, (-15 * by) / duration_s ** 4, (6 * by) / duration_s ** 5];
    };
    return [{ duration_s, x: axis(0), y: axis(1), up: axis(2) }];
  });
}

/** Corners of a square with the start at its corner of least x and y, counter-clockwise, back to the start. */
export function squarePoints([x, y, up]: Vec3, sideM: number, laps: number): Vec3[] {
  const lap: Vec3[] = [[x + sideM, y, up], [x + sideM, y + sideM, up], [x, y + sideM, up], [x, y, up]];
  return [[x, y, up], ...Array.from({ length: laps }, () => lap).flat()];
}

/** A circle whose point of least x is the start, counter-clockwise; it is slower where its radius asks for it. */
export function circlePieces([x, y, up]: Vec3, radiusM: number, speed: number, laps: number): Piece[] {
  const turnRad = 2 * Math.PI * laps;
  const lengthM = turnRad * radiusM;
  const most = Math.min(speed, Math.sqrt(MOST_ACC_MPS2 * radiusM), Math.sqrt((lengthM * MOST_ACC_MPS2) / PEAK_RAMP));
  const ramp_s = (PEAK_RAMP * most) / MOST_ACC_MPS2;
  const end_s = lengthM / most + ramp_s;
  const times = knots([0, ramp_s, end_s - ramp_s, end_s], (MOST_TURN_RAD * radiusM) / most);
  const at = (t: number): Knot => onCircle(alongAt(t, most, ramp_s, end_s, lengthM), [x + radiusM, y], radiusM);
  return times.slice(1).map((to_s, n) => {
    const from_s = times[n] ?? 0;
    const [from, to, duration_s] = [at(from_s), at(to_s), to_s - from_s];
    return { duration_s, x: joining(from[0], to[0], duration_s), y: joining(from[1], to[1], duration_s), up: [up] };
  });
}

/** Place, speed and acceleration along one axis. */
type Motion = readonly [number, number, number];
type Knot = readonly [Motion, Motion];

/** Metres along the circle: the speed grows, stays, and falls as it grew. */
function alongAt(t: number, most: number, ramp_s: number, end_s: number, lengthM: number): Motion {
  if (t > end_s / 2) {
    const [s, v, a] = alongAt(end_s - t, most, ramp_s, end_s, lengthM);
    return [lengthM - s, v, -a];
  }
  if (t >= ramp_s) return [most * (t - ramp_s / 2), most, 0];
  const u = t / ramp_s;
  return [most * ramp_s * (u ** 3 - u ** 4 / 2), most * (3 * u * u - 2 * u ** 3), (most / ramp_s) * (6 * u - 6 * u * u)];
}

/** From the point of least x, counter-clockwise. */
function onCircle([s, v, a]: Motion, [cx, cy]: readonly [number, number], radiusM: number): Knot {
  const angle = Math.PI + s / radiusM;
  const [c, d] = [Math.cos(angle), Math.sin(angle)];
  const inward = (v * v) / radiusM;
  return [[cx + radiusM * c, -v * d, -a * d - inward * c], [cy + radiusM * d, v * c, a * c - inward * d]];
}

/** The times, and between them as many more that none is further apart than that. */
function knots(times: readonly number[], most_s: number): number[] {
  return times.flatMap((to, n) => {
    const from = times[n - 1];
    if (from === undefined) return [to];
    if (to - from < 1e-6) return [];
    const count = Math.ceil((to - from) / most_s);
    return Array.from({ length: count }, (_, i) => from + ((to - from) * (i + 1)) / count);
  });
}

/** The quintic with these motions at its ends. */
function joining([p, v, a]: Motion, [q, w, b]: Motion, T: number): number[] {
  const d = q - p;
  return [
    p,
    v,
    a / 2,
    (20 * d - (8 * w + 12 * v) * T - (3 * a - b) * T * T) / (2 * T ** 3),
    (-30 * d + (14 * w + 16 * v) * T + (3 * a - 2 * b) * T * T) / (2 * T ** 4),
    (12 * d - 6 * (w + v) * T - (a - b) * T * T) / (2 * T ** 5),
  ];
}

/** Points along the pieces, for a picture. */
export function pointsAlong(pieces: readonly Piece[], each: number): Vec3[] {
  const value = (coefficients: readonly number[], t: number): number => coefficients.reduceRight((sum, c) => sum * t + c, 0);
  return pieces.flatMap(({ duration_s, x, y, up }, n) =>
    Array.from({ length: n === 0 ? each + 1 : each }, (_, i): Vec3 => {
      const t = (duration_s * (n === 0 ? i : i + 1)) / each;
      return [value(x, t), value(y, t), value(up, t)];
    }),
  );
}

export function durationOf(pieces: readonly Piece[]): number {
  return pieces.reduce((sum, { duration_s }) => sum + duration_s, 0);
}
