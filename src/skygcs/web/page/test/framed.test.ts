import assert from "node:assert/strict";
import { test } from "node:test";
import { carriedOver, frameKey, valueIn } from "../src/framed.ts";
import type { Vec3 } from "../src/types.ts";

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

test("a drawing keeps its places on earth in another frame, and has none without an origin", () => {
  const drawn: Vec3[] = [[30, 40, 12], [-5, 0, 7]];
  assert.equal(carriedOver(drawn, ORIGIN, { ...ORIGIN }), drawn);
  assert.equal(carriedOver(drawn, null, ORIGIN), null);
  assert.equal(carriedOver(drawn, ORIGIN, null), null);
  const near = (points: readonly Vec3[] | null, wanted: readonly Vec3[]): void => {
    assert.equal((points ?? []).length, wanted.length);
    (points ?? []).forEach((point, i) => point.forEach((value, k) => assert.ok(Math.abs(value - (wanted[i]?.[k] ?? NaN)) < 1e-3, `${value}`)));
  };
  // x to the north: what lay to the east lies to the right of it
  near(carriedOver(drawn, ORIGIN, { ...ORIGIN, x_heading_deg: 0 }), [[40, -30, 12], [0, 5, 7]]);
  // 1e-4 degrees of latitude are 11.11 m at 43.78 degrees north (WGS84: 111 111 m a degree)
  near(carriedOver(drawn, ORIGIN, { ...ORIGIN, lat_deg: ORIGIN.lat_deg + 1e-4 }), [[30, 28.889, 12], [-5, -11.111, 7]]);
});
