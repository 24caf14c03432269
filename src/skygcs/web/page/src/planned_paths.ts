// What the view shows of the daemon's: paths that it holds for vehicles, and the fences that their autopilots hold.

import type { Connection } from "./connection.ts";
import { refusalText } from "./orders.ts";
import type { Store } from "./store.ts";
import type { FleetView } from "./view/fleet_view.ts";
import { type Frame, fromGeodetic } from "./view/frame.ts";
import type { Shape } from "./view/overlays.ts";
import type { FenceResult, TrajectoryPath } from "./rpc_types.ts";

const OVERLAY = "planned paths";
/** The daemon answers with a key that says whether anything has changed: nothing is drawn anew while it has not. */
const EVERY_MS = 2_000;

/** Keeps them on the view; returns what ends it. */
export function beginPlannedPaths(store: Store, connection: Connection, view: FleetView): () => void {
  let key: string | null = null;
  let here = true;
  let asking = false;
  const show = (shapes: readonly Shape[]): void => view.setOverlay(OVERLAY, shapes.length === 0 ? null : { shapes, fit: true });

  async function ask(): Promise<void> {
    const { hello, daemon, phase } = store.state;
    if (hello === null || hello.replay || document.visibilityState === "hidden") return;
    if (phase.kind !== "open" || daemon?.connected !== true) {
      if (key !== null) show([]); // whether they are still planned is not known
      key = null;
      return;
    }
    const answer = await connection.call("trajectory.paths", { known: key });
    if (!here) return;
    if (answer.paths !== null) show(plannedShapes(answer.paths));
    key = answer.key;
  }

  const turn = (): void => {
    if (asking) return;
    asking = true;
    ask().catch(() => { key = null; }) // a lost connection, say: the next turn asks for all of them
      .finally(() => { asking = false; });
  };
  const timer = setInterval(turn, EVERY_MS);
  turn();
  return () => {
    here = false;
    clearInterval(timer);
    show([]);
  };
}

/** What is flown is a line, what is only loaded is dashed, in the vehicle's colour; with where each begins and ends. */
export function plannedShapes(paths: readonly TrajectoryPath[]): Shape[] {
  return paths.flatMap(({ vehicle, flown, points_enu_m: points }): Shape[] => {
    const first = points[0];
    const last = points.at(-1);
    if (first === undefined || last === undefined) return [];
    return [
      { kind: "path", points, ink: "plan", dashed: !flown, vehicle },
      { kind: "mark", at: first, symbol: "start", ink: "plan", vehicle },
      { kind: "mark", at: last, symbol: "goal", ink: "goal" },
    ];
  });
}

const FENCES = "vehicle fences";
/** Circles nearer to each other than this are one on the screen. */
const SAME_M = 1;

/** Asks every vehicle and shows the cylinders about their homes. Returns what to say to the person. */
export async function showFences(store: Store, connection: Connection, view: FleetView): Promise<string> {
  try {
    const { outcomes } = await connection.order("fence.status", { targets: "all" });
    const shapes = fenceShapes(outcomes, store, view.frame);
    view.setOverlay(FENCES, { shapes, fit: true });
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
  view.setOverlay(FENCES, null);
}

/** One circle for each different home and radius. */
export function fenceShapes(outcomes: Readonly<Record<string, FenceResult>>, store: Pick<Store, "state">, frame: Frame | null): Shape[] {
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
