// What panels draw on the fleet view: shapes in metres of the fleet's frame, and tools that take the pointer.

import type { Vec3 } from "../types.ts";

/** A colour of the theme, by its role. */
export type Ink = "plan" | "flown" | "fence" | "draft" | "goal" | "warning" | "danger" | "muted";

/** `vehicle`: it is that vehicle's, and has its colour where the page knows it. */
export type Shape =
  | { kind: "path"; points: readonly Vec3[]; ink: Ink; dashed?: boolean; closed?: boolean; filled?: boolean; widthPx?: number; vehicle?: string }
  | { kind: "circle"; centre: Vec3; radiusM: number; ink: Ink; dashed?: boolean; filled?: boolean }
  | {
      kind: "mark";
      at: Vec3;
      symbol: "start" | "goal" | "waypoint" | "home" | "cross" | "handle" | "ghost";
      ink: Ink;
      text?: string;
      /** Larger, for what is selected. */
      emphasised?: boolean;
      /** For "ghost": radians from the x axis, counter-clockwise. */
      yawRad?: number;
      vehicle?: string;
    };

/** What one panel shows. Set anew as a whole; bounded by `MAX_POINTS` when it is drawn. */
export interface Overlay {
  shapes: readonly Shape[];
  /** Also part of what "Fit" shows. */
  fit?: boolean;
}

/** Points of all overlays that are drawn; beyond it paths are left out, last ones first. */
export const MAX_POINTS = 50_000;

export interface PointerAt {
  /** On the ground of the fleet's frame, in metres. */
  x: number;
  y: number;
  /** Metres that `HIT_PX` are at the present scale: what is nearer is meant. */
  reachM: number;
  shift: boolean;
}

/** Takes the pointer until it is set to null: to draw, to choose a place, to drag. */
export interface Tool {
  cursor: "crosshair" | "move" | "default";
  /** One line that says what to do; shown on the view. */
  hint: string;
  click?: (at: PointerAt) => void;
  hover?: (at: PointerAt | null) => void;
  /** True if a drag begins here: then `dragTo` follows; else the view is panned. */
  grab?: (at: PointerAt) => boolean;
  dragTo?: (at: PointerAt, done: boolean) => void;
  /** Escape, or the tool is replaced. */
  cancel?: () => void;
}
