// A large fleet: briefs and full states are one list, and nothing stays in full that is not sent any more.

import assert from "node:assert/strict";
import { test } from "node:test";
import { namesText } from "../src/format.ts";
import { fullName, siteOf, viewParams } from "../src/levels.ts";
import { fleetFigures, siteRows } from "../src/columns.ts";
import { EMPTY, isHeard, reduce, type State } from "../src/store.ts";
import type { Brief } from "../src/types.ts";
import { batch, vehicle } from "./fleet.ts";

const COUNTS = { vehicles: 2, heard: 2, armed: 1, in_air: 1, problems: 0, oldest_age_s: 0.2 };

function brief(name: string, at_s = 1000): Brief {
  return [name, 7, "px4", true, "in_air", false, true, 0.2, 1, 2, 3, 90, at_s];
}

function large(): State {
  const first = batch([vehicle("south/v1", 1)], {
    brief: [brief("south/v2"), brief("v1")],
    sites: [{ site: "", ...COUNTS }, { site: "south", ...COUNTS }],
  });
  return reduce(EMPTY, { type: "batch", batch: first, atMs: 0 });
}

test("briefs are vehicles, of which what is not sent is not known", () => {
  const state = large();
  assert.deepEqual(state.names, ["v1", "south/v1", "south/v2"]);
  assert.deepEqual(state.sites, ["", "south"]);
  const one = state.vehicles.get("south/v2");
  assert.ok(one !== undefined && one.brief && isHeard(one, 1001) && !isHeard(one, 1006));
  assert.deepEqual([one.mode, one.battery, one.position?.enu_m], [null, null, [1, 2, 3]]);
  const placed: Brief = ["south/v3", 7, "px4", true, "in_air", false, true, 0.2, null, null, null, null, 1000, 43.5, -79.5];
  const elsewhere = reduce(state, { type: "batch", batch: batch([], { full: false, brief: [placed] }), atMs: 0 });
  const position = elsewhere.vehicles.get("south/v3")?.position;
  assert.deepEqual([position?.enu_m, position?.lat_deg], [null, 43.5], "without an origin the view makes a frame of its own");
});

test("a vehicle that leaves the view is a brief, and one that enters it is not", () => {
  const next = batch([vehicle("south/v2", 7)], { full: false, seq: 2, brief: [brief("south/v1")] });
  const state = reduce(large(), { type: "batch", batch: next, atMs: 0 });
  assert.equal(state.vehicles.get("south/v1")?.brief, true);
  assert.equal(state.vehicles.get("south/v2")?.brief, undefined);
  assert.equal(state.counts?.length, 2, "counts hold until the next ones come");
});

test("a fleet that is not large any more has no counts", () => {
  const state = reduce(large(), { type: "batch", batch: batch([vehicle("v1", 1)]), atMs: 0 });
  assert.equal(state.counts, null);
});

test("a site's row unfolds to its vehicles that were sent in full", () => {
  let state = large();
  const full = [...state.vehicles.values()].filter((one) => one.brief !== true);
  assert.deepEqual(siteRows(state, full, 1000).map((row) => row.kind), ["site", "site"]);
  state = reduce(state, { type: "unfold", site: "south" });
  const rows = siteRows(state, full, 1000);
  assert.deepEqual(rows.map((row) => row.kind), ["site", "site", "vehicle"]);
  assert.ok(rows[1]?.kind === "site" && rows[1].names.join() === "south/v1,south/v2", "it selects all of them");
  state = reduce(state, { type: "search", search: "v1" });
  const found = siteRows(state, full, 1000);
  assert.deepEqual(found.map((row) => row.kind), ["site", "vehicle"]);
});

test("sites of a small fleet are counted by the page", () => {
  const fleet = batch([vehicle("v1", 1), vehicle("south/v1", 1, { failsafe: true }), vehicle("south/v2", 2, { connected: false })]);
  const state = reduce(EMPTY, { type: "batch", batch: fleet, atMs: 0 });
  const counts = siteRows(state, [], 1000).map((row) => (row.kind === "site" ? [row.counts.vehicles, row.counts.heard, row.counts.problems] : []));
  assert.deepEqual(counts, [[1, 1, 0], [2, 1, 2]]);
});

test("what is selected and near is asked for, within the server's bounds", () => {
  let state = reduce(large(), { type: "unfold", site: "south" });
  state = reduce(state, { type: "select", names: ["v1"], how: "only" });
  assert.deepEqual(viewParams(state, ["south/v2"]), { sites: ["south"], search: "", names: ["v1", "south/v2"] });
  const many = Array.from({ length: 400 }, (_, i) => `v${i}`);
  assert.equal(viewParams(state, many).names.length, 300);
});

test("a name says its site where there are several", () => {
  const hello = { daemon: { site: "north" } } as unknown as State;
  assert.equal(fullName(hello, "alpha"), "north/alpha");
  assert.equal(fullName(hello, "south/alpha"), "south/alpha");
  assert.equal(fullName(EMPTY, "alpha"), "alpha");
  assert.deepEqual([siteOf("alpha"), siteOf("south/alpha")], ["", "south"]);
  assert.equal(namesText(["north/a", "north/b", "south/a", "south/b"]), "2 of north and 2 of south");
  assert.equal(namesText(["a", "b", "c", "d"]), "a, b and 2 more");
});

test("a vehicle that was lost in the air stays in the counts; one that is silent on the ground does not", () => {
  const state = [vehicle("flew", 1), vehicle("stood", 2, { landed: "on_ground", armed: false })].reduce(
    (before, each) => reduce(before, { type: "batch", batch: batch([each], { full: false }), atMs: 0 }),
    EMPTY,
  );
  const all = [...state.vehicles.values()];
  assert.deepEqual(fleetFigures(all, 1000), { vehicles: 2, armed: 1, inAir: 1, failsafe: 0, silent: 0, silentInAir: 0 });
  assert.deepEqual(fleetFigures(all, 1060), { vehicles: 2, armed: 1, inAir: 1, failsafe: 0, silent: 2, silentInAir: 1 });
});
