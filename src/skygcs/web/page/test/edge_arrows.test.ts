import assert from "node:assert/strict";
import { test } from "node:test";
import { arrowAt, arrowText, EDGE_PX, edgeArrows, type Off } from "../src/view/edge_arrows.ts";
import type { Camera } from "../src/view/camera.ts";

const CAMERA: Camera = { x: 0, y: 0, pxPerM: 10, widthPx: 800, heightPx: 400 };

function off(name: string, x: number, y: number, urgency = 0): Off {
  return { name, x, y, urgency };
}

test("what is on the screen has no arrow", () => {
  assert.deepEqual(edgeArrows(CAMERA, [off("a", 0, 0), off("b", 40, 20), off("c", -40, -20)], []), []);
});

test("an arrow stands at the edge, on the line to its vehicle, and points there", () => {
  const [east] = edgeArrows(CAMERA, [off("a", 100, 0)], []);
  assert.deepEqual([east?.xPx, east?.yPx, east?.angleRad], [800 - EDGE_PX, 200, 0]);
  const [north] = edgeArrows(CAMERA, [off("a", 0, 100)], []);
  assert.deepEqual([north?.xPx, north?.yPx], [400, EDGE_PX]);
  assert.ok(Math.abs((north?.angleRad ?? 0) + Math.PI / 2) < 1e-9);
  for (let turn = 0; turn < 6.28; turn += 0.1) {
    const [x, y] = [1000 * Math.cos(turn), 1000 * Math.sin(turn)];
    const [arrow] = edgeArrows(CAMERA, [off("a", x, y)], []);
    assert.ok(arrow !== undefined && arrow.xPx >= EDGE_PX - 1e-6 && arrow.xPx <= 800 - EDGE_PX + 1e-6 && arrow.yPx >= EDGE_PX - 1e-6 && arrow.yPx <= 400 - EDGE_PX + 1e-6);
    const [dx, dy] = [arrow.xPx - 400, arrow.yPx - 200];
    assert.ok(Math.abs(dx * -y - dy * x) < 1e-6 * 1e6); // on the line
  }
});

test("vehicles in one direction share an arrow, the most urgent gives its name", () => {
  const arrows = edgeArrows(CAMERA, [off("a", 100, 0), off("b", 120, 1), off("c", 300, -2, 2), off("d", -100, 0)], []);
  assert.deepEqual(arrows.map(arrowText), ["c +2", "d"]);
  assert.deepEqual(arrows.map(({ urgency }) => urgency), [2, 0]);
});

test("an arrow goes below buttons, and is found under the pointer", () => {
  const [arrow] = edgeArrows(CAMERA, [off("a", 0, 100)], [{ left: 300, right: 500, top: 5, bottom: 45 }]);
  assert.deepEqual([arrow?.xPx, arrow?.yPx], [400, 45 + EDGE_PX]);
  assert.ok(arrow);
  assert.equal(arrowAt([arrow], 405, 60), arrow);
  assert.equal(arrowAt([arrow], 440, 60), null);
});

test("a view without room, or hundreds of vehicles, is no trouble", () => {
  assert.deepEqual(edgeArrows({ ...CAMERA, widthPx: 20 }, [off("a", 100, 0)], []), []);
  const many = Array.from({ length: 300 }, (_, i) => off(`u${i}`, 500 * Math.cos(i), 500 * Math.sin(i)));
  const arrows = edgeArrows(CAMERA, many, []);
  assert.ok(arrows.length < 70);
  assert.equal(arrows.flatMap(({ names }) => names).length, 300);
});
