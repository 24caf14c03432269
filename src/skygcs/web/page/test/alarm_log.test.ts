import assert from "node:assert/strict";
import { test } from "node:test";
import { AlarmLog, FRESH_S, SOUNDS_S } from "../src/panels/alarm_log.ts";
import { EMPTY, reduce, type Action, type State } from "../src/store.ts";
import type { FleetEvent } from "../src/types.ts";

const NOW = 1_000_000;

function failsafe(time_unix_s: number, vehicle = "alpha"): FleetEvent {
  return { time_unix_s, kind: "failsafe", vehicle, sysid: 1, severity: "alarm", text: "low battery", data: { failsafe: true } };
}

function logged(): { log: AlarmLog; feed: (action: Action) => void; clock: { ms: number } } {
  const clock = { ms: 0 };
  const log = new AlarmLog(() => clock.ms);
  log.muted = false;
  let state: State = EMPTY;
  const feed = (action: Action): void => {
    state = reduce(state, action);
    log.take(action, state, NOW);
  };
  return { log, feed, clock };
}

test("an alarm sounds until it is acknowledged, and not for ever", () => {
  const { log, feed, clock } = logged();
  feed({ type: "recentEvents", events: [], askedAfter: 0 });
  feed({ type: "event", event: failsafe(NOW) });
  assert.deepEqual([log.open, log.sounding], [1, true]);
  clock.ms = SOUNDS_S * 1000 + 1;
  assert.deepEqual([log.open, log.sounding], [1, false]);
  feed({ type: "event", event: failsafe(NOW + 1, "bravo") });
  assert.equal(log.sounding, true);
  log.acknowledgeAll();
  assert.deepEqual([log.open, log.sounding], [0, false]);
});

test("tones and speech are off until a person wants them; then each alarm is said once", () => {
  const fresh = new AlarmLog(() => 0);
  assert.deepEqual([fresh.muted, fresh.speech], [true, false]);
  const { log, feed } = logged();
  feed({ type: "event", event: failsafe(NOW) });
  assert.equal(log.takeSpoken(), "");
  log.speech = true;
  feed({ type: "event", event: failsafe(NOW, "bravo") });
  feed({ type: "event", event: { ...failsafe(NOW), kind: "armed", severity: "info" } });
  assert.equal(log.takeSpoken(), "bravo: low battery");
  assert.equal(log.takeSpoken(), "");
});

test("muted it does not sound, and is open all the same", () => {
  const { log, feed } = logged();
  log.muted = true;
  feed({ type: "event", event: failsafe(NOW) });
  assert.deepEqual([log.open, log.sounding], [1, false]);
});

test("what was long before the page is history, what comes again after a reconnect keeps its mark", () => {
  const { log, feed } = logged();
  const recent = [failsafe(NOW - FRESH_S - 1), failsafe(NOW - 10)];
  feed({ type: "recentEvents", events: recent, askedAfter: 0 });
  assert.deepEqual([log.open, log.sounding], [1, false]);
  log.acknowledgeAll();
  feed({ type: "recentEvents", events: recent, askedAfter: 0 });
  assert.equal(log.open, 0);
  // what came while the connection was lost is not history
  feed({ type: "recentEvents", events: [...recent, failsafe(NOW - FRESH_S - 50, "charlie")], askedAfter: 0 });
  assert.equal(log.open, 1);
});

test("events and acknowledgements are bounded", () => {
  const { log, feed } = logged();
  for (let i = 0; i < 2000; i++) {
    feed({ type: "event", event: failsafe(NOW + i) });
    if (i % 100 === 0) log.acknowledgeAll();
  }
  assert.ok(log.events.length <= 500);
  assert.ok(log.acknowledged.size <= 500);
});
