// What the view shows at one moment: each vehicle's place, nose, colour and label, worked out from the store. Pure.

import { siteOf } from "../levels.ts";
import { isFlown } from "../setpoint_orders.ts";
import { ageOf, isHeard, serverNowS, type State, type Vehicle } from "../store.ts";
import type { Separation, Vec3 } from "../types.ts";
import { troubleOf, type Trouble } from "../trouble.ts";
import { fixed } from "../format.ts";
import { placeOf, velocityOf, yawOf, type Frame } from "./frame.ts";
import { VEHICLE_COLOURS } from "./palette.ts";

/** A place is carried on with its velocity for so long: between two reports, not through a silence. */
const CARRIED_S = 0.5;
const MOVING_MPS = 0.1;

export interface Body {
  name: string;
  vehicle: Vehicle;
  x: number;
  y: number;
  z: number;
  yawRad: number | null;
  speedMps: number | null;
  heard: boolean;
  armed: boolean;
  trouble: Trouble | null;
  /** It was in the air when it was last heard: shown like one that is, not grey. */
  lostInAir: boolean;
  selected: boolean;
  /** Index into the palette's vehicle colours: one for each vehicle, or for each site where there are several. */
  colour: number;
  conflict: Separation | null;
  /** Where it is sent, as far as the page knows. */
  goal: Vec3 | null;
}

export interface Scene {
  bodies: readonly Body[];
  /** Of the vehicles that are carried on, along the ground and up or down; 0: nothing moves before the next report. */
  acrossMps: number;
  upMps: number;
  /** Some vehicle that is heard moves with its reports only: it is not carried on between them. */
  jumps: boolean;
}

/** Every vehicle with a known place. `carry`: to where it is now, instead of where it was last heard. */
export function sceneOf(state: State, frame: Frame | null, nowMs: number, carry: boolean): Scene {
  const now_s = serverNowS(state, nowMs);
  const bodies: Body[] = [];
  let [acrossMps, upMps, jumps] = [0, 0, false];
  const bySite = state.sites.length > 1;
  state.names.forEach((name, index) => {
    const vehicle = state.vehicles.get(name);
    if (vehicle === undefined) return;
    const place = placeOf(frame, vehicle);
    if (place === null) return;
    const heard = isHeard(vehicle, now_s);
    const trouble = troubleOf(vehicle, now_s);
    const velocity = velocityOf(frame, vehicle);
    const speedMps = velocity === null ? null : Math.hypot(velocity[0], velocity[1]);
    if (heard && (!carry || velocity === null)) jumps = true;
    let [x, y, z] = place;
    if (carry && heard && velocity !== null && Math.hypot(...velocity) > MOVING_MPS) {
      const age = Math.min(ageOf(vehicle, vehicle.position, now_s) ?? 0, CARRIED_S);
      if (age < CARRIED_S) [acrossMps, upMps] = [Math.max(acrossMps, speedMps ?? 0), Math.max(upMps, Math.abs(velocity[2]))];
      x += velocity[0] * age;
      y += velocity[1] * age;
      z += velocity[2] * age;
    }
    bodies.push({
      name,
      vehicle,
      x,
      y,
      z,
      yawRad: yawOf(frame, vehicle),
      speedMps,
      heard,
      armed: vehicle.armed === true,
      trouble,
      lostInAir: !heard && trouble?.severity === "danger",
      selected: state.selection.has(name),
      colour: (bySite ? state.sites.indexOf(siteOf(name)) : index) % VEHICLE_COLOURS,
      conflict: heard ? vehicle.separation : null,
      goal: goalOf(vehicle) ?? state.goals.get(name) ?? null,
    });
  });
  return { bodies, acrossMps, upMps, jumps };
}

/** The place that skygcs' own control steers to; null for axes that follow a velocity. */
function goalOf(vehicle: Vehicle): Vec3 | null {
  const [x, y, z] = isFlown(vehicle) ? (vehicle.control?.reference?.pos_enu_m ?? []) : [];
  return x == null || y == null ? null : [x, y, z ?? 0];
}

/** The second line of a label: what is wrong, else height above home and speed. */
export function labelLine(body: Body): string {
  if (body.trouble !== null && (!body.heard || body.trouble.severity === "danger")) return body.trouble.text;
  if (!body.heard) return "never heard";
  const height = fixed(body.vehicle.position?.alt_rel_m ?? null, 1);
  const speed = fixed(body.speedMps, 1);
  if (height === null) return "";
  return speed === null ? `${height} m` : `${height} m  ${speed} m/s`;
}

/** All that is drawn of a scene, places in quarters of a pixel of the screen: equal texts are equal pictures. Null: it moves by
 *  itself, or two are about to meet. */
export function pictureOf({ bodies, acrossMps, upMps }: Scene, pxPerM: number): string | null {
  if (acrossMps > 0 || upMps > 0 || bodies.some(({ conflict }) => conflict !== null)) return null;
  const px = (m: number): number => Math.round(m * pxPerM * 4);
  return JSON.stringify(
    bodies.map((body) => ({
      ...body,
      vehicle: null, // of it the label is drawn
      speedMps: null,
      x: px(body.x),
      y: px(body.y),
      z: px(body.z),
      yawRad: body.yawRad === null ? null : Math.round(body.yawRad * 100),
      goal: body.goal?.map((m) => px(m)),
      label: labelLine(body),
    })),
  );
}

/** Two vehicles that are about to meet, once, with where they will be then. */
export interface Meeting {
  a: Body;
  b: Body;
  separation: Separation;
  /** The middle between them at their closest. */
  x: number;
  y: number;
}

export function meetingsOf(scene: Scene, frame: Frame | null): Meeting[] {
  const byName = new Map(scene.bodies.map((body) => [body.name, body]));
  const meetings: Meeting[] = [];
  for (const a of scene.bodies) {
    if (a.conflict === null) continue;
    const b = byName.get(a.conflict.with);
    if (b === undefined || (b.conflict?.with === a.name && b.name < a.name)) continue;
    const t = a.conflict.closest_in_s ?? 0;
    const u = velocityOf(frame, a.vehicle) ?? [0, 0, 0];
    const v = velocityOf(frame, b.vehicle) ?? [0, 0, 0];
    meetings.push({ a, b, separation: a.conflict, x: (a.x + u[0] * t + b.x + v[0] * t) / 2, y: (a.y + u[1] * t + b.y + v[1] * t) / 2 });
  }
  return meetings;
}
