// How panels ask and order: a read-only method is a call, any other carries a deadline.

import { ConnectionLost, ORDER_DEADLINE_S, type Connection } from "../connection.ts";
import { refusalText } from "../orders.ts";
import type { State, Store } from "../store.ts";
import type { Outcome } from "../types.ts";

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
    ? connection.call<T>(method, params, { timeoutMs: method.startsWith("web.") ? 60_000 : 15_000 })
    : connection.order<T>(method, params, ORDER_DEADLINE_S);
}

let nextId = 1_000_000;

/** What an answer says of each vehicle, or of the fleet as a whole, in the terms of the list of orders. */
export type Reader<T> = (answer: T) => { ok: boolean; outcomes: Readonly<Record<string, Outcome>>; text: string | null };

/** An order whose parameters are not `targets`, shown in the list of orders as every order. Never rejects. */
export async function orderWith<T>(
  store: Store,
  connection: Connection,
  request: { label: string; method: string; params: object; targets: readonly string[] },
  read: Reader<T>,
): Promise<T | null> {
  const id = nextId++;
  store.dispatch({
    type: "orderBegun",
    order: {
      id,
      label: request.label,
      method: request.method,
      targets: request.targets,
      startedMs: performance.now(),
      endedMs: null,
      state: "pending",
      outcomes: {},
      error: null,
    },
  });
  const atMs = (): number => performance.now();
  try {
    const answer = await connection.order<T>(request.method, request.params, ORDER_DEADLINE_S);
    const { ok, outcomes, text } = read(answer);
    store.dispatch({ type: "orderEnded", id, atMs: atMs(), state: ok ? "done" : "failed", outcomes, error: text });
    return answer;
  } catch (error) {
    const state = error instanceof ConnectionLost ? "unknown" : "failed";
    store.dispatch({ type: "orderEnded", id, atMs: atMs(), state, outcomes: {}, error: refusalText(error) });
    return null;
  }
}

/** The answer of plan.pause and the like. */
export function readMessage(answer: { ok: boolean; message: string; reasons?: readonly string[] }): ReturnType<Reader<unknown>> {
  const text = [answer.message, ...(answer.reasons ?? [])].join("; ");
  return { ok: answer.ok, outcomes: {}, text: answer.ok ? null : text };
}
