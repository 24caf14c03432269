import assert from "node:assert/strict";
import { test } from "node:test";
import { ALL_EVENTS, keyOf, severityOf, shownEvents, type JudgedEvent } from "../src/panels/event_severity.ts";
import type { FleetEvent } from "../src/types.ts";

function event(kind: string, data: Record<string, unknown> = {}, text = "text", vehicle: string | null = "alpha"): FleetEvent {
  return { time_unix_s: 1, kind, vehicle, sysid: 1, text, data };
}

test("what needs a person is an alarm", () => {
  assert.equal(severityOf(event("failsafe", { failsafe: true }), true), "alarm");
  assert.equal(severityOf(event("failsafe", { failsafe: false }), true), "info");
  assert.equal(severityOf(event("vehicle_lost"), true), "alarm");
  assert.equal(severityOf(event("vehicle_lost"), false), "warning");
  assert.equal(severityOf(event("separation", { level: "action" }), true), "alarm");
  assert.equal(severityOf(event("separation", { level: "notice" }), true), "warning");
  assert.equal(severityOf(event("separation", { level: "none" }), true), "info");
  assert.equal(severityOf(event("separation", { level: "action", order: "hold" }), true), "alarm");
  assert.equal(severityOf(event("control", { state: "held" }), true), "alarm");
  assert.equal(severityOf(event("warning", { action: "land", vehicles: ["alpha"] }), null), "alarm");
  assert.equal(severityOf(event("warning"), null), "warning");
  assert.equal(severityOf(event("unheard_of_kind"), null), "info");
});

test("what a daemon's alarm is for has its severity here, and its end has none", () => {
  assert.equal(severityOf(event("recorder", { recording: false, error: "No space left on device" }), null), "alarm");
  assert.equal(severityOf(event("recorder", { recording: true, lost: 12, seconds: 5 }), null), "warning");
  assert.equal(severityOf(event("recorder", { recording: true, lost: 0, seconds: 5 }), null), "info");
  assert.equal(severityOf(event("duplicate", { change: "duplicate" }), false), "alarm");
  assert.equal(severityOf(event("duplicate", { change: "duplicate_over" }), true), "info");
  assert.equal(severityOf(event("fence", { outside: true }), true), "alarm");
  assert.equal(severityOf(event("fence", { outside: true }), false), "warning");
  assert.equal(severityOf(event("fence", { outside: false }), true), "info");
  assert.equal(severityOf(event("fence", { order: "set" }), true), "info");
  assert.equal(severityOf(event("ground_lost"), true), "alarm");
  assert.equal(severityOf(event("companion", { change: "keys_kept" }), null), "alarm");
  assert.equal(severityOf(event("command", { order: "stop", ok: false, result: "timeout" }), true), "alarm");
  assert.equal(severityOf(event("command", { order: "stop", ok: false, result: "cancelled" }), true), "warning");
  assert.equal(severityOf(event("statustext", { level: 1 }, "Crash: Disarming"), false), "warning");
});

test("a status text is as serious as its level, but a refusal to arm wakes nobody", () => {
  assert.equal(severityOf(event("statustext", { level: 1 }, "Crash: Disarming"), true), "alarm");
  assert.equal(severityOf(event("statustext", { level: 2 }, "PreArm: Compass not calibrated"), false), "warning");
  assert.equal(severityOf(event("statustext", { level: 4 }), false), "warning");
  assert.equal(severityOf(event("statustext", { level: 6 }), false), "info");
  assert.equal(severityOf(event("statustext", { level: "none" }), false), "info");
});

test("an order that failed is a warning", () => {
  assert.equal(severityOf(event("command", { ok: false }), true), "warning");
  assert.equal(severityOf(event("command", { outcome: { ok: false } }), true), "warning");
  assert.equal(severityOf(event("command", { result: "denied" }), true), "warning");
  assert.equal(severityOf(event("command", { result: "accepted" }), true), "info");
});

const LIST: readonly JudgedEvent[] = [
  { ...event("mode", {}, "mode AUTO"), id: 1, severity: "info" },
  { ...event("failsafe", {}, "low battery", "bravo"), id: 2, severity: "alarm" },
  { ...event("link_down", {}, "link radio is down", null), id: 3, severity: "warning" },
];

test("events are filtered by severity, vehicle and words, the newest first", () => {
  const ids = (filter: Partial<typeof ALL_EVENTS>, acknowledged: string[] = []): number[] =>
    shownEvents(LIST, { ...ALL_EVENTS, ...filter }, new Set(acknowledged)).map((one) => one.id);
  assert.deepEqual(ids({}), [3, 2, 1]);
  assert.deepEqual(ids({ severities: new Set(["alarm"]) }), [2]);
  assert.deepEqual(ids({ vehicles: new Set(["alpha"]) }), [1]);
  assert.deepEqual(ids({ words: "RADIO down" }), [3]);
  assert.deepEqual(ids({ words: "bravo" }), [2]);
  assert.deepEqual(ids({ open: true }), [3, 2]);
  assert.deepEqual(ids({ open: true }, [keyOf(LIST[1] as JudgedEvent)]), [3]);
});
