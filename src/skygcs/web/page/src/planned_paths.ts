// The paths that the daemon holds for vehicles: those that are loaded, and the step of a plan that is flown.

import type { Connection } from "./connection.ts";
import type { Store } from "./store.ts";
import type { Vec3 } from "./types.ts";
import type { FleetView } from "./view/fleet_view.ts";
import type { Shape } from "./view/overlays.ts";

const OVERLAY = "planned paths";
/** The daemon answers with a key that says whether anything has changed: nothing is drawn anew while it has not. */
const EVERY_MS = 2_000;

export interface PlannedPath {
  vehicle: string;
  name: string;
  flown: boolean;
  points_enu_m: readonly Vec3[];
}

interface Answer {
  key: string;
  paths: readonly PlannedPath[] | null;
}

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
    const answer = await connection.call<Answer>("trajectory.paths", { known: key });
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
export function plannedShapes(paths: readonly PlannedPath[]): Shape[] {
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
