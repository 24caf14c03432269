import assert from "node:assert/strict";
import { test } from "node:test";
import { chosenFrom, tableShapes, type PositionTable } from "../src/panels/position_table.tsx";
import type { Vehicle } from "../src/store.ts";
import { vehicle } from "./fleet.ts";

const heard = (name: string, sysid: number): Vehicle => ({ ...vehicle(name, sysid), heard_s: 0 });

const TABLE: PositionTable = {
  name: "t.csv",
  vehicles: { a: { initial: [0, 0, 5], final: [10, 0, 5] }, 2: { initial: null, final: [3, 4, 5] }, gone: { initial: null, final: [1, 1, 1] } },
  headings: false,
};

test("a table's positions are found by name and by system id, and unknown vehicles are named", () => {
  const fleet = new Map<string, Vehicle>([["a", heard("a", 1)], ["bravo", heard("bravo", 2)]]);
  const final = chosenFrom(TABLE, "final", fleet);
  assert.deepEqual([...final.goals], [["bravo", [3, 4, 5]], ["a", [10, 0, 5]]]);
  assert.deepEqual(final.unknown, ["gone"]);
  assert.deepEqual([...chosenFrom(TABLE, "initial", fleet).goals.keys()], ["a"]);
});

test("starts and goals of a table are marks, and a line where a vehicle has both", () => {
  const shapes = tableShapes(TABLE);
  assert.equal(shapes.filter((shape) => shape.kind === "path").length, 1);
  assert.equal(shapes.filter((shape) => shape.kind === "mark" && shape.symbol === "goal").length, 3);
});
