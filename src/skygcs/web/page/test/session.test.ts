import assert from "node:assert/strict";
import { mock, test } from "node:test";
import type { Connection } from "../src/connection.ts";
import { frameIsKnown } from "../src/framed.ts";
import { beginSession } from "../src/session.ts";
import { Store } from "../src/store.ts";
import type { Origin } from "../src/types.ts";
import { batch, position, vehicle } from "./fleet.ts";

const OLD: Origin = { lat_deg: 43.7806, lon_deg: -79.4653, alt_amsl_m: 180, x_heading_deg: 90 };
const NEW: Origin = { ...OLD, lat_deg: 43.7816 };

/** A connection whose daemon answers at once; origin.get as `answer` says. */
class Station {
  phase = { kind: "connecting" as string };
  asked = 0;
  answer: () => { origin: Origin | null; generation: number } = () => ({ origin: OLD, generation: 1 });
  private readonly listeners = new Map<string, (params: unknown) => void>();
  private phased: (phase: unknown) => void = () => undefined;

  on(method: string, listener: (params: unknown) => void): () => void {
    this.listeners.set(method, listener);
    return () => undefined;
  }
  onPhase(listener: (phase: unknown) => void): () => void {
    this.phased = listener;
    return () => undefined;
  }
  async call(method: string): Promise<unknown> {
    await Promise.resolve();
    switch (method) {
      case "web.hello":
        return { now_s: 1000, daemon: { connected: true, slow: false } };
      case "web.subscribe":
        return { seq: 0 };
      case "origin.get":
        this.asked += 1;
        return this.answer();
      case "events.recent":
        return [];
      default:
        return { alarms: [] };
    }
  }
  settled(): void { /* nothing waits for it */ }
  begin(): void {
    this.phase = { kind: "open" };
    this.phased(this.phase);
  }
  end(): void { /* nothing is open */ }
  say(method: string, params: unknown): void {
    this.listeners.get(method)?.(params);
  }
}

async function settle(): Promise<void> {
  for (let i = 0; i < 30; i++) await Promise.resolve();
}

async function session(run: (station: Station, store: Store, place: (generation: number) => Promise<void>, pass: (ms: number) => Promise<void>) => Promise<void>): Promise<void> {
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  const station = new Station();
  const store = new Store((then) => then());
  const end = beginSession(station as unknown as Connection, store, () => 0);
  let seq = 0;
  const place = async (generation: number): Promise<void> => {
    seq += 1;
    station.say("web.state", batch([vehicle("a", 1, { position: position(1, 2, 3, { origin_generation: generation }) })], { seq, full: seq === 1 }));
    await settle();
  };
  const pass = async (ms: number): Promise<void> => {
    mock.timers.tick(ms);
    await settle();
  };
  try {
    await settle();
    await run(station, store, place, pass);
  } finally {
    end();
    mock.timers.reset();
  }
}

const refuse = (): never => { throw new Error("too many requests"); };

test("an origin that was refused is asked for again, with a pause, until it is that of the places", () =>
  session(async (station, store, place, pass) => {
    await place(1);
    assert.deepEqual([store.state.origin, store.state.originGeneration, frameIsKnown(store.state)], [OLD, 1, true]);
    station.answer = refuse;
    const before = station.asked;
    for (let i = 0; i < 20; i++) await place(2); // as many batches: one question
    assert.equal(station.asked, before + 1);
    assert.deepEqual([store.state.origin, frameIsKnown(store.state)], [OLD, false]);
    await pass(1_000);
    assert.equal(station.asked, before + 2);
    station.answer = () => ({ origin: NEW, generation: 2 });
    await pass(1_000);
    assert.deepEqual([store.state.origin, store.state.originGeneration, frameIsKnown(store.state)], [NEW, 2, true]);
    await place(2);
    await pass(10_000);
    assert.equal(station.asked, before + 3); // and no more
  }));

test("an answer of before the change is not taken for the new origin", () =>
  session(async (station, store, place, pass) => {
    await place(1);
    await place(2); // the daemon's answer is still the old one
    assert.equal(frameIsKnown(store.state), false);
    station.answer = () => ({ origin: NEW, generation: 2 });
    await pass(1_000);
    assert.deepEqual([store.state.origin, frameIsKnown(store.state)], [NEW, true]);
  }));

test("a change of the origin is followed without any vehicle, and after a refusal too", () =>
  session(async (station, store, _place, pass) => {
    assert.deepEqual([store.state.origin, frameIsKnown(store.state)], [OLD, true]);
    station.answer = refuse;
    station.say("event", { event: { time_unix_s: 1, kind: "origin", vehicle: null, sysid: null, text: "", data: { generation: 2 } } });
    await settle();
    assert.equal(frameIsKnown(store.state), false);
    station.answer = () => ({ origin: NEW, generation: 2 });
    await pass(1_000);
    assert.deepEqual([store.state.origin, frameIsKnown(store.state)], [NEW, true]);
    const { asked } = station;
    station.say("event", { event: { time_unix_s: 1, kind: "origin", vehicle: null, sysid: null, text: "", data: { generation: 2 } } });
    await settle();
    assert.equal(station.asked, asked);
  }));

test("a first question that was refused is repeated", () =>
  session(async (station, store, _place, pass) => {
    station.answer = refuse;
    station.say("web.daemon", { connected: false, slow: false });
    station.say("web.daemon", { connected: true, slow: false });
    await settle();
    assert.equal(frameIsKnown(store.state), false);
    station.answer = () => ({ origin: NEW, generation: 1 });
    await pass(1_000);
    assert.deepEqual([store.state.origin, frameIsKnown(store.state)], [NEW, true]);
  }));

test("the page lists an alarm that no other event reports, and no other change of the alarms", () =>
  session(async (station, store) => {
    const alarm = { time_unix_s: 1, kind: "alarm", vehicle: "a", sysid: null, severity: "alarm", text: "battery 10 %", data: {} };
    station.say("event", { event: alarm });
    station.say("event", { event: { ...alarm, severity: "info", text: "battery is over" } });
    await settle();
    assert.deepEqual(store.state.events.map(({ text }) => text), ["battery 10 %"]);
  }));
