// Arrows at the edge of the view, one for each direction in which vehicles are off the screen. Pure.

import { toScreenX, toScreenY, type Camera } from "./camera.ts";
import type { Box } from "./labels.ts";

export interface Off {
  name: string;
  x: number;
  y: number;
  /** Above others where they share an arrow: trouble, then what is selected. */
  urgency: number;
}

export interface Arrow {
  xPx: number;
  yPx: number;
  /** On the screen, y down: where it points. */
  angleRad: number;
  /** The most urgent first. */
  names: readonly string[];
  urgency: number;
}

/** From the edge to an arrow's middle. */
export const EDGE_PX = 16;
/** Arrows that would be closer together are one. */
const APART_PX = 40;

/** Where the line from the middle of the view to each place leaves the view; what lies on the screen has none. `taken`: by
 *  buttons, below which an arrow goes. */
export function edgeArrows(camera: Camera, places: readonly Off[], taken: readonly Box[]): Arrow[] {
  const { widthPx, heightPx } = camera;
  const reachX = widthPx / 2 - EDGE_PX;
  const reachY = heightPx / 2 - EDGE_PX;
  if (reachX <= 0 || reachY <= 0) return [];
  const arrows: (Arrow & { names: string[] })[] = [];
  for (const { name, x, y, urgency } of [...places].sort((a, b) => b.urgency - a.urgency)) {
    const [px, py] = [toScreenX(camera, x), toScreenY(camera, y)];
    if (px >= 0 && py >= 0 && px <= widthPx && py <= heightPx) continue;
    const [dx, dy] = [px - widthPx / 2, py - heightPx / 2];
    const share = Math.min(reachX / Math.abs(dx), reachY / Math.abs(dy));
    const at = beside({ xPx: widthPx / 2 + dx * share, yPx: heightPx / 2 + dy * share }, taken);
    const shared = arrows.find((arrow) => Math.hypot(arrow.xPx - at.xPx, arrow.yPx - at.yPx) < APART_PX);
    if (shared !== undefined) shared.names.push(name);
    else arrows.push({ ...at, angleRad: Math.atan2(dy, dx), names: [name], urgency });
  }
  return arrows;
}

function beside(at: { xPx: number; yPx: number }, taken: readonly Box[]): { xPx: number; yPx: number } {
  const over = taken.find(({ left, right, top, bottom }) => at.xPx > left - EDGE_PX && at.xPx < right + EDGE_PX && at.yPx > top - EDGE_PX && at.yPx < bottom + EDGE_PX);
  return over === undefined ? at : { xPx: at.xPx, yPx: over.bottom + EDGE_PX };
}

/** "u02", or "u02 +3". */
export function arrowText({ names }: Arrow): string {
  return names.length === 1 ? (names[0] ?? "") : `${names[0] ?? ""} +${names.length - 1}`;
}

/** The arrow under a point of the canvas. */
export function arrowAt(arrows: readonly Arrow[], xPx: number, yPx: number): Arrow | null {
  return arrows.find((arrow) => Math.hypot(arrow.xPx - xPx, arrow.yPx - yPx) < EDGE_PX) ?? null;
}
