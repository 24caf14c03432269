// What a person draws on each tab, and how it is meant: settings and drawing are kept apart, because only the drawing is in metres
// of a frame. Pure.

import { carriedOver, FRAME_UNKNOWN, frameIsKnown } from "../framed.ts";
import type { State } from "../store.ts";
import type { Origin } from "../types.ts";
import { NOTHING_DRAWN, type Drawing } from "./drawing.ts";

export const CARRIED_OVER = "The fleet's origin or x axis has changed. The drawing has kept its places on earth; its x and y are new.";
export const NO_PLACE = "The drawing is gone: it was made without an origin, and has no place on earth.";
export const NO_ORIGIN = "The drawing is hidden while the fleet has no origin; new points take its place.";
export const FAR_OFF = "The drawing is hidden: the fleet's origin is on another side of the earth. New points take its place.";

export type Ending = "return" | "land" | "hold";

/** They hold in every frame. */
export interface DraftSettings {
  heightM: number;
  takeoffM: number | null;
  end: Ending;
  inclusion: boolean;
  radiusM: number;
}

export interface Draft extends DraftSettings {
  drawing: Drawing;
}

export const NEW_SETTINGS: DraftSettings = { heightM: 20, takeoffM: 10, end: "return", inclusion: true, radiusM: 50 };

/** A drawing in metres of the frame of its origin. */
interface Drawn {
  drawing: Drawing;
  origin: Origin | null;
}

/** The draft of one tab. */
export interface KeptDraft {
  settings: DraftSettings;
  drawn: Drawn | null;
}

export const NEW_DRAFT: KeptDraft = { settings: NEW_SETTINGS, drawn: null };

type FrameState = Pick<State, "origin" | "originGeneration" | "vehicles">;

export function withSettings(kept: KeptDraft, settings: Partial<DraftSettings>): KeptDraft {
  return { ...kept, settings: { ...kept.settings, ...settings } };
}

/** The drawing is replaced by one of now; not while the frame is not known. */
export function withDrawing(kept: KeptDraft, drawing: Drawing, state: FrameState): KeptDraft {
  return frameIsKnown(state) ? { ...kept, drawn: { drawing, origin: state.origin } } : kept;
}

/** The draft in the frame of `origin`, and a word about a frame that has changed since it was drawn. `known`: see `frameIsKnown`. */
export function shownDraft({ settings, drawn }: KeptDraft, origin: Origin | null, known: boolean): { draft: Draft; note: string | null } {
  const nothing = { ...settings, drawing: NOTHING_DRAWN };
  if (!known) return { draft: nothing, note: FRAME_UNKNOWN };
  if (drawn === null) return { draft: nothing, note: null };
  const points = carriedOver(drawn.drawing.points, drawn.origin, origin);
  if (points === drawn.drawing.points) return { draft: { ...settings, drawing: drawn.drawing }, note: null };
  if (points === null) return { draft: nothing, note: drawn.origin === null ? NO_PLACE : origin === null ? NO_ORIGIN : FAR_OFF };
  return { draft: { ...settings, drawing: { ...drawn.drawing, points } }, note: CARRIED_OVER };
}
