// How panels ask and order: a read-only method is a call, any other carries a deadline.

import { ORDER_DEADLINE_S, type Connection } from "../connection.ts";
import type { Reader } from "../orders.ts";
import type { State, Store } from "../store.ts";
import type { Method, OwnMethod, Params, Results } from "../types.ts";

/** Longer than the web process gives the check of a file (CHECK_TIMEOUT_S), which says why it was ended. */
const FILE_CHECK_MS = 150_000;

/** Reads that the web process answers itself or passes to anyone. */
export function isRead(state: Pick<State, "hello">, method: string): boolean {
  return method.startsWith("web.") || method === "replay.info" || (state.hello?.methods.read.includes(method) ?? false);
}

/** True if this page may order: not a view, and not a recording. */
export function mayOrder(state: Pick<State, "hello">): boolean {
  return state.hello?.role === "command" && !state.hello.replay;
}

/** Asks without showing it among the orders: what changes nothing in the vehicle, though it may be asked over the radio. */
export function ask<M extends Method>(store: Store, connection: Connection, method: M, params: Params[M]): Promise<Results[M]>;
export function ask<T>(store: Store, connection: Connection, method: OwnMethod, params: object): Promise<T>;
export function ask(store: Store, connection: Connection, method: OwnMethod, params: object): Promise<unknown> {
  return isRead(store.state, method)
    ? connection.call(method, params, { timeoutMs: method.startsWith("web.") ? FILE_CHECK_MS : 15_000 })
    : connection.order(method, params, ORDER_DEADLINE_S);
}

/** The answer of plan.pause and the like. */
export function readMessage({ ok, message, reasons }: { ok: boolean; message: string; reasons: readonly string[] }): ReturnType<Reader<unknown>> {
  return said(ok, [message, ...reasons].join("; "));
}

/** Of an order that is for the fleet as a whole; `why` it was not carried out. */
export function said(ok: boolean, why: string): ReturnType<Reader<unknown>> {
  return { state: ok ? "done" : "failed", outcomes: {}, text: ok ? null : why };
}

/** Of parameters that were set, each an outcome; `trouble`: why some could not be. */
export function readParams(set: Readonly<Record<string, { ok: boolean; message: string }>>, trouble = ""): ReturnType<Reader<unknown>> {
  const outcomes = Object.fromEntries(Object.entries(set).map(([param, { ok, message }]) => [param, { ok, result: ok ? "accepted" : "failed", message }]));
  const ok = trouble === "" && Object.values(outcomes).every((one) => one.ok);
  return { state: ok ? "done" : "failed", outcomes, text: trouble === "" ? null : trouble };
}
