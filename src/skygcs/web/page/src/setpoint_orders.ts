// Flight by skygcs' own setpoints: whether a vehicle is flown so, what it is kept at, and the order that engages it.

import type { Connection } from "./connection.ts";
import { fixed } from "./format.ts";
import { sendOrder } from "./orders.ts";
import type { Store, Vehicle } from "./store.ts";
import type { Vec3 } from "./types.ts";

/** The daemon sends setpoints to it, or begins to. */
export function isFlown(vehicle: Pick<Vehicle, "control"> | undefined): boolean {
  return vehicle?.control != null && vehicle.control.state !== "off";
}

/** The place that its setpoints hold or follow; null: it is not flown so, or an axis follows a velocity. */
export function keptPlace(vehicle: Pick<Vehicle, "control"> | undefined): Vec3 | null {
  if (vehicle === undefined || !isFlown(vehicle)) return null;
  const [x, y, up] = vehicle.control?.reference?.pos_enu_m ?? [];
  return x == null || y == null || up == null ? null : [x, y, up];
}

/** Where the daemon keeps these vehicles, in a line; empty: it sends setpoints to none of them. */
export function keptText(vehicles: readonly Vehicle[]): string {
  const flown = vehicles.filter(isFlown);
  const [one] = flown;
  if (one === undefined) return "";
  const of = vehicles.length === 1 ? "" : `${flown.length} of ${vehicles.length}: `;
  const place = keptPlace(one);
  const trajectory = trajectoryOf(one);
  if (trajectory !== null && isOnTrajectory(one)) return `${of}on ${trajectory.name}, ${trajectory.state}`;
  if (flown.length > 1) return `${of}setpoints are sent until Off`;
  return place === null ? `${of}setpoints are sent until Off` : `${of}kept at ${place.map((value) => fixed(value, 1) ?? "–").join(", ")} m until Off`;
}

/** What it flies of a trajectory, in the daemon's words. */
export function trajectoryOf({ control }: Pick<Vehicle, "control">): { name: string; state: string } | null {
  const found = control?.["trajectory"];
  return typeof found === "object" && found !== null && "name" in found && "state" in found ? { name: String(found.name), state: String(found.state) } : null;
}

const OVER = ["aborted", "finished"];

/** It is on a trajectory, or waits or stands on one. */
export function isOnTrajectory(vehicle: Pick<Vehicle, "control"> | undefined): boolean {
  const found = vehicle === undefined ? null : trajectoryOf(vehicle);
  return found !== null && !OVER.includes(found.state);
}

/** Has setpoints fly those that they do not fly yet, by place. True if all of them are flown then. */
export async function engage(store: Store, connection: Connection, targets: readonly string[]): Promise<boolean> {
  const idle = targets.filter((name) => !isFlown(store.state.vehicles.get(name)));
  if (idle.length === 0) return true;
  const request = { label: "Fly by position setpoints", method: "control.set", params: { mode: "position" }, targets: idle };
  return (await sendOrder(store, connection, request)) === "done";
}
