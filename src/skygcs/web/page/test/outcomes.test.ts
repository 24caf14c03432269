// The outcome of an order to another site whose answer was lost: what is shown, and what asking for it brings.

import assert from "node:assert/strict";
import { test } from "node:test";
import { RpcError } from "../src/connection.ts";
import { askOutcomes, sendOrder } from "../src/orders.ts";
import { groupOutcomes, isUnknown, outcomeOf, stateOf } from "../src/outcomes.ts";
import { EMPTY, reduce, type Action } from "../src/store.ts";
import type { Outcome, SiteAnswer } from "../src/types.ts";

const KEY = "9c6af8408d0890231e0ad1171ed7a477";
const ACCEPTED: Outcome = { ok: true, result: "accepted", message: "accepted" };
const REFUSED: Outcome = { ok: false, result: "refused", message: "refused: it is not armed", id: `south/${KEY}` };

function unanswered(site: string, n = 0): Outcome {
  const id = `${site}/${KEY.slice(0, -3)}${String(n).padStart(3, "0")}`;
  return { ok: false, result: "unknown", message: `outcome unknown: ${site} has not answered: no reply; ask: skygcs-cli federation outcome ${id}`, id };
}

function answer(status: SiteAnswer["status"], text = "", outcome: Outcome | null = null): SiteAnswer {
  return { id: `south/${KEY}`, status, text, outcome };
}

interface Asked {
  method: string;
  params: object;
}

/** Answers an order with these outcomes, and each question by `reply`. */
function connectionOf(outcomes: Record<string, Outcome>, reply: (id: string) => Promise<SiteAnswer>) {
  const asked: Asked[] = [];
  const order = <T>(method: string, params: object): Promise<T> => {
    asked.push({ method, params });
    const answered: Promise<unknown> = method === "federation.outcome" ? reply((params as { id: string }).id) : Promise.resolve({ outcomes });
    return answered as Promise<T>;
  };
  return { asked, connection: { order } };
}

async function ordered(outcomes: Record<string, Outcome>, reply: (id: string) => Promise<SiteAnswer>) {
  const store = { state: EMPTY, dispatch: (action: Action) => void (store.state = reduce(store.state, action)) };
  const { asked, connection } = connectionOf(outcomes, reply);
  await sendOrder(store, connection, { label: "Land", method: "vehicles.land", params: {}, targets: Object.keys(outcomes) });
  const run = () => {
    const [order] = store.state.orders;
    assert.ok(order);
    return order;
  };
  return { store, asked, connection, run };
}

test("an order that only lacks answers has not failed, and one with a refusal has", () => {
  assert.equal(stateOf({ a: ACCEPTED }), "done");
  assert.equal(stateOf({ a: ACCEPTED, b: unanswered("south") }), "unknown");
  assert.equal(stateOf({ a: REFUSED, b: unanswered("south") }), "failed");
  assert.equal(stateOf({}), "done");
});

test("vehicles whose answers were lost are one line, without the command of a shell", () => {
  const groups = groupOutcomes({ "south/a": unanswered("south", 1), v1: ACCEPTED, "south/b": unanswered("south", 2) });
  assert.deepEqual(groups, [
    { ok: false, unknown: true, text: "outcome unknown: south has not answered: no reply", names: ["south/a", "south/b"] },
    { ok: true, unknown: false, text: "accepted", names: ["v1"] },
  ]);
});

test("a refusal has an id, too, and nothing to be asked for", () => {
  assert.equal(isUnknown(REFUSED), false);
  assert.equal(isUnknown({ ok: false, result: "unknown", message: "no id" }), false);
});

test("each answer of the site is an outcome, and only what is still open can be asked for again", () => {
  const of = (...given: Parameters<typeof answer>): [boolean, string, boolean] => {
    const outcome = outcomeOf(answer(...given));
    return [outcome.ok, outcome.message, isUnknown(outcome)];
  };
  assert.deepEqual(of("done", "", { ...ACCEPTED, message: "landing" }), [true, "landing", false]);
  assert.deepEqual(of("done"), [true, "done", false]);
  assert.deepEqual(of("failed", "denied", { ok: false, result: "denied", message: "denied by v1" }), [false, "denied by v1", false]);
  assert.deepEqual(of("failed", "no ack"), [false, "no ack", false]);
  for (const status of ["refused", "late", "never came"] as const) {
    assert.deepEqual(of(status, "after its deadline"), [false, "not carried out: after its deadline", false]);
  }
  assert.deepEqual(of("running"), [false, "still being carried out", true]);
  assert.deepEqual(of("unknown", "south does not answer"), [false, "outcome unknown: south does not answer", true]);
});

test("asking settles the vehicles that are asked for, and sends no order", async () => {
  const outcomes = { "south/a": unanswered("south", 1), "south/b": unanswered("south", 2), "east/c": unanswered("east"), v1: ACCEPTED };
  const { store, asked, connection, run } = await ordered(outcomes, (id) =>
    Promise.resolve(id.endsWith("1") ? answer("done", "", ACCEPTED) : answer("never came", "it did not come")),
  );
  assert.equal(run().state, "unknown");
  await askOutcomes(store, connection, run(), ["south/a", "south/b", "v1", "nobody"]);
  assert.deepEqual(
    asked.slice(1),
    [outcomes["south/a"], outcomes["south/b"]].map(({ id }) => ({ method: "federation.outcome", params: { id } })),
  );
  assert.equal(run().outcomes["south/a"]?.message, "accepted");
  assert.equal(run().outcomes["south/b"]?.message, "not carried out: it did not come");
  assert.equal(run().outcomes["east/c"], outcomes["east/c"]);
  assert.equal(run().state, "failed");
});

test("an order whose last open outcome is found well is done", async () => {
  const { store, connection, run } = await ordered({ "south/a": unanswered("south") }, () => Promise.resolve(answer("done", "", ACCEPTED)));
  await askOutcomes(store, connection, run(), ["south/a"]);
  assert.equal(run().state, "done");
});

test("a question that is not answered leaves the outcome open, to be asked for again", async () => {
  let away = true;
  const { store, connection, run } = await ordered({ "south/a": unanswered("south") }, () =>
    away ? Promise.reject(new RpcError(-32601, "no method federation.outcome", null)) : Promise.resolve(answer("done", "", ACCEPTED)),
  );
  await askOutcomes(store, connection, run(), ["south/a"]);
  assert.equal(run().state, "unknown");
  assert.match(run().outcomes["south/a"]?.message ?? "", /^outcome unknown, and not asked for: no method/);
  away = false;
  await askOutcomes(store, connection, run(), ["south/a"]);
  assert.equal(run().state, "done");
});

test("many vehicles are asked for a few at a time", async () => {
  const names = Array.from({ length: 50 }, (_, n) => `south/v${n}`);
  let open = 0;
  let most = 0;
  const { store, asked, connection, run } = await ordered(
    Object.fromEntries(names.map((name, n) => [name, unanswered("south", n)])),
    async () => {
      most = Math.max(most, ++open);
      await new Promise((resolve) => setImmediate(resolve));
      open--;
      return answer("done", "", ACCEPTED);
    },
  );
  await askOutcomes(store, connection, run(), names);
  assert.equal(asked.length, 51);
  assert.ok(most > 1 && most <= 8, String(most));
  assert.equal(run().state, "done");
});
