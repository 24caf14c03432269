import assert from "node:assert/strict";
import { test } from "node:test";
import { grouped, groupText, type Severity, spokenText } from "../src/panels/event_severity.ts";
import type { NumberedEvent } from "../src/store.ts";

let id = 0;

function event(at_s: number, kind: string, vehicle: string | null, data: Record<string, unknown> = {}, text = kind, severity: Severity = "info"): NumberedEvent {
  return { id: id++, time_unix_s: 1000 + at_s, kind, vehicle, sysid: 1, text, data, severity };
}

function newestFirst(...events: NumberedEvent[]): NumberedEvent[] {
  return events.sort((a, b) => b.time_unix_s - a.time_unix_s);
}

function loss(): NumberedEvent[] {
  return newestFirst(
    event(0, "vehicle_lost", "u02", {}, "no heartbeat for 3.1 s", "alarm"),
    ...Array.from({ length: 19 }, (_, i) => event(i - 2, "separation", `u${i + 10}`, { with: "u02", level: "warning" }, "near u02", "alarm")),
  );
}

test("what followed from a loss is one row with it, also what came just before it", () => {
  const [group, ...others] = grouped(loss());
  assert.equal(others.length, 0);
  assert.deepEqual([group?.head.kind, group?.more.length, group?.names], ["vehicle_lost", 19, []]);
});

test("what happens when the vehicle is back, or to others, is not of the loss", () => {
  const rows = newestFirst(
    ...loss(),
    event(40, "vehicle_back", "u02"),
    event(50, "separation", "u10", { with: "u02" }),
    event(5, "separation", "u30", { with: "u31" }),
    event(5, "failsafe", "u02"),
  );
  assert.deepEqual(grouped(rows).map(({ head, more }) => [head.kind, more.length]), [["separation", 0], ["vehicle_back", 0], ["separation", 0], ["failsafe", 0], ["vehicle_lost", 19]]);
});

test("ten vehicles that change their mode are one row, two are two", () => {
  const ten = Array.from({ length: 10 }, (_, i) => event(i, "mode", `u0${i}`, { mode: "OFFBOARD", was: i % 2 ? "HOLD" : "LAND" }, `was ${i}`));
  const [group, ...others] = grouped(newestFirst(...ten, event(3, "mode", "u20", { mode: "AUTO.LAND" })));
  assert.deepEqual([group?.names.length, others.length], [10, 1]);
  assert.equal(groupText(group as never), "→ OFFBOARD: u00, u01, u02, u03, u04 and 5 more");
  assert.equal(grouped(ten.slice(0, 2).reverse()).length, 2);
});

test("what is minutes apart, of another severity, of no vehicle or of one vehicle stays apart", () => {
  const rows = newestFirst(event(0, "armed", "a"), event(60, "armed", "b"), event(120, "armed", "c"));
  assert.equal(grouped(rows).length, 3);
  const mixed = [event(0, "statustext", "a", {}, "x"), event(0, "statustext", "b", {}, "x"), event(0, "statustext", "c", {}, "x", "alarm")];
  assert.equal(grouped(mixed).length, 3);
  assert.equal(grouped([1, 2, 3].map(() => event(0, "warning", null, {}, "x"))).length, 3);
  assert.equal(grouped([1, 2, 3].map(() => event(0, "statustext", "a", {}, "x"))).length, 3);
});

test("no event is lost or doubled", () => {
  const rows = newestFirst(...loss(), ...["a", "b", "c"].map((name, i) => event(i, "armed", name)), event(9, "vehicle_lost", "u10"));
  const all = grouped(rows).flatMap(({ head, more }) => [head, ...more].map((one) => one.id));
  assert.deepEqual([...all].sort(), rows.map((one) => one.id).sort());
});

test("of alarms that came together the first is said, and how many there are", () => {
  assert.equal(spokenText([]), "");
  assert.equal(spokenText([event(0, "failsafe", "u02", {}, "battery low", "alarm")]), "u02: battery low");
  assert.equal(spokenText([event(0, "failsafe", "u02", {}, "battery low", "alarm"), event(0.1, "fault", null, {}, "disk", "alarm")]), "u02: battery low. 1 more alarm");
  assert.equal(spokenText(["a", "b", "c"].map((name) => event(0, "vehicle_lost", name, {}, "3.1 s", "alarm"))), "3 vehicles: vehicle lost");
});

test("events that are too few for a group stay where they happened", () => {
  const rows = newestFirst(
    event(100, "statustext", "alpha", {}, "GPS glitch"),
    event(98, "failsafe", "bravo"),
    event(96, "statustext", "alpha", {}, "GPS glitch"),
  );
  assert.deepEqual(grouped(rows).map(({ head }) => head.time_unix_s - 1000), [100, 98, 96]);
});
