import assert from "node:assert/strict";
import { test } from "node:test";
import { drawnShapes, goalsTool, MAX_DRAWN_POINTS, NOTHING_DRAWN, pointsTool, type Drawing } from "../src/panels/drafts.ts";
import type { Vec3 } from "../src/types.ts";
import type { PointerAt } from "../src/view/overlays.ts";

const at = (x: number, y: number): PointerAt => ({ x, y, reachM: 2, shift: false });

function kept(): { drawing: Drawing; tool: ReturnType<typeof pointsTool> } {
  const box = { drawing: NOTHING_DRAWN };
  const keeper = { get: () => box.drawing, set: (next: Drawing) => (box.drawing = next) };
  return Object.assign(box, { tool: pointsTool(keeper, "draw", () => 15) });
}

test("clicks add points at the height, and a click on one selects it", () => {
  const box = kept();
  box.tool.click?.(at(0, 0));
  box.tool.click?.(at(20.04, 0));
  box.tool.click?.(at(1, 1));
  assert.deepEqual(box.drawing, {
    points: [
      [0, 0, 15],
      [20, 0, 15],
    ],
    selected: 0,
  });
});

test("a drag moves the point under it, and one beside all points is not taken", () => {
  const box = kept();
  box.tool.click?.(at(0, 0));
  assert.equal(box.tool.grab?.(at(9, 9)), false);
  assert.ok(box.tool.grab(at(1, 0)));
  box.tool.dragTo?.(at(5, 6), false);
  box.tool.dragTo?.(at(7, 8), true);
  box.tool.dragTo?.(at(50, 60), true);
  assert.deepEqual(box.drawing.points, [[7, 8, 15]]);
});

test("a drawing is bounded", () => {
  const box = kept();
  for (let i = 0; i < MAX_DRAWN_POINTS + 50; i++) box.tool.click?.(at(i * 10, 0));
  assert.equal(box.drawing.points.length, MAX_DRAWN_POINTS);
});

test("goals are dragged by their places and keep their heights", () => {
  const goals = new Map<string, Vec3>([
    ["alpha", [0, 0, 10]],
    ["bravo", [10, 0, 20]],
  ]);
  const tool = goalsTool(
    () => goals,
    (name, place) => goals.set(name, place),
    "drag",
  );
  assert.equal(tool.grab?.(at(10.5, 0)), true);
  tool.dragTo?.(at(30, 31), true);
  assert.deepEqual(goals.get("bravo"), [30, 31, 20]);
  assert.deepEqual(goals.get("alpha"), [0, 0, 10]);
});

test("a fence is closed and filled when it has an area", () => {
  const points: Vec3[] = [
    [0, 0, 0],
    [5, 0, 0],
    [5, 5, 0],
  ];
  const [path] = drawnShapes({ points, selected: null }, true);
  assert.ok(path?.kind === "path" && path.closed === true);
  const [line] = drawnShapes({ points: points.slice(0, 2), selected: null }, true);
  assert.ok(line?.kind === "path" && line.closed === false);
  assert.deepEqual(drawnShapes(NOTHING_DRAWN, true), []);
});
