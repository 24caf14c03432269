import assert from "node:assert/strict";
import { test } from "node:test";
import { COLUMNS, matches, rowsOf, sorted } from "../src/columns.ts";
import { ageText, fixed, namesText, percentText } from "../src/format.ts";
import { modesFor } from "../src/modes.ts";
import { groupOutcomes } from "../src/outcomes.ts";
import { isStopKey } from "../src/stop_key.ts";
import type { Vehicle } from "../src/store.ts";
import type { VehicleState } from "../src/types.ts";
import { position, vehicle } from "./fleet.ts";

function heard(name: string, sysid: number, more: Partial<VehicleState> = {}): Vehicle {
  return { ...vehicle(name, sysid, more), heard_s: 1000 };
}

function cell(id: string, v: Vehicle, now_s = 1000) {
  const column = COLUMNS.find((one) => one.id === id);
  assert.ok(column);
  return column.cell(v, now_s);
}

test("the table has every column that the issue lists", () => {
  const ids = COLUMNS.map((column) => column.id);
  assert.deepEqual(ids, [
    ...["name", "id", "autopilot", "mode", "armed", "height", "battery", "gps", "link", "age", "loss"],
    ...["failsafe", "guard", "control", "plan", "companion"],
  ]);
});

test("a companion: its connection, else whether it is heard; a column only where one is", () => {
  const with_ = (more: object) => heard("a", 1, { companion: { name: "pi", link: null, since_s: null, error: null, version: "1.0", age_s: null, ...more } });
  assert.deepEqual(cell("companion", with_({ link: "up" })), { text: "up", tone: "good", title: "pi, 1.0" });
  assert.deepEqual(cell("companion", with_({ link: "down", error: "no route" })), { text: "down", tone: "danger", title: "pi, 1.0, no route" });
  assert.equal(cell("companion", with_({ age_s: 0.4 })).text, "heard");
  assert.equal(cell("companion", with_({ age_s: 0.4 }), 1010).text, "silent 10 s");
  assert.equal(cell("companion", with_({})).tone, "warning");
  assert.equal(cell("companion", heard("a", 1)).text, "–");
  const column = COLUMNS.find((one) => one.id === "companion");
  assert.deepEqual([heard("a", 1), with_({})].map((v) => column?.when?.(v)), [false, true]);
});

test("what is not known is a dash, never a number", () => {
  const bare = heard("a", 1, { position: null, mode: null, armed: null, links: {}, last_heartbeat_age_s: null });
  for (const id of ["mode", "armed", "height", "battery", "gps", "link", "loss", "guard", "plan"]) {
    assert.equal(cell(id, bare).text, "–", id);
  }
  assert.equal(cell("age", bare).text, "never");
});

test("a group that is old is grey with its age although the vehicle is heard", () => {
  const v = heard("a", 1, { position: position(0, 0, 12, { age_s: 6 }) });
  assert.deepEqual(cell("height", v), { text: "12.0 m", tone: "muted", title: "6.0 s old" });
});

test("failsafe, low battery, conflicts and deaf vehicles stand out", () => {
  assert.equal(cell("failsafe", heard("a", 1, { failsafe: true })).tone, "danger");
  const battery = (percent: number) => cell("battery", heard("a", 1, { battery: { volts: 14, amps: null, percent, remaining_s: null, age_s: 0 } }));
  assert.deepEqual([battery(80).tone, battery(20).tone, battery(8).tone], ["", "warning", "danger"]);
  assert.equal(cell("armed", heard("a", 1, { separation: { level: "action", with: "b" } })).text, "armed, NEAR b");
  assert.equal(cell("armed", heard("a", 1, { uplink: { heard: false, unanswered: 3, rtt_s: null, age_s: 1 } })).text, "armed, does not hear us");
});

test("sorting: numbers as numbers, unknown last either way, the system id decides", () => {
  const at = (name: string, sysid: number, z: number | null) => heard(name, sysid, z === null ? { position: null } : { position: position(0, 0, z) });
  const fleet = [at("v10", 10, 9), at("v2", 2, 100), at("v3", 3, null), at("v1", 1, 9)];
  const names = (column: string, down: boolean) => sorted(fleet, { column, down }, 1000).map((v) => v.name);
  assert.deepEqual(names("height", false), ["v1", "v10", "v2", "v3"]);
  assert.deepEqual(names("height", true), ["v2", "v1", "v10", "v3"]);
  assert.deepEqual(names("name", false), ["v1", "v2", "v3", "v10"]);
});

test("the filter: all words, in any order, of names, groups, modes and states", () => {
  const v = heard("alpha", 1, { groups: ["scouts"], mode: "AUTO.RTL" });
  for (const words of ["", "alp", "scout rtl", "ARMED in air", "heard", "px4"]) assert.ok(matches(v, words, 1000), words);
  for (const words of ["bravo", "scouts land", "silent"]) assert.ok(!matches(v, words, 1000), words);
  assert.ok(matches(v, "silent", 1100));
});

test("groups have a heading with their vehicles", () => {
  const fleet = [heard("a", 1, { groups: ["x"] }), heard("b", 2), heard("c", 3, { groups: ["x"] })];
  const rows = rowsOf(fleet, "group").map((row) => (row.kind === "group" ? `${row.title}: ${row.names.join(" ")}` : row.vehicle.name));
  assert.deepEqual(rows, ["no group: b", "b", "x: a c", "a", "c"]);
});

test("numbers, ages and names as people read them", () => {
  assert.deepEqual([fixed(-0.04, 1), fixed(-3.25, 1), fixed(null, 1), fixed(NaN, 1)], ["0.0", "−3.3", null, null]);
  assert.deepEqual([ageText(0.04), ageText(9.96), ageText(99), ageText(180), ageText(7200)], ["0.0 s", "10 s", "99 s", "3 min", "2 h"]);
  assert.deepEqual([percentText(0), percentText(0.004), percentText(0.5)], ["0 %", "0.4 %", "50 %"]);
  assert.equal(namesText(["a", "b"]), "a and b");
  assert.equal(namesText(["a", "b", "c", "d", "e"]), "a, b and 3 more");
});

test("a mode is offered if all targets have it", () => {
  assert.ok(modesFor(["px4"]).includes("AUTO.RTL"));
  assert.deepEqual(modesFor(["px4", "ardupilot"]), ["ACRO"]);
  assert.deepEqual(modesFor(["generic"]), []);
  assert.deepEqual(modesFor([]), []);
});

test("outcomes: the same words together, failures first", () => {
  const groups = groupOutcomes({
    a: { ok: true, result: "accepted", message: "armed" },
    b: { ok: false, result: "failed", message: "Arm: Need Position Estimate" },
    c: { ok: true, result: "accepted", message: "armed" },
  });
  assert.deepEqual(groups, [
    { ok: false, unknown: false, text: "Arm: Need Position Estimate", names: ["b"] },
    { ok: true, unknown: false, text: "armed", names: ["a", "c"] },
  ]);
});

test("STOP: Shift+S outside of text fields, F8 everywhere, never a repeat or a browser's own shortcut", () => {
  const key = { key: "S", shiftKey: true, ctrlKey: false, metaKey: false, altKey: false, repeat: false };
  assert.ok(isStopKey(key, false));
  assert.ok(!isStopKey(key, true));
  assert.ok(isStopKey({ ...key, key: "F8", shiftKey: false }, true));
  assert.ok(!isStopKey({ ...key, key: "s", shiftKey: false }, false));
  assert.ok(!isStopKey({ ...key, ctrlKey: true }, false));
  assert.ok(!isStopKey({ ...key, repeat: true }, false));
});
