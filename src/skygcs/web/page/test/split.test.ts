import assert from "node:assert/strict";
import { test } from "node:test";
import { LEAST_SHARE, MOST_SHARE, parsedShare, shareAfter, shareAt } from "../src/split.ts";

test("what was kept is a share within the limits, or none", () => {
  assert.deepEqual(["30", "99", "-4", "", "x", "NaN", null].map(parsedShare), [30, MOST_SHARE, LEAST_SHARE, null, null, null, null]);
});

test("the table's edge follows the pointer, and some of each part stays", () => {
  assert.equal(shareAt(652, 52, 800), 25);
  assert.equal(shareAt(52, 52, 800), MOST_SHARE);
  assert.equal(shareAt(2000, 52, 800), LEAST_SHARE);
  assert.ok(Number.isFinite(shareAt(5, 0, 0)));
});

test("keys move it, and give it back to its rows", () => {
  assert.equal(shareAfter("ArrowUp", 30), 34);
  assert.equal(shareAfter("ArrowDown", 30), 26);
  assert.equal(shareAfter("PageUp", 75), MOST_SHARE);
  assert.equal(shareAfter("Home", 30), LEAST_SHARE);
  assert.equal(shareAfter("Enter", 30), null);
  assert.equal(shareAfter("a", 30), undefined);
});
