// Figures of a radio: rates from counters, its reports as rows of a chart; and corrections as a person reads them. Pure.

import { ageText, fixed } from "../format.ts";
import { RateMeter } from "./histories.ts";
import type { ClassCounters, CorrectionsStatus, RadioReport, Survey } from "../rpc_types.ts";

export const REPORT_SERIES = ["txbuf", "rssi", "noise", "remrssi", "remnoise"] as const;

export function reportRow(report: RadioReport): number[] {
  return [report.txbuf_percent, report.rssi, report.noise, report.remrssi, report.remnoise];
}

/** Bytes a second of each traffic class, from two readings of its counter. */
export class ClassRates {
  private readonly meters = new Map<string, RateMeter>();
  private rates = new Map<string, number | null>();

  take(at_s: number, classes: Readonly<Record<string, Pick<ClassCounters, "sent_bytes">>>): void {
    const next = new Map<string, number | null>();
    for (const [name, one] of Object.entries(classes)) {
      const meter = this.meters.get(name) ?? new RateMeter();
      this.meters.set(name, meter);
      next.set(name, meter.read(at_s, one.sent_bytes));
    }
    this.rates = next;
  }

  of(name: string): number | null {
    return this.rates.get(name) ?? null;
  }

  /** Of all classes; null before the second reading. */
  get total(): number | null {
    const known = [...this.rates.values()].filter((rate) => rate !== null);
    return known.length === 0 ? null : known.reduce((sum, rate) => sum + rate, 0);
  }
}

/** Corrections help for some ten seconds; a base sends them once a second. */
const OLD_S = 10;

/** Something is to be shown of them: a source is set up, or a program sends some. */
export function areThere({ own_source, source }: CorrectionsStatus): boolean {
  return own_source !== null || source !== null;
}

/** Where they come from, in one line; and whether that is as it should be. */
export function sourceText({ own_source, source, age_s, bytes_per_s }: CorrectionsStatus): { text: string; ok: boolean } {
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
export function fixesText({ vehicles, rtk_fixed, rtk_float }: CorrectionsStatus): string {
  const others = vehicles.length - rtk_fixed - rtk_float;
  return `${rtk_fixed} fixed, ${rtk_float} float${others > 0 ? `, ${others} neither` : ""}`;
}
