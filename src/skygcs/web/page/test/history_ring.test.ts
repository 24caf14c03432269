import assert from "node:assert/strict";
import { test } from "node:test";
import { HistoryRing, RateMeter } from "../src/panels/histories.ts";

test("a history is bounded and keeps the newest rows", () => {
  const ring = new HistoryRing(2, 100);
  for (let i = 0; i < 10_000; i++) ring.add(i, [i, -i]);
  assert.equal(ring.length, 100);
  const [times, one, other] = ring.columns();
  assert.deepEqual([times[0], times.at(-1)], [9900, 9999]);
  assert.ok(one !== undefined && other !== undefined);
  assert.deepEqual([one.at(-1), other.at(-1), one.length], [9999, -9999, 100]);
  assert.deepEqual(ring.columns([1])[1]?.at(-1), -9999);
});

test("a row that is not newer is left out, and what is not known is a gap", () => {
  const ring = new HistoryRing(3, 10);
  assert.ok(ring.add(1, [1, null, Number.NaN]));
  assert.ok(!ring.add(1, [2, 2, 2]));
  assert.ok(!ring.add(0.5, [2, 2, 2]));
  assert.ok(!ring.add(Number.NaN, [2, 2, 2]));
  assert.deepEqual(ring.columns(), [[1], [1], [null], [null]]);
  ring.clear();
  assert.equal(ring.length, 0);
  assert.ok(ring.add(0.5, [7]));
  assert.deepEqual(ring.columns(), [[0.5], [7], [null], [null]]);
});

test("a rate comes from two readings, and a counter that fell began anew", () => {
  const meter = new RateMeter();
  assert.equal(meter.read(10, 100), null);
  assert.equal(meter.read(12, 150), 25);
  assert.equal(meter.read(12, 160), null);
  assert.equal(meter.read(13, 5), null);
  assert.equal(meter.read(14, 15), 10);
});
