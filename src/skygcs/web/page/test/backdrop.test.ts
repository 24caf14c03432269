import assert from "node:assert/strict";
import { test } from "node:test";
import { Backdrop, BACKDROP_EVERY_MS } from "../src/view/backdrop.ts";
import type { Camera } from "../src/view/camera.ts";

const CAMERA: Camera = { x: 0, y: 0, pxPerM: 8, widthPx: 100, heightPx: 50 };

test("it is painted some times a second while the view rests, and with each frame that moves it", () => {
  const backdrop = new Backdrop();
  const moved = { ...CAMERA, x: 1 };
  const frames: [Camera, number, boolean][] = [
    [CAMERA, 0, true],
    [{ ...CAMERA }, 20, false],
    [CAMERA, BACKDROP_EVERY_MS, false],
    [CAMERA, BACKDROP_EVERY_MS + 1, true],
    [moved, BACKDROP_EVERY_MS + 2, true],
    [{ ...moved, pxPerM: 9 }, BACKDROP_EVERY_MS + 3, true],
    [CAMERA, BACKDROP_EVERY_MS + 4, true],
    [CAMERA, BACKDROP_EVERY_MS + 5, false],
  ];
  for (const [camera, nowMs, due] of frames) assert.equal(backdrop.due(camera, nowMs), due, `${nowMs} ms`);
});

test("a change is painted with the next frame, also one that comes while it is painted", () => {
  const backdrop = new Backdrop();
  for (const nowMs of [0, 10, 20]) {
    assert.ok(backdrop.due(CAMERA, nowMs));
    backdrop.stale();
  }
  assert.ok(backdrop.due(CAMERA, 30));
  assert.ok(!backdrop.due(CAMERA, 40));
});
