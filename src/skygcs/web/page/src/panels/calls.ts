// How panels ask and order: a read-only method is a call, any other carries a deadline.

import { ORDER_DEADLINE_S, type Connection } from "../connection.ts";
import { runOrder } from "../orders.ts";
import type { State, Store } from "../store.ts";
import type { Outcome } from "../types.ts";

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
export function ask<T>(store: Store, connection: Connection, method: string, params: object = {}): Promise<T> {
  return isRead(store.state, method)
    ? connection.call<T>(method, params, { timeoutMs: method.startsWith("web.") ? FILE_CHECK_MS : 15_000 })
    : connection.order<T>(method, params, ORDER_DEADLINE_S);
}

/** What an answer says of each vehicle, or of the fleet as a whole. */
export type Reader<T> = (answer: T) => { ok: boolean; outcomes: Readonly<Record<string, Outcome>>; text: string | null };

/** An order whose parameters are not `targets`, shown in the list of orders as every order. Never rejects. */
export function orderWith<T>(
  store: Store,
  connection: Connection,
  request: { label: string; method: string; params: object; targets: readonly string[] },
  read: Reader<T>,
): Promise<T | null> {
  return runOrder<T>(store, connection, request, (answer) => {
    const { ok, outcomes, text } = read(answer);
    return { state: ok ? "done" : "failed", outcomes, text };
  });
}

/** The answer of plan.pause and the like. */
export function readMessage(answer: { ok: boolean; message: string; reasons?: readonly string[] }): ReturnType<Reader<unknown>> {
  const text = [answer.message, ...(answer.reasons ?? [])].join("; ");
  return { ok: answer.ok, outcomes: {}, text: answer.ok ? null : text };
}
