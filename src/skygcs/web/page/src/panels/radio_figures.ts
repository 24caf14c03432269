// Figures of a radio: rates from counters, the radio's reports as rows of a chart.

import { RateMeter } from "./history_ring.ts";

/** One RADIO_STATUS. */
export interface RadioReport {
  age_s: number;
  txbuf_percent: number;
  rssi: number;
  noise: number;
  remrssi?: number;
  remnoise?: number;
}

export const REPORT_SERIES = ["txbuf", "rssi", "noise", "remrssi", "remnoise"] as const;

export function reportRow(report: RadioReport): (number | null)[] {
  return [report.txbuf_percent, report.rssi, report.noise, report.remrssi ?? null, report.remnoise ?? null];
}

export interface ClassCounters {
  waiting: number;
  sent: number;
  sent_bytes: number;
  replaced: number;
  dropped: number;
  refused: number;
  wait_p50_s: number | null;
  wait_p95_s: number | null;
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

/** 12,345 with thin spaces. */
export function countText(count: number | null | undefined): string {
  if (count === null || count === undefined) return "–";
  return String(count).replace(/\B(?=(\d{3})+(?!\d))/g, " ");
}
