import assert from "node:assert/strict";
import { test } from "node:test";
import { largestError, planText } from "../src/plan_status.ts";
import type { PlanStatus } from "../src/types.ts";
import { part } from "./fleet.ts";

const STATUS = part<PlanStatus>({
  plan: "1", name: "show", kind: "phased", state: "running", phase: "cross", step: 2, steps: 3, reason: "", speed: 1,
  clock: part({ trajectory_s: 10, duration_s: 44, finishes_in_s: 34.2 }), waits_for: [],
  vehicles: [
    { vehicle: "a", state: "flying", error_m: 0.5, tube_m: 1.0, left: null },
    { vehicle: "b", state: "flying", error_m: 0.4, tube_m: 0.5, left: null },
    { vehicle: "c", state: "flying", error_m: 9, tube_m: 1, left: "taken by its pilot" },
    { vehicle: "d", state: "flying", error_m: null, tube_m: 1, left: null },
  ].map(part<PlanStatus["vehicles"][number]>),
});

test("a plan is said in one line, and one that is over has no step left", () => {
  assert.equal(planText(STATUS), "running, cross (step 2 of 3), 34 s left");
  assert.equal(planText({ ...STATUS, state: "finished" }), "finished");
  assert.equal(planText({ ...STATUS, state: "taking_off", phase: "", steps: 0, clock: null }), "taking off");
});

test("the largest error is the one that has used up most of what it may, of those that still fly it", () => {
  assert.deepEqual(largestError(STATUS), { vehicle: "b", error_m: 0.4, tube_m: 0.5 });
  assert.equal(largestError({ vehicles: [] }), null);
});
