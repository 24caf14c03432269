import assert from "node:assert/strict";
import { test } from "node:test";
import { ALL_EVENTS, keyOf, shownEvents } from "../src/panels/event_severity.ts";
import type { NumberedEvent } from "../src/store.ts";
import type { FleetEvent } from "../src/types.ts";

function event(kind: string, data: Record<string, unknown> = {}, text = "text", vehicle: string | null = "alpha"): Omit<FleetEvent, "severity"> {
  return { time_unix_s: 1, kind, vehicle, sysid: 1, text, data };
}

const LIST: readonly NumberedEvent[] = [
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
  assert.deepEqual(ids({ open: true }, [keyOf(LIST[1] as NumberedEvent)]), [3]);
});
