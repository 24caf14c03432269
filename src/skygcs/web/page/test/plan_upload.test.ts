import assert from "node:assert/strict";
import { test } from "node:test";
import { PART_CHARS, givenPlan } from "../src/panels/plan_upload.ts";
import type { Params } from "../src/rpc_types.ts";

test("a plan that a request holds is sent as it is", async () => {
  const given = await givenPlan('{"a": 1}', () => Promise.reject(new Error("not in parts")));
  assert.deepEqual(given, { plan: { a: 1 } });
});

test("a larger one goes in parts, in order, under the number of the first", async () => {
  const text = JSON.stringify({ values: Array.from({ length: 200_000 }, (_, i) => i) });
  const parts: Params["plan.upload"][] = [];
  const given = await givenPlan(text, (part) => {
    parts.push(part);
    return Promise.resolve({ upload: 7 });
  });
  assert.deepEqual(given, { upload: 7 });
  assert.equal(parts.map(({ part }) => part).join(""), text);
  assert.deepEqual(parts.map(({ upload }) => upload), [null, ...parts.slice(1).map(() => 7)]);
  assert.ok(parts.every(({ part }) => part.length <= PART_CHARS));
});
