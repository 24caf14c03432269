// Faults of simulated vehicles: what the daemon says of them, and the orders that begin and end them.

import type { Connection } from "./connection.ts";
import { sendOrder } from "./orders.ts";
import type { Store } from "./store.ts";

export interface DrillFault {
  fault: string;
  text: string;
  /** Of its value; null: it has none. */
  unit: string | null;
  default: number | null;
  least: number;
  most: number;
}

export interface ActiveFault {
  vehicle: string;
  fault: string;
  /** With its value: "wind, 8 m/s". */
  text: string;
  value: number | null;
  lasts_s: number;
}

export interface DrillsStatus {
  simulated: readonly string[];
  faults: readonly DrillFault[];
  active: readonly ActiveFault[];
}

export const STATUS = "drills.status";
export const STATUS_EVERY_MS = 1_000;

export function beginFault(store: Store, connection: Connection, targets: readonly string[], { fault, text }: DrillFault, value: number | null): void {
  void sendOrder(store, connection, { label: `Drill: ${text}`, method: "drills.begin", params: { fault, value }, targets });
}

/** `fault` null: all that last in them. */
export function endFault(store: Store, connection: Connection, targets: readonly string[], fault: string | null, text: string): void {
  void sendOrder(store, connection, { label: `End of the drill: ${text}`, method: "drills.end", params: { fault }, targets });
}
