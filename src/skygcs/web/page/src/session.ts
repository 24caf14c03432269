// What follows each new connection: hello, subscription, origin, recent events. Everything is shown anew.

import type { Connection } from "./connection.ts";
import { frameIsKnown } from "./framed.ts";
import { viewParams } from "./levels.ts";
import type { Store } from "./store.ts";
import type { DaemonLink, FleetEvent, Hello, PlanStatus, StateBatch } from "./types.ts";

export const UPDATES_HZ = 10;
const RECENT_EVENTS = 200;
const ALARM = "alarm";
const ORIGIN = "origin";
const ALARMS_AFTER_MS = 50;
const GREET_AGAIN_MS = 1_000;
const ORIGIN_AGAIN_MS = 1_000;
const VIEW_EVERY_MS = 250;

/** Joins the connection and the store; returns what ends it. */
export function beginSession(connection: Connection, store: Store, nowMs: () => number): () => void {
  let seq: number | null = null;
  let originFollowed = false;
  let view = "";
  let alarmsAsked = false;

  async function subscribe(): Promise<void> {
    seq = (await connection.call<{ seq: number }>("web.subscribe", { rate_hz: UPDATES_HZ })).seq;
  }

  async function fetchOrigin(): Promise<void> {
    const { origin, generation } = await connection.call("origin.get");
    store.dispatch({ type: "origin", origin, generation });
  }

  /** Asks for the origin until it is that of the places: a refusal, or an answer that does not fit, is followed by a pause. */
  async function followOrigin(): Promise<void> {
    if (originFollowed) return;
    originFollowed = true;
    while (connection.phase.kind === "open" && store.state.daemon?.connected === true && !frameIsKnown(store.state)) {
      await fetchOrigin().catch(ignore);
      if (!frameIsKnown(store.state)) await new Promise((resolve) => setTimeout(resolve, ORIGIN_AGAIN_MS));
    }
    originFollowed = false;
  }

  async function fetchEvents(): Promise<void> {
    const askedAfter = store.state.eventsSeen;
    const events = await connection.call("events.recent", { limit: RECENT_EVENTS });
    store.dispatch({ type: "recentEvents", events: events.filter(isNews), askedAfter });
  }

  /** A change of the alarms is an event; of several at once one question is enough. */
  async function fetchAlarms(): Promise<void> {
    if (alarmsAsked) return;
    alarmsAsked = true;
    await new Promise((resolve) => setTimeout(resolve, ALARMS_AFTER_MS));
    alarmsAsked = false;
    const { alarms } = await connection.call("alarms.list");
    store.dispatch({ type: "alarms", alarms });
  }

  async function greet(): Promise<void> {
    const hello = await connection.call<Hello>("web.hello");
    store.dispatch({ type: "hello", hello, atMs: nowMs() });
    seq = null;
    view = "";
    await subscribe();
    connection.settled();
    await fetchFromDaemon();
  }

  /** A refusal, say of too many requests, must not leave a page that is connected and shows nothing. */
  function greetUntilItWorks(): void {
    greet().catch(() => {
      setTimeout(() => {
        if (connection.phase.kind === "open") greetUntilItWorks();
      }, GREET_AGAIN_MS);
    });
  }

  /** Without a daemon these are refused; they are asked for again when it is there. */
  async function fetchFromDaemon(): Promise<void> {
    void followOrigin();
    await Promise.allSettled([fetchEvents(), fetchAlarms()]);
  }

  function onBatch(batch: StateBatch): void {
    if (seq !== null && !batch.full && batch.seq !== seq + 1) {
      seq = null; // until the full one has come
      subscribe().catch(ignore);
      return;
    }
    seq = batch.seq;
    store.dispatch({ type: "batch", batch, atMs: nowMs() });
    void followOrigin();
  }

  /** Of a large fleet: what this page shows in full. */
  function sendView(): void {
    if (store.state.counts === null) return;
    const params = viewParams(store.state, store.near);
    const text = JSON.stringify(params);
    if (text === view) return;
    view = text;
    connection.call("web.view", params).catch(() => { view = ""; });
  }

  function onDaemon(daemon: DaemonLink): void {
    store.dispatch({ type: "daemon", daemon });
    if (daemon.connected && !daemon.slow) void fetchFromDaemon();
  }

  const undo = [
    connection.onPhase((phase) => {
      store.dispatch({ type: "phase", phase });
      if (phase.kind === "open") greetUntilItWorks();
    }),
    connection.on<StateBatch>("web.state", onBatch),
    connection.on<DaemonLink>("web.daemon", onDaemon),
    connection.on<PlanStatus>("web.plan", (plan) => store.dispatch({ type: "plan", plan })),
    connection.on<{ event: FleetEvent }>("event", ({ event }) => {
      if (event.kind === ALARM) fetchAlarms().catch(ignore);
      if (isNews(event)) store.dispatch({ type: "event", event });
      if (event.kind === ORIGIN && event.data["generation"] !== store.state.originGeneration) {
        store.dispatch({ type: "originChanged" });
        void followOrigin();
      }
    }),
  ];
  const viewing = setInterval(sendView, VIEW_EVERY_MS);
  connection.begin();
  return () => {
    clearInterval(viewing);
    for (const each of undo) each();
    connection.end();
  };
}

/** An alarm that no other event reports, say of a battery, is one; any other change of the alarms is in their list only. */
function isNews({ kind, severity }: FleetEvent): boolean {
  return kind !== ALARM || severity !== "info";
}

/** A request failed with its connection: the next connection begins anew. */
function ignore(): void {
  return undefined;
}
