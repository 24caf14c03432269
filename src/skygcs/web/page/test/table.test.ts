import assert from "node:assert/strict";
import { test } from "node:test";
import { COLUMNS, matches, rowsOf, sorted } from "../src/columns.ts";
import { ageText, fixed, namesText, percentText } from "../src/format.ts";
import { modesFor } from "../src/modes.ts";
import { groupOutcomes } from "../src/outcomes.ts";
import { isStopKey } from "../src/stop_key.ts";
import { EMPTY, type Vehicle } from "../src/store.ts";
import { isChosen, parsedChoices } from "../src/table_choices.ts";
import type { PlanStatus, VehicleState } from "../src/types.ts";
import type { Surroundings } from "../src/vehicle_status.ts";
import { part, position, vehicle } from "./fleet.ts";

function heard(name: string, sysid: number, more: Partial<VehicleState> = {}): Vehicle {
  return { ...vehicle(name, sysid, more), heard_s: 1000 };
}

function cell(id: string, v: Vehicle, now_s = 1000, around: Surroundings = EMPTY) {
  const column = COLUMNS.find((one) => one.id === id);
  assert.ok(column);
  return column.cell(v, now_s, around);
}

test("one column says the status; those of engineers are shown to people who choose them", () => {
  const shown = COLUMNS.filter((column) => isChosen(parsedChoices(null), column)).map(({ id }) => id);
  assert.deepEqual(shown, ["name", "id", "autopilot", "mode", "status", "armed", "height", "battery", "gps", "link", "age", "loss", "companion"]);
  const others = COLUMNS.map(({ id }) => id).filter((id) => !shown.includes(id));
  assert.deepEqual(others, ["x", "y", "up", "attitude", "speed", "target", "error"]);
});

test("choices are kept, and what was kept by something else is left out", () => {
  const kept = parsedChoices(JSON.stringify({ problemsFirst: false, columns: { x: true, gps: false, y: "yes" } }));
  assert.equal(kept.problemsFirst, false);
  const shown = COLUMNS.filter((column) => isChosen(kept, column)).map(({ id }) => id);
  assert.ok(shown.includes("x") && !shown.includes("gps") && !shown.includes("y"));
  for (const text of ["", "[", "3", "null", '{"columns": 3}']) assert.deepEqual(parsedChoices(text), parsedChoices(null), text);
});

test("columns by choice: place, attitude, speed, target and error, in the units of people", () => {
  const control = { state: "flying" as const, mode: "position", control_mode: "position", reference: { pos_enu_m: [1, null, 3], vel_enu_mps: null, yaw_deg: null }, error_m: 0.256 };
  const v = heard("a", 1, {
    position: position(1, -2, 12, { vel_enu_mps: [3, 4, 0] }),
    attitude: part({ roll_deg: 1.4, pitch_deg: -2, yaw_deg: 181, age_s: 0.1 }),
    control,
  });
  const texts = ["x", "y", "up", "attitude", "speed", "target", "error"].map((id) => cell(id, v).text);
  assert.deepEqual(texts, ["1.0 m", "−2.0 m", "12.0 m", "1° −2° 181°", "5.0 m/s", "1.0  –  3.0", "0.26 m"]);
  assert.equal(cell("target", heard("a", 1, { control: { ...control, state: "off" } })).text, "–");
});

test("the status: trouble, else the guard, the plan, our control, the mission", () => {
  const flying = { state: "flying" as const, mode: "position", control_mode: "position_velocity" };
  const plan = part<PlanStatus>({
    ...{ plan: "1", name: "show", kind: "timed", state: "running", phase: null, step: 2, steps: 3, reason: "", speed: 1, waits_for: [] },
    clock: part({ trajectory_s: 10, duration_s: 44, finishes_in_s: 34.4 }),
    vehicles: [part({ vehicle: "a", state: "flying", error_m: 0.1, tube_m: 1, left: null })],
  });
  const text = (more: Partial<VehicleState>, around: Surroundings = EMPTY) => cell("status", heard("a", 1, more), 1000, around);
  assert.deepEqual([text({}).text, text({}).narrow], ["–", "armed"]);
  assert.equal(text({ control: flying }).text, "position velocity");
  assert.equal(text({ control: flying }, { plan, events: [] }).text, "plan show, 34 s left");
  assert.equal(text({ control: flying }, { plan: { ...plan, state: "landed" }, events: [] }).text, "position velocity", "it is over");
  const held = text({ control: { ...flying, state: "held", reasons: ["pose is 2 s old", "tilt"] } }, { plan, events: [] });
  assert.deepEqual([held.text, held.tone, held.under], ["held: pose is 2 s old, tilt", "danger", "armed"]);
  assert.equal(text({ control: { ...flying, reasons: ["near the fence"] } }).tone, "warning");
  assert.equal(text({ separation: { level: "notice", with: "b" } }).text, "near b");
  const mission = part<NonNullable<VehicleState["mission"]>>({ item: 2, count: 5 });
  assert.equal(text({ mode: "AUTO.MISSION", mission }).text, "mission 2/5");
  assert.equal(text({ mode: "AUTO.LOITER", mission }).text, "–", "it has one, and does not fly it");
  assert.equal(text({ replayed: true }).text, "replay");
  assert.equal(cell("armed", heard("a", 1, { replayed: true })).text, "armed");
});

test("a failsafe says the vehicle's own words, and what it does", () => {
  const event = (id: number, vehicle: string, last_warning: string) =>
    ({ id, time_unix_s: id, kind: "failsafe", vehicle, sysid: 1, severity: "alarm" as const, text: "", data: { failsafe: true, last_warning } });
  const events = [event(1, "a", "old"), event(2, "a", "GPS lost"), event(3, "b", "not of this one")];
  const of = (more: Partial<VehicleState>, around: Surroundings = { plan: null, events }) => cell("status", heard("a", 1, { failsafe: true, ...more }), 1000, around);
  assert.equal(of({ mode: "AUTO.LAND" }).text, "FAILSAFE: GPS lost, landing");
  assert.equal(of({ mode: "RTL" }, EMPTY).text, "FAILSAFE: returning");
  assert.equal(of({ mode: "STABILIZE" }, EMPTY).text, "FAILSAFE");
  assert.equal(of({ mode: "RTL", uplink: { heard: false, unanswered: 1, rtt_s: null, age_s: 0 } }, EMPTY).text, "FAILSAFE: returning, does not hear us");
  assert.match(cell("status", heard("a", 1, { failsafe: true }), 1060).text, /^lost at 10\.0 m, 60 s$/, "what it said then is not of now");
});

test("problems stand first, the worst at the top, however the rest is sorted", () => {
  const fleet = [
    heard("fine", 1),
    heard("silent", 2, { connected: false, landed: "on_ground" }),
    heard("failing", 3, { failsafe: true }),
    heard("lost", 4, { connected: false }),
    heard("good", 5),
  ];
  const names = (column: string, down: boolean, first: boolean) => sorted(fleet, { column, down }, 1000, EMPTY, first).map((v) => v.name);
  assert.deepEqual(names("name", true, true), ["lost", "failing", "silent", "good", "fine"]);
  assert.deepEqual(names("id", false, true), ["lost", "failing", "silent", "fine", "good"]);
  assert.deepEqual(names("id", false, false), ["fine", "silent", "failing", "lost", "good"]);
  assert.deepEqual(names("status", false, false), ["lost", "failing", "silent", "fine", "good"]);
});

test("a companion: its connection, else whether it is heard; a column only where one is", () => {
  const with_ = (more: object) => heard("a", 1, { companion: { name: "pi", link: null, since_s: null, error: null, version: "1.0", age_s: null, ...more } });
  assert.deepEqual(cell("companion", with_({ link: "up" })), { text: "up", tone: "good", title: "pi, 1.0" });
  assert.deepEqual(cell("companion", with_({ link: "down", error: "no route" })), { text: "down", tone: "danger", title: "pi, 1.0, no route" });
  assert.equal(cell("companion", with_({ age_s: 0.4 })).text, "heard");
  assert.equal(cell("companion", with_({ age_s: 0.4 }), 1010).text, "not heard 10 s");
  assert.equal(cell("companion", with_({})).tone, "warning");
  assert.equal(cell("companion", heard("a", 1)).text, "–");
  const column = COLUMNS.find((one) => one.id === "companion");
  assert.deepEqual([heard("a", 1), with_({})].map((v) => column?.when?.(v)), [false, true]);
});

test("what is not known is a dash, never a number", () => {
  const bare = heard("a", 1, { position: null, mode: null, armed: null, links: {}, last_heartbeat_age_s: null });
  for (const id of ["mode", "armed", "height", "battery", "gps", "link", "loss", "status", "speed", "target", "error"]) {
    assert.equal(cell(id, bare).text, "–", id);
  }
  assert.equal(cell("age", bare).text, "never");
});

test("a group that is old is grey with its age although the vehicle is heard", () => {
  const v = heard("a", 1, { position: position(0, 0, 12, { age_s: 6 }) });
  assert.deepEqual(cell("height", v), { text: "12.0 m", tone: "muted", title: "6.0 s old" });
});

test("failsafe, low battery, conflicts and deaf vehicles stand out", () => {
  assert.equal(cell("status", heard("a", 1, { failsafe: true })).tone, "danger");
  const battery = (percent: number) => cell("battery", heard("a", 1, { battery: part({ volts: 14, percent }) }));
  assert.deepEqual([battery(80).tone, battery(20).tone, battery(8).tone], ["", "warning", "danger"]);
  assert.equal(cell("status", heard("a", 1, { separation: { level: "action", with: "b" } })).text, "near b");
  assert.equal(cell("status", heard("a", 1, { uplink: { heard: false, unanswered: 3, rtt_s: null, age_s: 1 } })).text, "does not hear us");
});

test("sorting: numbers as numbers, unknown last either way, the system id decides", () => {
  const at = (name: string, sysid: number, z: number | null) => heard(name, sysid, z === null ? { position: null } : { position: position(0, 0, z) });
  const fleet = [at("v10", 10, 9), at("v2", 2, 100), at("v3", 3, null), at("v1", 1, 9)];
  const names = (column: string, down: boolean) => sorted(fleet, { column, down }, 1000, EMPTY).map((v) => v.name);
  assert.deepEqual(names("height", false), ["v1", "v10", "v2", "v3"]);
  assert.deepEqual(names("height", true), ["v2", "v1", "v10", "v3"]);
  assert.deepEqual(names("name", false), ["v1", "v2", "v3", "v10"]);
});

test("the filter: all words, in any order, of names, groups, modes and states", () => {
  const v = heard("alpha", 1, { groups: ["scouts"], mode: "AUTO.RTL" });
  for (const words of ["", "alp", "scout rtl", "ARMED in air", "heard", "px4"]) assert.ok(matches(v, words, 1000), words);
  for (const words of ["bravo", "scouts land", "silent"]) assert.ok(!matches(v, words, 1000), words);
  assert.ok(matches(v, "silent", 1100));
  const standing = heard("bravo", 2, { armed: false, landed: "on_ground" });
  assert.ok(!matches(standing, "armed", 1000), "nothing that is disarmed is found by “armed”");
  for (const words of ["disarmed", "dis", "ground", "bravo"]) assert.ok(matches(standing, words, 1000), words);
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
