import assert from "node:assert/strict";
import { test } from "node:test";
import { FRAME_UNKNOWN } from "../src/framed.ts";
import { CARRIED_OVER, type Drawing, NEW_DRAFT, NEW_SETTINGS, NO_ORIGIN, NO_PLACE, NOTHING_DRAWN, shownDraft, withDrawing, withSettings } from "../src/panels/drafts.ts";
import { EMPTY } from "../src/store.ts";
import type { Origin } from "../src/types.ts";

const ORIGIN: Origin = { lat_deg: 43.7806, lon_deg: -79.4653, alt_amsl_m: 180, x_heading_deg: 90 };
const DRAWING: Drawing = { points: [[30, 40, 12], [-5, 0, 7]], selected: 1 };

const state = (origin: Origin | null, originGeneration: number | null = 1) => ({ ...EMPTY, origin, originGeneration });
const drawn = withDrawing(NEW_DRAFT, DRAWING, state(ORIGIN));

test("a drawing outlives settings that are changed while the fleet has no origin", () => {
  const without = shownDraft(drawn, null, true);
  assert.deepEqual([without.draft.drawing, without.note], [NOTHING_DRAWN, NO_ORIGIN]);
  const kept = [{ heightM: 33 }, { takeoffM: null }, { end: "land" as const }, { inclusion: false }, { radiusM: 80 }].reduce(withSettings, drawn);
  const { draft, note } = shownDraft(kept, ORIGIN, true);
  assert.deepEqual(draft, { drawing: DRAWING, heightM: 33, takeoffM: null, end: "land", inclusion: false, radiusM: 80 });
  assert.equal(note, null);
});

test("settings that are changed in another frame do not move the drawing, and points that are set replace it", () => {
  const turned = { ...ORIGIN, x_heading_deg: 0 };
  const kept = withSettings(drawn, { heightM: 33 });
  const there = shownDraft(kept, turned, true);
  assert.equal(there.note, CARRIED_OVER);
  assert.deepEqual(shownDraft(kept, ORIGIN, true).draft.drawing, DRAWING);
  const moved = withDrawing(kept, there.draft.drawing, state(turned));
  assert.deepEqual(shownDraft(moved, turned, true), { draft: there.draft, note: null });
  const anew = withDrawing(drawn, { points: [[1, 2, 3]], selected: null }, state(null));
  assert.equal(shownDraft(anew, null, true).draft.drawing.points.length, 1);
  assert.deepEqual(shownDraft(anew, ORIGIN, true), { draft: { ...NEW_SETTINGS, drawing: NOTHING_DRAWN }, note: NO_PLACE });
});

test("while the frame is not known nothing is shown and nothing is drawn; settings are kept", () => {
  assert.deepEqual(shownDraft(drawn, ORIGIN, false), { draft: { ...NEW_SETTINGS, drawing: NOTHING_DRAWN }, note: FRAME_UNKNOWN });
  const kept = withDrawing(withSettings(drawn, { radiusM: 80 }), { points: [[1, 2, 3]], selected: null }, state(ORIGIN, null));
  assert.deepEqual(shownDraft(kept, ORIGIN, true).draft, { ...NEW_SETTINGS, radiusM: 80, drawing: DRAWING });
});
