// How close together marks lie on the screen, so that those around vehicles leave the vehicles to be seen.

import type { Body } from "./scene.ts";

/** Wide enough for a ring of full size and some ground around it. */
const CELL_PX = 32;

/** Pixels between neighbours, as if those of each crowded place were spread over it evenly; CELL_PX at most. Places are
 *  counted on the ground, so that it is the same wherever the view is moved to. */
export function spacingPx(bodies: readonly Pick<Body, "x" | "y">[], pxPerM: number): number {
  const cells = new Set<string>();
  for (const { x, y } of bodies) cells.add(`${Math.floor((x * pxPerM) / CELL_PX)} ${Math.floor((y * pxPerM) / CELL_PX)}`);
  return cells.size === 0 ? CELL_PX : CELL_PX / Math.sqrt(bodies.length / cells.size);
}

export interface Ring {
  radiusPx: number;
  widthPx: number;
}

/** A ring as it is drawn at this spacing: of its full size while neighbours' rings hardly touch, then smaller and thinner
 *  down to `least` of it. */
export function ringAt(full: Ring, spacing: number, least: number): Ring {
  const scale = Math.min(1, Math.max(least, spacing / CELL_PX));
  return { radiusPx: full.radiusPx * scale, widthPx: Math.max(1, full.widthPx * scale) };
}
