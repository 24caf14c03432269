import assert from "node:assert/strict";
import { test } from "node:test";
import { clockText, placeAt, type ReplayInfo } from "../src/panels/replay_time.ts";

const INFO: ReplayInfo = { file: "a.tlog", start_unix_s: 0, duration_s: 100, position_s: 40, playing: true, speed: 5, ended: false };

test("a recording goes on between reports at its speed, and not beyond its end", () => {
  assert.equal(placeAt(INFO, 1000, 3000), 50);
  assert.equal(placeAt(INFO, 1000, 60_000), 100);
  assert.equal(placeAt({ ...INFO, playing: false }, 1000, 3000), 40);
  // a report that came after the picture was begun
  assert.equal(placeAt(INFO, 3000, 1000), 40);
});

test("times are read as a clock", () => {
  assert.equal(clockText(0), "0:00.0");
  assert.equal(clockText(61.25), "1:01.2");
  assert.equal(clockText(3723.4), "1:02:03.4");
  assert.equal(clockText(-5), "0:00.0");
});
