import assert from "node:assert/strict";
import { test } from "node:test";
import { fenceShapes } from "../src/planned_paths.ts";
import { EMPTY, reduce, type OrderRun, type State } from "../src/store.ts";
import { frameAt } from "../src/view/frame.ts";
import type { FenceResult } from "../src/rpc_types.ts";
import { batch, part, position, vehicle } from "./fleet.ts";

const ORDER: OrderRun = { id: 1, label: "", method: "", targets: [], startedMs: 0, endedMs: null, state: "pending", outcomes: {}, error: null };

function sentTo(x: number): State {
  const state = reduce(EMPTY, { type: "batch", batch: batch([vehicle("a", 1), vehicle("b", 2)]), atMs: 0 });
  return reduce(state, { type: "goals", goals: new Map([["a", [x, 0, 10]]]) });
}

function at(state: State, x: number): State {
  const moved = vehicle("a", 1, { position: position(x, 0, 10) });
  return reduce(state, { type: "batch", batch: batch([moved], { full: false }), atMs: 0 });
}

test("a goal is shown until the vehicle is there", () => {
  const state = at(sentTo(20), 10);
  assert.ok(state.goals.has("a"));
  assert.ok(!at(state, 19).goals.has("a"));
});

test("another origin ends all goals: their metres were counted from the one before", () => {
  const origin = { lat_deg: 43.7806, lon_deg: -79.4653, alt_amsl_m: 180, x_heading_deg: 90 };
  const state = reduce(reduce(EMPTY, { type: "origin", origin, generation: 1 }), { type: "goals", goals: new Map([["a", [1, 2, 3]]]) });
  assert.equal(reduce(state, { type: "origin", origin: { ...origin }, generation: 1 }).goals.size, 1);
  assert.equal(reduce(state, { type: "origin", origin: { ...origin, x_heading_deg: 0 }, generation: 2 }).goals.size, 0);
  assert.equal(reduce(state, { type: "origin", origin: { ...origin, alt_amsl_m: 2000 }, generation: 2 }).goals.size, 0);
  assert.equal(reduce(state, { type: "origin", origin: null, generation: 2 }).goals.size, 0);
});

test("a goal is shown until the vehicle gets another order", () => {
  const state = sentTo(20);
  assert.ok(reduce(state, { type: "orderBegun", order: { ...ORDER, targets: ["b"] } }).goals.has("a"));
  assert.ok(!reduce(state, { type: "orderBegun", order: { ...ORDER, targets: ["a"] } }).goals.has("a"));
});

test("fences about one home with one radius are one circle; those that are off are none", () => {
  const home = { lat_deg: 43.7806, lon_deg: -79.4653, alt_amsl_m: 180, age_s: 1 };
  const fleet = ["a", "b", "c", "d"].map((name, i) => vehicle(name, i + 1, { home: name === "d" ? null : home }));
  const state = reduce(EMPTY, { type: "batch", batch: batch(fleet), atMs: 0 });
  const fence = (enabled: boolean, radius_m: number | null) => part<FenceResult>({ ok: true, fence: part({ enabled, radius_m, height_m: null }) });
  const outcomes = { a: fence(true, 100), b: fence(true, 100), c: fence(false, 50), d: fence(true, 70) };
  const shapes = fenceShapes(outcomes, { state }, frameAt({ ...home, x_heading_deg: 90 }));
  assert.deepEqual(shapes.map((shape) => shape.kind === "circle" && shape.radiusM), [100]);
  assert.deepEqual(fenceShapes(outcomes, { state }, null), []);
});
