// What is wrong with a vehicle, worst first: the one place that decides it, for strip, table and counts. Pure.

import { ageText, fixed } from "./format.ts";
import { isHeard, silenceOf, type Vehicle } from "./store.ts";
import type { Separation } from "./types.ts";

export type Severity = "danger" | "warning";

export interface Trouble {
  name: string;
  severity: Severity;
  text: string;
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

/** All that are in trouble, worst first: lost in the air, then what is wrong with those that are heard, then silence. One
 *  that was never heard is in no trouble that anybody knows of. */
export function troublesOf(vehicles: readonly Vehicle[], now_s: number): Trouble[] {
  const found = vehicles.flatMap((v) => ranked(v, now_s) ?? []);
  return found.sort((a, b) => (a.rank === b.rank ? 0 : a.rank - b.rank)).map(({ trouble }) => trouble);
}

function ranked(v: Vehicle, now_s: number): { rank: number; trouble: Trouble } | null {
  const silence = silenceOf(v, now_s);
  if (!isHeard(v, now_s)) {
    if (silence === null) return null;
    if (!isInAir(v)) return { rank: Infinity, trouble: { name: v.name, severity: "warning", text: `not heard, ${ageText(silence)}` } };
    const height = fixed(v.position?.alt_rel_m, 1);
    return { rank: -1, trouble: { name: v.name, severity: "danger", text: `lost ${height === null ? "in the air" : `at ${height} m`}, ${ageText(silence)}` } };
  }
  const reasons = reasonsOf(v);
  const worst = reasons.findIndex((reason) => reason !== "");
  return worst < 0 ? null : { rank: worst, trouble: { name: v.name, severity: "danger", text: reasons.filter(Boolean).join(", ") } };
}
