// Places that the order to fly somewhere takes over from vehicles. Pure.

import { isFlown } from "./setpoint_orders.ts";
import type { Vehicle } from "./store.ts";
import { placeOf, type Frame } from "./view/frame.ts";

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
