import assert from "node:assert/strict";
import { test } from "node:test";
import { ageOf, EMPTY, isHeard, MAX_EVENTS, MAX_ORDERS, reduce, serverNowS, silenceOf, type OrderRun, type State, type Vehicle } from "../src/store.ts";
import { TRAIL_POINTS, Trails } from "../src/trails.ts";
import { batch, position, vehicle } from "./fleet.ts";

function after(...batches: ReturnType<typeof batch>[]): State {
  return batches.reduce((state, one) => reduce(state, { type: "batch", batch: one, atMs: 0 }), EMPTY);
}

function only(state: State): Vehicle {
  const [first] = state.vehicles.values();
  assert.ok(first);
  return first;
}

test("vehicles are in the order of their system ids", () => {
  const state = after(batch([vehicle("b", 2), vehicle("z", 1), vehicle("a", 10)]));
  assert.deepEqual(state.names, ["z", "b", "a"]);
});

test("a batch merges, a full one forgets everything else", () => {
  const first = after(batch([vehicle("a", 1), vehicle("b", 2)]));
  const merged = reduce(first, { type: "batch", batch: batch([vehicle("c", 3)], { full: false }), atMs: 0 });
  assert.deepEqual(merged.names, ["a", "b", "c"]);
  const anew = reduce(merged, { type: "batch", batch: batch([vehicle("c", 3)]), atMs: 0 });
  assert.deepEqual(anew.names, ["c"]);
  assert.equal(anew.generation, first.generation + 1);
});

test("what is gone is selected no longer", () => {
  let state = after(batch([vehicle("a", 1), vehicle("b", 2)]));
  state = reduce(state, { type: "select", names: ["a", "b"], how: "only" });
  state = reduce(state, { type: "batch", batch: batch([], { full: false, gone: ["b"] }), atMs: 0 });
  assert.deepEqual([...state.selection], ["a"]);
  assert.equal(state.shown, "a");
});

test("selection survives everything being shown anew, for vehicles that are still there", () => {
  let state = after(batch([vehicle("a", 1), vehicle("b", 2)]));
  state = reduce(state, { type: "select", names: ["a", "b"], how: "only" });
  state = reduce(state, { type: "batch", batch: batch([vehicle("b", 2)]), atMs: 0 });
  assert.deepEqual([...state.selection], ["b"]);
});

test("what does not exist cannot be selected", () => {
  const state = reduce(after(batch([vehicle("a", 1)])), { type: "select", names: ["ghost"], how: "only" });
  assert.equal(state.selection.size, 0);
});

test("ages grow while nothing comes: in the batch, on its way, and on the page", () => {
  const state = after(batch([vehicle("a", 1)], { now_s: 1000.5, heard_s: 1000 }));
  assert.equal(serverNowS(state, 2000), 1002.5);
  const one = only(state);
  assert.equal(ageOf(one, one.position, serverNowS(state, 2000)), 2.6);
  assert.equal(silenceOf(one, serverNowS(state, 2000)), 2.6);
});

test("a vehicle is not heard after five seconds of silence, whatever was last said of it", () => {
  const state = after(batch([vehicle("a", 1)]));
  assert.equal(isHeard(only(state), serverNowS(state, 4_000)), true);
  assert.equal(isHeard(only(state), serverNowS(state, 5_500)), false);
});

test("a vehicle that the daemon does not hear is not heard, although its ages are small", () => {
  const state = after(batch([vehicle("a", 1, { connected: false })]));
  assert.equal(isHeard(only(state), 1000), false);
});

test("an event that came while the recent ones were on their way stays", () => {
  const at = (time_unix_s: number) => ({ time_unix_s, kind: "failsafe", vehicle: "a", sysid: 1, severity: "alarm" as const, text: String(time_unix_s), data: {} });
  const live = [1, 2, 3, 4].map(at).reduce((state, event) => reduce(state, { type: "event", event }), EMPTY);
  const asked = reduce(live, { type: "recentEvents", events: [at(0), at(3)], askedAfter: 2 });
  assert.deepEqual(asked.events.map(({ text }) => text), ["0", "3", "4"]);
  // of before the question nothing stays: after a new connection everything is shown anew
  const anew = reduce(live, { type: "recentEvents", events: [], askedAfter: live.eventsSeen });
  assert.deepEqual(anew.events, []);
});

test("events, orders and trails are bounded", () => {
  let state = EMPTY;
  const event = { time_unix_s: 1, kind: "armed", vehicle: "a", sysid: 1, severity: "info" as const, text: "", data: {} };
  for (let i = 0; i < MAX_EVENTS + 50; i++) state = reduce(state, { type: "event", event });
  assert.equal(state.events.length, MAX_EVENTS);
  assert.equal(new Set(state.events.map(({ id }) => id)).size, MAX_EVENTS);
  const order: OrderRun = { id: 0, label: "", method: "", targets: [], startedMs: 0, endedMs: null, state: "pending", outcomes: {}, error: null };
  for (let id = 0; id < MAX_ORDERS + 10; id++) state = reduce(state, { type: "orderBegun", order: { ...order, id } });
  assert.equal(state.orders.length, MAX_ORDERS);
  const trails = new Trails();
  for (let i = 0; i < 3 * TRAIL_POINTS; i++) trails.take(batch([vehicle("a", 1, { position: position(i, 0, 10) })], { full: false }));
  const xs: number[] = [];
  trails.byName.get("a")?.each((x) => xs.push(x));
  assert.equal(xs.length, TRAIL_POINTS);
  assert.equal(xs[0], 2 * TRAIL_POINTS);
  assert.equal(xs.at(-1), 3 * TRAIL_POINTS - 1);
});

test("a trail begins with arming, has no line over a jump, and begins anew with a new origin", () => {
  const trails = new Trails();
  const take = (x: number, more: object = {}, armed = true): void =>
    trails.take(batch([vehicle("a", 1, { armed, position: position(x, 0, 0, more) })], { full: false }));
  take(0, {}, false);
  assert.equal(trails.byName.size, 0);
  for (const x of [0, 1, 2, 500, 501]) take(x);
  const joined: boolean[] = [];
  trails.byName.get("a")?.each((_x, _y, _z, j) => joined.push(j));
  assert.deepEqual(joined, [false, true, true, false, true]);
  take(9, { origin_generation: 2 });
  assert.equal(trails.byName.get("a")?.length, 1);
});

test("a sleep of the computer counts in all ages", () => {
  const state = reduce(after(batch([vehicle("a", 1)])), { type: "slept", ms: 60_000 });
  assert.equal(isHeard(only(state), serverNowS(state, 100)), false);
});
