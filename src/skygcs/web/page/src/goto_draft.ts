// A place for the selected vehicles: taken over from them, or chosen in the view before it is sent.

import { isFlown } from "./setpoint_orders.ts";
import { isHeard, serverNowS, type Store, type Vehicle } from "./store.ts";
import type { Vec3 } from "./types.ts";
import type { FleetView } from "./view/fleet_view.ts";
import { type Frame, placeOf } from "./view/frame.ts";
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

/** In the fleet's frame. */
export interface Place {
  x: number;
  y: number;
  /** Above home; null: the vehicles differ, or it is not known. */
  heightM: number | null;
}

/** Vehicles whose heights differ by less are at one height. */
const SAME_HEIGHT_M = 0.5;

/** Where they are: the middle of those whose places are known. */
export function currentPlace(vehicles: readonly Vehicle[], frame: Frame | null): Place | null {
  return middle(vehicles.flatMap((vehicle) => {
    const place = placeOf(frame, vehicle);
    return place === null ? [] : [{ x: place[0], y: place[1], heightM: vehicle.position?.alt_rel_m ?? null }];
  }));
}

/** Where skygcs' setpoints send them. References are heights above the origin, orders heights above home: the difference
 *  is the vehicle's own. */
export function targetPlace(vehicles: readonly Vehicle[]): Place | null {
  return middle(vehicles.flatMap(({ control, position }) => {
    const [x, y, up] = isFlown({ control }) ? (control?.reference?.pos_enu_m ?? []) : [];
    if (x == null || y == null) return [];
    const above = position?.alt_rel_m == null || position.enu_m === null ? null : position.alt_rel_m - position.enu_m[2];
    return [{ x, y, heightM: up == null || above === null ? null : up + above }];
  }));
}

function middle(places: readonly Place[]): Place | null {
  if (places.length === 0) return null;
  const mean = (axis: "x" | "y"): number => places.reduce((sum, place) => sum + place[axis], 0) / places.length;
  const heights = places.flatMap(({ heightM }) => heightM ?? []);
  const alike = heights.length === places.length && Math.max(...heights) - Math.min(...heights) < SAME_HEIGHT_M;
  return { x: mean("x"), y: mean("y"), heightM: alike ? heights.reduce((sum, height) => sum + height, 0) / heights.length : null };
}
