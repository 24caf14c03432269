// A cell of the fleet table: its text, and how loud it is. Pure.

import { ageText } from "./format.ts";
import { ageOf, type Vehicle } from "./store.ts";

export type Tone = "" | "muted" | "warning" | "danger" | "good";

export interface Cell {
  text: string;
  tone: Tone;
  /** On a phone: a second line. */
  under?: string;
  /** On a phone: instead of the text. */
  narrow?: string;
  /** For people who want to know more, and for screen readers. */
  title?: string;
}

/** A group of telemetry that did not come for so long is grey although the vehicle is heard. */
const OLD_GROUP_S = 4;

export const UNKNOWN: Cell = { text: "–", tone: "muted" };

export function cell(text: string | null, tone: Tone = "", title?: string): Cell {
  if (text === null || text === "") return UNKNOWN;
  return title === undefined ? { text, tone } : { text, tone, title };
}

/** Grey with its age if the group is old. */
export function aged(vehicle: Vehicle, part: { age_s: number } | null, now_s: number, text: string | null, tone: Tone = ""): Cell {
  const age = ageOf(vehicle, part, now_s);
  if (age === null || text === null) return UNKNOWN;
  return age > OLD_GROUP_S ? cell(text, "muted", `${ageText(age)} old`) : cell(text, tone);
}

export function withUnit(text: string | null, unit: string): string | null {
  return text === null ? null : `${text} ${unit}`;
}
