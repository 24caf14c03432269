import assert from "node:assert/strict";
import { test } from "node:test";
import { bounds } from "../src/panels/chart_bounds.ts";

test("zeros are a line on the ground of a small range, not of one up to a hundred", () => {
  const [low, high] = bounds(0, 0, null);
  assert.equal(low, 0);
  assert.ok(high > 0 && high < 1);
});

test("millivolts of a battery do not fill the height", () => {
  const [low, high] = bounds(16.44, 16.444, null);
  assert.ok(low < 16.3 && high > 16.58);
});

test("what varies is seen whole, also below zero", () => {
  const [low, high] = bounds(-2, 8, null);
  assert.ok(low <= -2 && high >= 8 && high - low < 12);
  assert.deepEqual(bounds(null, null, null), [0, 1]);
});

test("given bounds are kept", () => {
  assert.deepEqual(bounds(3, 50, [0, 100]), [0, 100]);
  assert.deepEqual(bounds(5, 5, [null, null]), [4.5, 5.5]);
  assert.deepEqual(bounds(0, 0, [0, null]), [0, 1]);
});
