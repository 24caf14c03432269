// The fences that the vehicles' autopilots hold: asked for by a person, since each answer goes over the radio.

import type { Connection } from "./connection.ts";
import { refusalText } from "./orders.ts";
import type { Store } from "./store.ts";
import type { Outcome } from "./types.ts";
import type { FleetView } from "./view/fleet_view.ts";
import { fromGeodetic, type Frame } from "./view/frame.ts";
import type { Shape } from "./view/overlays.ts";

const OVERLAY = "vehicle fences";
/** Circles nearer to each other than this are one on the screen. */
const SAME_M = 1;

interface FenceOutcome extends Outcome {
  fence?: { enabled: boolean | null; radius_m: number | null; height_m: number | null } | null;
}

/** Asks every vehicle and shows the cylinders about their homes. Returns what to say to the person. */
export async function showFences(store: Store, connection: Connection, view: FleetView): Promise<string> {
  try {
    const { outcomes } = await connection.order<{ outcomes: Record<string, FenceOutcome> }>("fence.status", { targets: "all" });
    const shapes = fenceShapes(outcomes, store, view.frame);
    view.setOverlay(OVERLAY, { shapes, fit: true });
    const off = Object.values(outcomes).filter(({ ok, fence }) => ok && fence?.enabled === false).length;
    const failed = Object.values(outcomes).filter(({ ok }) => !ok).length;
    const parts = [`${shapes.length === 1 ? "1 fence" : `${shapes.length} fences`} about home`];
    if (off > 0) parts.push(`${off} off`);
    if (failed > 0) parts.push(`${failed} without an answer`);
    return parts.join(", ");
  } catch (error) {
    return refusalText(error);
  }
}

export function hideFences(view: FleetView): void {
  view.setOverlay(OVERLAY, null);
}

/** One circle for each different home and radius. */
export function fenceShapes(outcomes: Readonly<Record<string, FenceOutcome>>, store: Pick<Store, "state">, frame: Frame | null): Shape[] {
  if (frame === null) return [];
  const circles: { x: number; y: number; radiusM: number }[] = [];
  for (const [name, { fence }] of Object.entries(outcomes)) {
    const home = store.state.vehicles.get(name)?.home;
    if (fence?.enabled !== true || fence.radius_m === null || fence.radius_m <= 0 || home == null) continue;
    const [x, y] = fromGeodetic(frame, home.lat_deg, home.lon_deg);
    const { radius_m: radiusM } = fence;
    const known = circles.some((c) => Math.hypot(c.x - x, c.y - y) < SAME_M && Math.abs(c.radiusM - radiusM) < SAME_M);
    if (!known) circles.push({ x, y, radiusM });
  }
  return circles.map(({ x, y, radiusM }) => ({ kind: "circle", centre: [x, y, 0], radiusM, ink: "fence", dashed: true }));
}
