// Places that a person chose, with the fleet's frame that they were chosen in: in another frame they are void. Pure.

import type { Origin } from "./types.ts";

/** Names a frame: metres from another origin, or along another x axis, are another place. */
export function frameKey(origin: Origin | null): string {
  return origin === null ? "" : [origin.lat_deg, origin.lon_deg, origin.alt_amsl_m, origin.x_heading_deg].join(" ");
}

export interface Framed<T> {
  frame: string;
  value: T;
}

/** The chosen value in the frame it was chosen in; in any other `none`. */
export function valueIn<T>(kept: Framed<T> | null, frame: string, none: T): T {
  return kept?.frame === frame ? kept.value : none;
}
