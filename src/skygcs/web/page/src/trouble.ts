// What is wrong with a vehicle, worst first: the one place that decides it, for strip, table and counts. Pure.

import { ageText, fixed } from "./format.ts";
import { isHeardAfter, silenceOf, type Vehicle } from "./store.ts";
import type { Separation } from "./types.ts";

export type Severity = "danger" | "warning";

export interface Trouble {
  name: string;
  severity: Severity;
  text: string;
  /** The parts of the text, the worst first. */
  reasons: readonly string[];
}

export const LOW_BATTERY_PERCENT = 25;
export const EMPTY_BATTERY_PERCENT = 10;

/** One name for it everywhere: it sends, and answers nothing of ours. */
export const DEAF = "does not hear us";

export function isInAir({ landed }: Pick<Vehicle, "landed">): boolean {
  return landed === "in_air" || landed === "takeoff" || landed === "landing";
}

/** What needs a person, besides not being heard; the server counts the same (fleet_digest.py). */
export function isProblem(v: Vehicle): boolean {
  return reasonsOf(v).some((reason) => reason !== "");
}

/** The vehicle that it is dangerously near to. */
export function nearTo({ separation }: Pick<Vehicle, "separation">): Separation | null {
  return separation !== null && separation.level !== "notice" ? separation : null;
}

/** What is wrong with a vehicle that is heard, each in a place of its own and the worst first; "": it is not. */
function reasonsOf(v: Vehicle): string[] {
  const near = nearTo(v);
  const percent = v.battery?.percent ?? 100;
  return [
    v.failsafe ? "failsafe" : "",
    near === null ? "" : `near ${near.with}${near.distance_m === undefined ? "" : `, ${fixed(near.distance_m, 1) ?? "?"} m`}`,
    v.uplink?.heard === false ? DEAF : "",
    percent <= EMPTY_BATTERY_PERCENT ? `battery ${fixed(percent, 0) ?? "?"} %` : "",
  ];
}

/** What is wrong with this vehicle; null: nothing that anybody knows of. One that was never heard is in no trouble. */
export function troubleOf(v: Vehicle, now_s: number): Trouble | null {
  return ranked(v, now_s)?.trouble ?? null;
}

/** By which vehicles are sorted, the worst first: lost in the air, then what is wrong with those that are heard, then
 *  silence on the ground; Infinity without trouble. */
export function troubleRank(v: Vehicle, now_s: number): number {
  return ranked(v, now_s)?.rank ?? Infinity;
}

/** All that are in trouble, by `troubleRank`. */
export function troublesOf(vehicles: readonly Vehicle[], now_s: number): Trouble[] {
  const found = vehicles.flatMap((v) => ranked(v, now_s) ?? []);
  return found.sort((a, b) => a.rank - b.rank).map(({ trouble }) => trouble);
}

/** It was in the air when it was last heard, and may still be. */
export function isLostInAir(v: Vehicle, now_s: number): boolean {
  const silence = silenceOf(v, now_s);
  return silence !== null && !isHeardAfter(v, silence) && isInAir(v);
}

const LOST_RANK = -1;
const SILENT_RANK = 100;

function ranked(v: Vehicle, now_s: number): { rank: number; trouble: Trouble } | null {
  const made = (rank: number, severity: Severity, reasons: readonly string[]) => ({ rank, trouble: { name: v.name, severity, text: reasons.join(", "), reasons } });
  const silence = silenceOf(v, now_s);
  if (!isHeardAfter(v, silence)) {
    if (silence === null) return null;
    if (!isInAir(v)) return made(SILENT_RANK, "warning", ["not heard", ageText(silence)]);
    const height = fixed(v.position?.alt_rel_m, 1);
    return made(LOST_RANK, "danger", [`lost ${height === null ? "in the air" : `at ${height} m`}`, ageText(silence)]);
  }
  const reasons = reasonsOf(v);
  const worst = reasons.findIndex((reason) => reason !== "");
  return worst < 0 ? null : made(worst, "danger", reasons.filter(Boolean));
}
