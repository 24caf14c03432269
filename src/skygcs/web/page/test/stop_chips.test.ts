// The STOP board: who holds, who refused and who has not answered, as reports come.

import assert from "node:assert/strict";
import { test } from "node:test";
import { ConnectionLost, type OnReport } from "../src/connection.ts";
import { sendOrder } from "../src/orders.ts";
import { boardText, stopBoard } from "../src/stop_chips.ts";
import { EMPTY, reduce, type Action } from "../src/store.ts";
import type { Outcome } from "../src/types.ts";

const HOLDING: Outcome = { ok: true, result: "accepted", message: "holding" };
const REFUSED: Outcome = { ok: false, result: "denied", message: "denied: requires position" };
const TARGETS = ["v1", "v2", "v3"];

/** A STOP under way, whose reports and end the test gives. */
function pressed() {
  const store = { state: EMPTY, dispatch: (action: Action) => void (store.state = reduce(store.state, action)) };
  let report: OnReport = () => assert.fail("nothing was ordered");
  let end: { resolve: (answer: unknown) => void; reject: (error: Error) => void } | null = null;
  const order = <T>(_method: string, _params: object, _withinS?: number, onReport?: OnReport): Promise<T> => {
    assert.ok(onReport);
    report = onReport;
    return new Promise<T>((resolve, reject) => { end = { resolve: resolve as (answer: unknown) => void, reject }; });
  };
  const done = sendOrder(store, { order }, { label: "STOP all", method: "vehicles.stop", params: {}, targets: TARGETS, to: "all" });
  const states = () => (stopBoard(store.state.orders, performance.now())?.chips ?? []).map(({ name, state }) => `${name} ${state}`);
  return { store, states, done, report: (one: object) => report({ request: 1, ...one }), end: () => { assert.ok(end); return end; } };
}

test("chips fill as answers come, problems first, and stay until they are dismissed", async () => {
  const { store, states, report, done, end } = pressed();
  assert.deepEqual(states(), ["v1 waiting", "v2 waiting", "v3 waiting"]);
  report({ vehicles: [...TARGETS, "v4"] }); // one that this page had not heard of
  report({ vehicle: "v1", outcome: HOLDING });
  report({ vehicle: "v3", outcome: REFUSED });
  assert.deepEqual(states(), ["v3 bad", "v2 waiting", "v4 waiting", "v1 ok"]);
  const board = stopBoard(store.state.orders, performance.now());
  assert.ok(board);
  assert.equal(boardText(board), "1 did not stop, 2 not answered yet, 1 stopped");
  end().resolve({ outcomes: { v1: HOLDING, v2: HOLDING, v3: REFUSED, v4: HOLDING } });
  assert.equal(await done, "failed");
  assert.deepEqual(states(), ["v3 bad", "v1 ok", "v2 ok", "v4 ok"]);
  report({ vehicle: "v1", outcome: REFUSED }); // of an order that has ended
  assert.deepEqual(states(), ["v3 bad", "v1 ok", "v2 ok", "v4 ok"]);
  store.dispatch({ type: "orderDismissed", id: board.ids[0] ?? 0 });
  assert.equal(stopBoard(store.state.orders, 0), null);
});

test("a connection that is lost leaves what was reported, and the rest as not known", async () => {
  const { states, report, done, end } = pressed();
  report({ vehicle: "v2", outcome: HOLDING });
  end().reject(new ConnectionLost());
  assert.equal(await done, "unknown");
  assert.deepEqual(states(), ["v1 open", "v3 open", "v2 ok"]);
});
