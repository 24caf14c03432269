// How the fleet's page is shared between the view and the table below it: a share of the table, kept in this browser. Pure.

import { recall, remember } from "./theme.ts";

const KEY = "skygcs.split";

/** Percent of the height that the table may have: some of each part stays. */
export const LEAST_SHARE = 10;
export const MOST_SHARE = 80;
const STEP = 4;
const LARGE_STEP = 12;

/** The table's share in percent; null: as high as its rows, at most 44 %. */
export type Share = number | null;

export function clampedShare(percent: number): number {
  return Math.round(Math.min(Math.max(percent, LEAST_SHARE), MOST_SHARE) * 10) / 10;
}

/** What was kept; null for what is no share. */
export function parsedShare(text: string | null): Share {
  const percent = text === null || text.trim() === "" ? NaN : Number(text);
  return Number.isFinite(percent) ? clampedShare(percent) : null;
}

export function recalledShare(): Share {
  return parsedShare(recall(KEY));
}

export function keepShare(share: Share): void {
  remember(KEY, share === null ? "" : String(share));
}

/** The share that puts the upper edge of the table under a pointer. */
export function shareAt(pointerPx: number, topPx: number, heightPx: number): number {
  return clampedShare((1 - (pointerPx - topPx) / Math.max(heightPx, 1)) * 100);
}

/** The share after a key; undefined: the key is not one of the separator's. */
export function shareAfter(key: string, percent: number): Share | undefined {
  switch (key) {
    case "ArrowUp": return clampedShare(percent + STEP);
    case "ArrowDown": return clampedShare(percent - STEP);
    case "PageUp": return clampedShare(percent + LARGE_STEP);
    case "PageDown": return clampedShare(percent - LARGE_STEP);
    case "Home": return LEAST_SHARE;
    case "End": return MOST_SHARE;
    case "Enter": return null;
  }
  return undefined;
}
