// The state of the daemon's plan as a person reads it. Pure.

import type { PlanStatus } from "./types.ts";

/** Nothing is being flown. */
export const AT_REST = new Set(["none", "loaded", "checked", "aborted", "landed", "finished"]);

/** Its reason says what went wrong; in every other state it says what is being done. */
export const FAILED = new Set(["stopped", "aborting", "aborted"]);

/** It ended as it was ordered: no step is left. */
const DONE = new Set(["landed", "finished"]);

/** It can be resumed. */
export const HALTED = new Set(["paused", "stopped"]);

/** "running, cross (step 2 of 3), 34 s left" */
export function planText(status: PlanStatus): string {
  const { state, phase, step, steps, clock } = status;
  const words = state.replaceAll("_", " ");
  if (DONE.has(state)) return words;
  const where = phase === null || phase === "" ? "" : `, ${phase}`;
  const which = steps > 0 ? ` (step ${step} of ${steps})` : "";
  const left = clock?.finishes_in_s == null ? "" : `, ${clock.finishes_in_s.toFixed(0)} s left`;
  return words + where + which + left;
}

export interface PlanError {
  vehicle: string;
  error_m: number;
  tube_m: number;
}

/** Of the vehicle that has used up the largest share of what it is allowed; null: no error is known. */
export function largestError({ vehicles }: Pick<PlanStatus, "vehicles">): PlanError | null {
  const known = vehicles.flatMap(({ vehicle, error_m, tube_m, left }) =>
    left === null && error_m !== null && tube_m !== null && tube_m > 0 ? [{ vehicle, error_m, tube_m }] : []);
  return known.sort((a, b) => b.error_m / b.tube_m - a.error_m / a.tube_m)[0] ?? null;
}
