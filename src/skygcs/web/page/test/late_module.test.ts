import assert from "node:assert/strict";
import { test } from "node:test";
import { LateModule } from "../src/late_module.ts";

/** A module whose tries end as the test says. */
function late(): { module: LateModule<string>; tries: { done: (text: string) => void; failed: () => void }[]; seen: string[] } {
  const tries: { done: (text: string) => void; failed: () => void }[] = [];
  const module = new LateModule<string>(() => new Promise((done, reject) => tries.push({ done, failed: () => reject(new Error("404")) })));
  const seen: string[] = [];
  module.onChange(() => seen.push(module.loaded ?? module.trouble ?? "loading"));
  return { module, tries, seen };
}

const yes = (): Promise<boolean> => Promise.resolve(true);
const no = (): Promise<boolean> => Promise.resolve(false);

test("it is asked for once, and there at once from then on", async () => {
  const { module, tries, seen } = late();
  const asked = [module.ask(yes), module.ask(yes)];
  tries[0]?.done("panels");
  await Promise.all(asked);
  await module.ask(yes);
  assert.equal(tries.length, 1);
  assert.equal(module.loaded, "panels");
  assert.deepEqual(seen, ["loading", "panels"]);
});

test("after a failure it is asked for anew, and loaded", async () => {
  const { module, tries, seen } = late();
  const first = module.ask(no);
  tries[0]?.failed();
  await first;
  assert.equal(module.trouble, "unreachable");
  const second = module.ask(no);
  tries[1]?.done("panels");
  await second;
  assert.deepEqual([module.loaded, module.trouble], ["panels", null]);
  assert.deepEqual(seen, ["loading", "unreachable", "loading", "panels"]);
});

test("only a ground station that answers and does not have it has another page", async () => {
  const { module, tries, seen } = late();
  const asked = module.ask(yes);
  tries[0]?.failed();
  await asked;
  assert.deepEqual(seen, ["loading", "unreachable", "refused"]);
});

test("an answer that comes after a further try says nothing of it", async () => {
  const { module, tries } = late();
  let answer: (there: boolean) => void = () => undefined;
  const first = module.ask(() => new Promise((resolve) => { answer = resolve; }));
  tries[0]?.failed();
  await new Promise((resolve) => setImmediate(resolve));
  const second = module.ask(no);
  answer(true);
  await first;
  assert.equal(module.trouble, null);
  tries[1]?.done("panels");
  await second;
  assert.equal(module.loaded, "panels");
});
