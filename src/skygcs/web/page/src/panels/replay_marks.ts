// The events that are marked on the bar of a recording, and the next one in either direction. Pure.

import type { FleetEvent } from "../types.ts";

export interface Mark {
  at_s: number;
  event: FleetEvent;
}

/** The last one that is not after a time. `marks` are in the order of time. */
export function markBefore(marks: readonly Mark[], at_s: number): Mark | null {
  return marks.filter((mark) => mark.at_s <= at_s).at(-1) ?? null;
}

export function markAfter(marks: readonly Mark[], at_s: number): Mark | null {
  return marks.find((mark) => mark.at_s > at_s) ?? null;
}
