import assert from "node:assert/strict";
import { test } from "node:test";
import { markAfter, markBefore, type Mark } from "../src/panels/replay_time.ts";

function mark(at_s: number): Mark {
  return { at_s, event: { time_unix_s: at_s, kind: "mode", vehicle: "v1", sysid: 1, severity: "alarm", text: `at ${at_s}`, data: {} } };
}

test("the next mark in either direction", () => {
  const marks = [mark(1), mark(2), mark(2), mark(5)];
  assert.equal(markBefore(marks, 0.5), null);
  assert.equal(markBefore(marks, 2)?.at_s, 2);
  assert.equal(markBefore(marks, 99)?.at_s, 5);
  assert.equal(markAfter(marks, 0)?.at_s, 1);
  assert.equal(markAfter(marks, 2)?.at_s, 5, "the one it is at is not after it");
  assert.equal(markAfter(marks, 5), null);
  assert.equal(markBefore([], 1), null);
});
