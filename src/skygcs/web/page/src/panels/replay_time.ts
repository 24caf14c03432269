// The clock of a recording between two reports of the ground station, and the events that are marked on its bar. Pure.

import type { FleetEvent } from "../types.ts";

export interface ReplayInfo {
  file: string;
  start_unix_s: number;
  duration_s: number;
  position_s: number;
  playing: boolean;
  speed: number;
  ended: boolean;
  /** False while its end is still looked for. */
  scanned?: boolean;
}

/** Where it is now: it goes on between reports while it plays, and not beyond its end. */
export function placeAt(info: ReplayInfo, reportedMs: number, nowMs: number): number {
  const flown = info.playing ? (Math.max(nowMs - reportedMs, 0) / 1000) * info.speed : 0;
  return Math.min(Math.max(info.position_s + flown, 0), info.duration_s);
}

/** 1:02:03.4, 2:03.4. */
export function clockText(seconds: number): string {
  const tenths = Math.floor(Math.max(seconds, 0) * 10 + 1e-6);
  const [whole, rest] = [Math.floor(tenths / 10), tenths % 10];
  const [hours, minutes, left] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  const two = (value: number): string => String(value).padStart(2, "0");
  return `${hours > 0 ? `${hours}:${two(minutes)}` : minutes}:${two(left)}.${rest}`;
}

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
