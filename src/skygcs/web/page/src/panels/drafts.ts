// What a person draws on the canvas and keeps on each tab: points that a click adds, a drag moves, and a click on a point selects.
// Settings and drawing are kept apart, because only the drawing is in metres of a frame. Pure.

import { toDecimetre } from "../format.ts";
import { carriedOver, FRAME_UNKNOWN, frameIsKnown } from "../framed.ts";
import type { State } from "../store.ts";
import type { Origin, Vec3 } from "../types.ts";
import type { Overlay, PointerAt, Shape, Tool } from "../view/overlays.ts";

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

/** A drawn fence has no more; the check has the same bound. */
export const MAX_DRAWN_POINTS = 1000;

/** Nearest point within reach of the pointer; null: none. */
export function hit(points: readonly Vec3[], at: PointerAt): number | null {
  let best: number | null = null;
  let bestM = at.reachM;
  points.forEach(([x, y], i) => {
    const distanceM = Math.hypot(x - at.x, y - at.y);
    if (distanceM <= bestM) [best, bestM] = [i, distanceM];
  });
  return best;
}

export function moved(points: readonly Vec3[], index: number, x: number, y: number): Vec3[] {
  return points.map((point, i) => (i === index ? [toDecimetre(x), toDecimetre(y), point[2]] : point));
}

export function added(points: readonly Vec3[], x: number, y: number, height: number): Vec3[] {
  return points.length >= MAX_DRAWN_POINTS ? [...points] : [...points, [toDecimetre(x), toDecimetre(y), height]];
}

export function without(points: readonly Vec3[], index: number): Vec3[] {
  return points.filter((_, i) => i !== index);
}

/** What a panel keeps of its drawing. */
export interface Drawing {
  points: readonly Vec3[];
  selected: number | null;
}

export const NOTHING_DRAWN: Drawing = { points: [], selected: null };

export interface DrawingKeeper {
  get: () => Drawing;
  set: (drawing: Drawing) => void;
}

/** Clicks add points, drags move them, a click on one selects it. `heightM`: of new points. */
export function pointsTool(keeper: DrawingKeeper, hint: string, heightM: () => number, most = MAX_DRAWN_POINTS): Tool {
  let dragged: number | null = null;
  return {
    cursor: "crosshair",
    hint,
    click: (at) => {
      const { points } = keeper.get();
      const there = hit(points, at);
      if (there !== null) keeper.set({ points, selected: there });
      else if (points.length < most) keeper.set({ points: added(points, at.x, at.y, heightM()), selected: points.length });
    },
    grab: (at) => {
      dragged = hit(keeper.get().points, at);
      return dragged !== null;
    },
    dragTo: (at, done) => {
      if (dragged === null) return;
      keeper.set({ points: moved(keeper.get().points, dragged, at.x, at.y), selected: dragged });
      if (done) dragged = null;
    },
  };
}

/** Drags named places, and adds none. */
export function goalsTool(get: () => ReadonlyMap<string, Vec3>, set: (name: string, place: Vec3) => void, hint: string): Tool {
  let dragged: string | null = null;
  return {
    cursor: "move",
    hint,
    grab: (at) => {
      const names = [...get().keys()];
      const index = hit([...get().values()], at);
      dragged = index === null ? null : (names[index] ?? null);
      return dragged !== null;
    },
    dragTo: (at, done) => {
      const place = dragged === null ? undefined : get().get(dragged);
      if (dragged === null || place === undefined) return;
      set(dragged, [toDecimetre(at.x), toDecimetre(at.y), place[2]]);
      if (done) dragged = null;
    },
  };
}

/** The drawing as shapes: a path with numbered points. */
export function drawnShapes(drawing: Drawing, closed: boolean): Shape[] {
  const { points, selected } = drawing;
  const shapes: Shape[] = [];
  if (points.length > 1) shapes.push({ kind: "path", points, ink: "draft", closed: closed && points.length > 2, filled: closed });
  points.forEach((at, i) => { shapes.push({ kind: "mark", at, symbol: "handle", ink: "draft", text: String(i + 1), emphasised: i === selected }); });
  return shapes;
}

/** One overlay of several lists of shapes; null if there is nothing to show. */
export function overlay(...parts: (readonly Shape[])[]): Overlay | null {
  const shapes = parts.flat();
  return shapes.length === 0 ? null : { shapes, fit: true };
}
