// A place chosen in the view for the selected vehicles, before it is sent: where each of them would fly.

import type { Store } from "./store.ts";
import { isHeard, serverNowS } from "./store.ts";
import type { Vec3 } from "./types.ts";
import type { FleetView } from "./view/fleet_view.ts";
import { placeOf, type Frame } from "./view/frame.ts";
import type { Shape } from "./view/overlays.ts";

const OVERLAY = "goto";

export interface GotoDraft {
  /** Shows it for another place. */
  show: (x: number, y: number) => void;
  end: () => void;
}

/** Gives the view's pointer to the choice of a place; `chosen` is called with each. */
export function beginGoto(store: Store, view: FleetView, chosen: (at: { x: number; y: number }) => void): GotoDraft {
  let ended = false;
  const show = (x: number, y: number): void => {
    if (!ended) view.setOverlay(OVERLAY, { shapes: goalShapes(goalsOf(store, view.frame, x, y)) });
  };
  const end = (): void => {
    if (ended) return;
    ended = true;
    view.setOverlay(OVERLAY, null);
    if (view.tool === tool) view.setTool(null);
  };
  const tool = {
    cursor: "crosshair" as const,
    hint: "Click where they should go, then hold “Send there”.",
    click: (at: { x: number; y: number }) => {
      chosen(at);
      show(at.x, at.y);
    },
    cancel: end,
  };
  view.setTool(tool);
  return { show, end };
}

export interface Goal {
  name: string;
  from: Vec3;
  to: Vec3;
}

/** Where each selected vehicle would go: they keep their formation, and its middle goes to the place, as the daemon does it. */
export function goalsOf(store: Store, frame: Frame | null, x: number, y: number): Goal[] {
  const { state } = store;
  const now_s = serverNowS(state, performance.now());
  const going = [...state.selection].flatMap((name): { name: string; from: Vec3 }[] => {
    const vehicle = state.vehicles.get(name);
    if (vehicle === undefined || vehicle.armed !== true || !isHeard(vehicle, now_s)) return [];
    const from = placeOf(frame, vehicle);
    return from === null ? [] : [{ name, from }];
  });
  const middle = (axis: 0 | 1): number => going.reduce((sum, { from }) => sum + from[axis], 0) / Math.max(going.length, 1);
  const [mx, my] = [middle(0), middle(1)];
  return going.map(({ name, from }) => ({ name, from, to: [x + from[0] - mx, y + from[1] - my, from[2]] }));
}

function goalShapes(goals: readonly Goal[]): Shape[] {
  return goals.flatMap(({ name, from, to }): Shape[] => [
    { kind: "path", points: [from, to], ink: "draft", dashed: true, widthPx: 1.5 },
    { kind: "mark", at: to, symbol: "goal", ink: "draft", text: name },
  ]);
}
