import assert from "node:assert/strict";
import { test } from "node:test";
import { carriedOver, frameIsKnown, frameKey, frameKeyOf, valueIn } from "../src/framed.ts";
import { EMPTY, reduce, type State } from "../src/store.ts";
import type { Origin, Vec3 } from "../src/types.ts";
import { frameAt, fromGeodetic, toGeodetic } from "../src/view/frame.ts";
import { batch, position, vehicle } from "./fleet.ts";

/** What skygcs.core.geo says: EnuFrame(from).to_geodetic(x, y, 0), and the x, y of which EnuFrame(to).to_geodetic(x, y, 0) gives the
 *  same latitude and longitude. That is how the station reads a drawing (skygcs.web.dropped.WorldMap.lat_lon). */
const DRAWN: readonly Vec3[] = [[30, 40, 12], [-1500, 800, 7]];
const HIGH: Origin = { lat_deg: 43.7806, lon_deg: -79.4653, alt_amsl_m: 2000, x_heading_deg: 90 };
const PACIFIC: Origin = { lat_deg: -16.5, lon_deg: 179.99, alt_amsl_m: 1200, x_heading_deg: 90 };
const NORTH: Origin = { lat_deg: 44.2306, lon_deg: -79.4653, alt_amsl_m: 180, x_heading_deg: 37 };
const CARRIED: readonly (readonly [string, Origin, Origin, readonly (readonly [number, number])[]])[] = [
  ["10 km to the east", HIGH, { ...HIGH, lon_deg: -79.341 }, [[-9979.3714, 47.4672], [-11508.2332, 809.7642]]],
  ["50 km to the north, 1,820 m lower, x to 37", HIGH, NORTH, [[-39884.1834, -30092.4424], [-40197.8992, -28413.5653]]],
  ["1,500 m lower", HIGH, { ...HIGH, alt_amsl_m: 500 }, [[29.993, 39.9906], [-1499.6479, 799.8116]]],
  ["over the date line", PACIFIC, { lat_deg: -16.52, lon_deg: -179.98, alt_amsl_m: 300, x_heading_deg: 200 }, [[-1032.005, -3752.3466], [-1222.6006, -5449.8012]]],
];
/** EnuFrame(origin).from_geodetic(lat, lon, origin.alt_amsl_m): how the station draws a place on earth (WorldMap.xy). */
const PLACES: readonly (readonly [Origin, number, number, number, number])[] = [
  [HIGH, 43.8706, -79.4853, -1608.1094, 10003.127],
  [NORTH, 44.3206, -79.4853, 7027.0016, 7293.0151],
  [PACIFIC, -16.41, 179.97, -2136.6697, 9961.4833],
];

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

test("a drawing keeps its places on earth to a millimetre, as the station reads it, at any altitude of the two origins", () => {
  for (const [name, from, to, wanted] of CARRIED) {
    const points = carriedOver(DRAWN, from, to);
    assert.equal(points?.length, wanted.length, name);
    points.forEach(([x, y, up], i) => {
      const [wx, wy] = wanted[i] ?? [NaN, NaN];
      assert.ok(Math.hypot(x - wx, y - wy) < 1e-3, `${name}: ${x}, ${y}`);
      assert.equal(up, DRAWN[i]?.[2]);
    });
    const back = carriedOver(points, to, from) ?? [];
    back.forEach(([x, y], i) => assert.ok(Math.hypot(x - (DRAWN[i]?.[0] ?? NaN), y - (DRAWN[i]?.[1] ?? NaN)) < 1e-4, `${name}, back: ${x}, ${y}`));
  }
  assert.equal(carriedOver(DRAWN, HIGH, { ...HIGH, lat_deg: -43.78, lon_deg: 100 }), null);
});

test("homes and maps lie where the station counts them, at the origin's altitude", () => {
  for (const [origin, lat_deg, lon_deg, wx, wy] of PLACES) {
    const frame = frameAt(origin);
    const [x, y] = fromGeodetic(frame, lat_deg, lon_deg);
    assert.ok(Math.hypot(x - wx, y - wy) < 1e-3, `${x}, ${y}`);
    const back = toGeodetic(frame, x, y);
    assert.ok(Math.abs(back.lat_deg - lat_deg) < 1e-10 && Math.abs(back.lon_deg - lon_deg) < 1e-10);
  }
});

test("the frame is known while each place is counted from the origin that the page has", () => {
  const place = (more: object) => vehicle("a", 1, { position: position(1, 2, 3, more) });
  const with_ = (origin: Origin | null, generation: number, more: object): State =>
    reduce(reduce(EMPTY, { type: "origin", origin, generation }), { type: "batch", batch: batch([vehicle("b", 2, { position: null }), place(more)]), atMs: 0 });
  assert.equal(frameIsKnown(EMPTY), false);
  const known = with_(ORIGIN, 3, { origin_generation: 3 });
  assert.equal(frameIsKnown(known), true);
  assert.equal(frameKeyOf(known), frameKey(ORIGIN));
  assert.equal(frameIsKnown(with_(ORIGIN, 3, { origin_generation: null })), true); // of another site, or in brief
  for (const generation of [2, 4]) assert.equal(frameIsKnown(with_(ORIGIN, 3, { origin_generation: generation })), false);
  assert.equal(frameIsKnown(with_(null, 0, { origin_generation: 0, enu_m: null })), true);
  assert.equal(frameIsKnown(with_(null, 0, { origin_generation: 0 })), false); // a recording has found its origin
  const changed = reduce(known, { type: "originChanged" });
  assert.equal(frameIsKnown(changed), false);
  assert.notEqual(frameKeyOf(changed), frameKey(ORIGIN));
  // the next daemon counts its origins anew
  const gone = reduce(known, { type: "daemon", daemon: { connected: false, slow: false, error: null } as never });
  assert.equal(frameIsKnown(gone), true);
  assert.equal(frameIsKnown(reduce(gone, { type: "daemon", daemon: { connected: true, slow: false, error: null } as never })), false);
});
