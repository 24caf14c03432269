// Flight by skygcs' own setpoints: whether a vehicle is flown so, what it is kept at, and the order that engages it.

import type { Connection } from "./connection.ts";
import { fixed } from "./format.ts";
import { type OrderChain, sendOrder } from "./orders.ts";
import type { Store, Vehicle } from "./store.ts";
import type { Vec3 } from "./types.ts";

type Controlled = Pick<Vehicle, "control"> | undefined;

/** It flies by the daemon's setpoints. */
export function isFlying(vehicle: Controlled): boolean {
  return vehicle?.control?.state === "flying";
}

/** The daemon begins to fly it by setpoints. */
export function isEngaging(vehicle: Controlled): boolean {
  return vehicle?.control?.state === "engaging";
}

/** The guard has ended control, and nothing is sent to it. */
export function isHeld(vehicle: Controlled): boolean {
  return vehicle?.control?.state === "held";
}

/** The daemon sends setpoints to it, or begins to. */
export function isFlown(vehicle: Controlled): boolean {
  return isFlying(vehicle) || isEngaging(vehicle);
}

/** There is something that Off ends: setpoints, or the guard's hold. */
export function isControlled(vehicle: Controlled): boolean {
  return isFlown(vehicle) || isHeld(vehicle);
}

/** The place that its setpoints hold or follow; null: it is not flown so, or an axis follows a velocity. */
export function keptPlace(vehicle: Controlled): Vec3 | null {
  if (vehicle === undefined || !isFlown(vehicle)) return null;
  const [x, y, up] = vehicle.control?.reference?.pos_enu_m ?? [];
  return x == null || y == null || up == null ? null : [x, y, up];
}

/** Where the daemon keeps these vehicles and what the guard holds, in a line; empty: there is neither. */
export function keptText(vehicles: readonly Vehicle[]): string {
  const of = (count: number): string => (vehicles.length === 1 ? "" : `${count} of ${vehicles.length}: `);
  const flown = vehicles.filter(isFlown);
  const held = vehicles.filter(isHeld);
  const parts = [
    ...(flown.length === 0 ? [] : [of(flown.length) + sentText(flown)]),
    ...(held.length === 0 ? [] : [`${of(held.length)}held by the guard, no setpoints are sent`]),
  ];
  return parts.join("; ");
}

function sentText(flown: readonly Vehicle[]): string {
  const [one] = flown;
  const place = keptPlace(one);
  const trajectory = one === undefined ? null : trajectoryOf(one);
  if (trajectory !== null && isOnTrajectory(one)) return `on ${trajectory.name}, ${trajectory.state}`;
  if (flown.every(isEngaging)) return "setpoints begin";
  if (flown.length > 1 || place === null) return "setpoints are sent until Off";
  return `kept at ${place.map((value) => fixed(value, 1) ?? "–").join(", ")} m until Off`;
}

/** What it flies of a trajectory, in the daemon's words. */
export function trajectoryOf({ control }: Pick<Vehicle, "control">): { name: string; state: string } | null {
  const found = control?.["trajectory"];
  return typeof found === "object" && found !== null && "name" in found && "state" in found ? { name: String(found.name), state: String(found.state) } : null;
}

const OVER = ["aborted", "finished"];

/** It is on a trajectory, or waits or stands on one. */
export function isOnTrajectory(vehicle: Controlled): boolean {
  const found = vehicle === undefined || !isFlown(vehicle) ? null : trajectoryOf(vehicle);
  return found !== null && !OVER.includes(found.state);
}

export function isPaused(vehicle: Controlled): boolean {
  return vehicle !== undefined && trajectoryOf(vehicle)?.state === "paused";
}

/** It is on a trajectory that goes on. */
export function canPause(vehicle: Controlled): boolean {
  return isOnTrajectory(vehicle) && !isPaused(vehicle);
}

/** Has setpoints fly those that they do not fly yet, by place; those that the guard holds, or that are only being engaged,
 *  are engaged anew. True if all of them are flown then. */
export async function engage(store: Pick<Store, "state" | "dispatch">, connection: Pick<Connection, "order">, targets: readonly string[], chain?: OrderChain): Promise<boolean> {
  const idle = targets.filter((name) => !isFlying(store.state.vehicles.get(name)));
  if (idle.length === 0) return true;
  const request = { label: "Fly by position setpoints", method: "control.set" as const, params: { mode: "position" as const }, targets: idle, chain };
  return (await sendOrder(store, connection, request)) === "done";
}
