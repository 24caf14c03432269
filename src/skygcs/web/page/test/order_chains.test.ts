import assert from "node:assert/strict";
import { test } from "node:test";
import type { Method } from "../src/types.ts";
import { OrderChain, type OrderChain as Chain, sendOrder } from "../src/orders.ts";
import { canPause } from "../src/setpoint_orders.ts";
import { vehicle } from "./fleet.ts";

type Sent = Parameters<typeof sendOrder>;

function station() {
  const methods: string[] = [];
  const store = { state: { names: ["a", "b", "c"] }, dispatch: () => undefined } as unknown as Sent[0];
  const connection = { order: (method: string) => {
    methods.push(method);
    return Promise.resolve({ outcomes: { a: { ok: true, result: "accepted", message: "", elapsed_s: 1 } } });
  } } as unknown as Sent[1];
  const send = (method: Method, targets: readonly string[] | null, chain?: Chain) => sendOrder(store, connection, { label: method, method, params: {}, targets, chain });
  return { methods, send };
}

test("a newer chain ends the older one before its next step, whichever answers last", async () => {
  const { methods, send } = station();
  const small = new OrderChain(["a", "b"]);
  assert.equal(await send("control.set", ["a", "b"], small), "done");
  const large = new OrderChain(["b", "c"]);
  assert.ok(!small.goesOn && large.goesOn);
  assert.equal(await send("trajectory.start", ["a", "b"], small), "failed");
  assert.equal(await send("trajectory.start", ["b", "c"], large), "done");
  assert.deepEqual(methods, ["control.set", "trajectory.start"]);
  large.end();
  assert.ok(!large.goesOn);
});

test("any other order for one of its vehicles ends a chain, and STOP for all ends each", async () => {
  const { methods, send } = station();
  const [first, other] = [new OrderChain(["a"]), new OrderChain(["b"])];
  await send("vehicles.hold", ["a"]);
  assert.ok(!first.goesOn && other.goesOn);
  assert.equal(await send("vehicles.goto", ["a"], first), "failed");
  await send("vehicles.stop", null);
  assert.ok(!other.goesOn);
  assert.deepEqual(methods, ["vehicles.hold", "vehicles.stop"]);
});

test("what can be paused is: one that is paused keeps no other from it", () => {
  const on = (state: string) => ({ ...vehicle("a", 1, { control: { state: "flying", mode: null, control_mode: "position", trajectory: { name: "square", state } } }), heard_s: 0 });
  assert.ok(canPause(on("running")) && !canPause(on("paused")) && !canPause(on("finished")) && !canPause(undefined));
});
