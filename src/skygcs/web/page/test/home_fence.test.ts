import assert from "node:assert/strict";
import { test } from "node:test";
import { fenceParams, fenceText } from "../src/panels/home_fence.tsx";
import { plannedShapes } from "../src/planned_paths.ts";

test("a fence's form sets only what was filled in", () => {
  assert.equal(fenceParams({ radiusM: null, heightM: null, action: "leave" }), null);
  assert.deepEqual(fenceParams({ radiusM: 0, heightM: null, action: "leave" }), { radius_m: 0 });
  assert.deepEqual(fenceParams({ radiusM: 80, heightM: 40, action: "return" }), { radius_m: 80, height_m: 40, action: "return" });
});

test("the held button says what the fence will be", () => {
  assert.equal(fenceText({ radiusM: 80, heightM: 0, action: "terminate" }), "radius 80 m, no height, then stop the motors");
  assert.equal(fenceText({ radiusM: null, heightM: null, action: "none" }), "off");
});

test("a path that is flown is a line, one that is loaded is dashed, and one without points is left out", () => {
  const points = [[0, 0, 5], [10, 0, 5]] as const;
  const shapes = plannedShapes([
    { vehicle: "v1", name: "a", flown: true, points_enu_m: points },
    { vehicle: "v2", name: "b", flown: false, points_enu_m: points },
    { vehicle: "v3", name: "c", flown: false, points_enu_m: [] },
  ]);
  assert.deepEqual(shapes.filter((shape) => shape.kind === "path").map(({ dashed }) => dashed), [false, true]);
  assert.deepEqual(shapes.map((shape) => (shape.kind === "path" ? shape.vehicle : "")).filter(Boolean), ["v1", "v2"]);
  assert.equal(shapes.filter((shape) => shape.kind === "mark").length, 4);
});
