import assert from "node:assert/strict";
import { test } from "node:test";
import { PlanPath, PlanTimeline, type Piece } from "../src/panels/plan_timeline.ts";

const UP_AND_OVER: readonly Piece[] = [
  [2, [0], [0], [0, 5]],
  [4, [0, 3], [1], [10]],
];

test("a path is where its polynomials are, and stands before and after", () => {
  const path = new PlanPath(UP_AND_OVER);
  assert.equal(path.duration_s, 6);
  assert.deepEqual(path.at(-1), [0, 0, 0]);
  assert.deepEqual(path.at(1), [0, 0, 5]);
  assert.deepEqual(path.at(2), [0, 1, 10]);
  assert.deepEqual(path.at(4), [6, 1, 10]);
  assert.deepEqual(path.at(99), [12, 1, 10]);
});

test("speed is the derivative, and none outside the path", () => {
  const path = new PlanPath([[2, [0, 1, 2, 0.5], [0], [0]]]);
  assert.equal(path.speedAt(1), 1 + 4 + 1.5);
  assert.equal(path.speedAt(-0.1), 0);
  assert.equal(path.speedAt(2.1), 0);
});

test("a piece is found among many", () => {
  const pieces = Array.from({ length: 1000 }, (_, i): Piece => [0.5, [i, 2], [0], [0]]);
  const path = new PlanPath(pieces);
  for (const t of [0, 0.25, 250, 499.99]) assert.ok(Math.abs(path.at(t)[0] - 2 * t) < 1e-9, String(t));
});

test("the points of a picture are bounded and end where the path ends", () => {
  const pieces = Array.from({ length: 5000 }, (_, i): Piece => [0.1, [i, 10], [0], [0]]);
  const points = new PlanPath(pieces).points(300);
  assert.equal(points.length, 300);
  assert.deepEqual(points.at(-1), [5000, 0, 0]);
  // a curve gets points between its ends
  assert.ok(new PlanPath([[10, [0, 0, 1], [0], [0]]]).points(20).length >= 20);
});

test("the closest pair counts heights by the downwash ratio", () => {
  const hover = (x: number, up: number): readonly Piece[] => [[10, [x], [0], [up]]];
  const timeline = new PlanTimeline({
    exact: true,
    duration_s: 10,
    phases: [],
    vehicles: { alpha: hover(0, 10), bravo: hover(0, 16), charlie: hover(4, 10) },
  });
  assert.deepEqual(timeline.closestAt(5, 2), { pair: ["alpha", "bravo"], distance_m: 3 });
  assert.deepEqual(timeline.closestAt(5, 1), { pair: ["alpha", "charlie"], distance_m: 4 });
});

test("a plan without pieces has no place", () => {
  assert.deepEqual(new PlanPath([]).at(3), [0, 0, 0]);
  assert.deepEqual(new PlanPath([]).points(10), []);
});
