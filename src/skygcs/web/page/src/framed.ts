// Places that a person chose, with the fleet's frame that they were chosen in. In another frame one place is void, and a
// drawing keeps its places on earth. Pure.

import type { State } from "./store.ts";
import type { Origin, Vec3 } from "./types.ts";
import { drawnToGeodetic, frameAt, geodeticToDrawn } from "./view/frame.ts";

type FrameState = Pick<State, "origin" | "originGeneration" | "vehicles">;

/** Names a frame: metres from another origin, or along another x axis, are another place. */
export function frameKey(origin: Origin | null): string {
  return origin === null ? "" : [origin.lat_deg, origin.lon_deg, origin.alt_amsl_m, origin.x_heading_deg].join(" ");
}

/** What is said while the frame of the places is not known. */
export const FRAME_UNKNOWN = "The origin of the fleet's frame has changed or is not known here yet; the page asks for it again. Until then no place can be chosen, drawn or uploaded.";

/** True if the origin is the one from which all places of vehicles are counted. It is not between its change and the answer of
 *  origin.get: places drawn then would be others on earth. */
export function frameIsKnown({ origin, originGeneration, vehicles }: FrameState): boolean {
  if (originGeneration === null) return false;
  for (const { position } of vehicles.values()) {
    if (position === null) continue;
    if (position.origin_generation !== null && position.origin_generation !== originGeneration) return false;
    if (position.enu_m !== null && origin === null) return false;
  }
  return true;
}

/** Names the frame of all that is chosen now: a key of its own while it is not known. */
export function frameKeyOf(state: FrameState): string {
  return frameIsKnown(state) ? frameKey(state.origin) : "?";
}

export interface Framed<T> {
  frame: string;
  value: T;
}

/** The chosen value in the frame it was chosen in; in any other `none`. */
export function valueIn<T>(kept: Framed<T> | null, frame: string, none: T): T {
  return kept?.frame === frame ? kept.value : none;
}

/** Points of one frame in another one: at the same places on earth, their third number as it was. Null: one of the frames has no
 *  origin, and so no place on earth, or the two are on different sides of the earth. */
export function carriedOver(points: readonly Vec3[], from: Origin | null, to: Origin | null): readonly Vec3[] | null {
  if (points.length === 0 || frameKey(from) === frameKey(to)) return points;
  if (from === null || to === null) return null;
  const [before, now] = [frameAt(from), frameAt(to)];
  const carried = points.flatMap(([x, y, up]): Vec3[] => {
    const { lat_deg, lon_deg } = drawnToGeodetic(before, x, y);
    const at = geodeticToDrawn(now, lat_deg, lon_deg);
    return at === null ? [] : [[...at, up]];
  });
  return carried.length === points.length ? carried : null;
}
