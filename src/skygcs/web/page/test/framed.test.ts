import assert from "node:assert/strict";
import { test } from "node:test";
import { frameKey, valueIn } from "../src/framed.ts";

const ORIGIN = { lat_deg: 43.7806, lon_deg: -79.4653, alt_amsl_m: 180, x_heading_deg: 90 };

test("what was chosen is void in any other frame, and comes back in none", () => {
  const frame = frameKey(ORIGIN);
  const kept = { frame, value: [1, 2] };
  const none: number[] = [];
  assert.equal(valueIn(kept, frameKey({ ...ORIGIN }), none), kept.value);
  assert.equal(valueIn(null, frame, none), none);
  assert.equal(valueIn(kept, frameKey(null), none), none);
  for (const key of ["lat_deg", "lon_deg", "alt_amsl_m", "x_heading_deg"] as const) {
    assert.equal(valueIn(kept, frameKey({ ...ORIGIN, [key]: ORIGIN[key] + 0.5 }), none), none);
  }
});
