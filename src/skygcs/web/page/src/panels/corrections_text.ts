// Corrections as a person reads them: where they come from, how a survey goes, what the vehicles make of them. Pure.

import { ageText, fixed } from "../format.ts";

export interface Survey {
  state: "setting_up" | "surveying" | "surveyed" | "fixed";
  duration_s: number | null;
  minimum_s: number | null;
  accuracy_m: number | null;
  wanted_m: number | null;
}

export interface OwnSource {
  kind: string;
  name: string;
  state: string;
  text: string;
  bytes_per_s: number;
  age_s: number | null;
  survey?: Survey | null;
}

/** What corrections.status answers, as far as the page shows it. */
export interface Corrections {
  source: string | null;
  age_s: number | null;
  bytes_per_s: number;
  messages: number;
  vehicles: readonly { name: string; fix: string | null; satellites: number | null }[];
  rtk_float: number;
  rtk_fixed: number;
  own_source: OwnSource | null;
}

/** Corrections help for some ten seconds; a base sends them once a second. */
const OLD_S = 10;

/** Something is to be shown of them: a source is set up, or a program sends some. */
export function areThere({ own_source, source }: Corrections): boolean {
  return own_source !== null || source !== null;
}

/** Where they come from, in one line; and whether that is as it should be. */
export function sourceText({ own_source, source, age_s, bytes_per_s }: Corrections): { text: string; ok: boolean } {
  const name = own_source?.name ?? source ?? "no source";
  const state = own_source === null ? "" : `, ${own_source.state.replaceAll("_", " ")}`;
  const trouble = own_source === null || own_source.text === "" ? "" : `: ${own_source.text}`;
  const flow = age_s === null ? ", nothing came yet" : `, ${fixed(bytes_per_s, 0) ?? "?"} B/s, the last ${ageText(age_s)} ago`;
  return { text: name + state + flow + trouble, ok: age_s !== null && age_s < OLD_S && trouble === "" };
}

/** "surveying, 40 of 120 s, 1.8 m of 2.0 m wanted" */
export function surveyText(survey: Survey | null | undefined): string | null {
  if (survey == null) return null;
  const { state, duration_s, minimum_s, accuracy_m, wanted_m } = survey;
  if (state === "fixed") return "at a fixed position";
  const time = duration_s === null ? "" : `, ${fixed(duration_s, 0) ?? "?"}${minimum_s === null ? "" : ` of ${fixed(minimum_s, 0) ?? "?"}`} s`;
  const spread = accuracy_m === null ? "" : `, ${fixed(accuracy_m, 1) ?? "?"} m${wanted_m === null ? "" : ` of ${fixed(wanted_m, 1) ?? "?"} m wanted`}`;
  return state.replaceAll("_", " ") + time + spread;
}

/** "2 fixed, 1 float, 3 neither" */
export function fixesText({ vehicles, rtk_fixed, rtk_float }: Corrections): string {
  const others = vehicles.length - rtk_fixed - rtk_float;
  return `${rtk_fixed} fixed, ${rtk_float} float${others > 0 ? `, ${others} neither` : ""}`;
}
