import assert from "node:assert/strict";
import { test } from "node:test";
import { commandText, countsText, lengthOf, missionShapes, type CheckedItem, type CheckedMission } from "../src/panels/mission_shapes.ts";

function item(number: number, xy: [number, number] | null, moves = true): CheckedItem {
  return { number, command: 16, name: "MAV_CMD_NAV_WAYPOINT", moves, params: [], xy_m: xy, height_m: xy === null ? null : 10, height_above: "home" };
}

const CHECKED: CheckedMission = {
  name: "a.plan",
  ok: true,
  format: "plan",
  holds: ["mission", "fence"],
  counts: { mission: 4, fence: 5, rally: 0 },
  home: { xy_m: [0, 0] },
  mission: [item(1, [0, 0]), item(2, [3, 4], false), item(3, [30, 40]), item(4, null)],
  rally: [],
  fence: {
    polygons: [{ inclusion: true, corners: 3, xy_m: [[0, 0], [9, 0], [9, 9]] }, { inclusion: false, corners: 3, xy_m: null }],
    circles: [{ inclusion: false, center_xy_m: [1, 2], radius_m: 5 }],
  },
  notes: [],
  changes: [],
  findings: [],
  errors: 0,
  warnings: 0,
  text: null,
};

test("a mission is drawn through the places that are flown to, with the current one marked", () => {
  const shapes = missionShapes(CHECKED, 3);
  const path = shapes.find((shape) => shape.kind === "path" && shape.ink === "plan");
  assert.deepEqual(path?.kind === "path" && path.points, [[0, 0, 10], [30, 40, 10]]);
  const marks = shapes.filter((shape) => shape.kind === "mark" && shape.symbol === "waypoint");
  assert.deepEqual(marks.map((mark) => mark.kind === "mark" && [mark.text, mark.emphasised]), [["1", false], ["3", true]]);
  assert.equal(lengthOf(CHECKED), 50);
});

test("what vehicles stay out of looks unlike what they stay in", () => {
  const fences = missionShapes(CHECKED, null).filter((shape) => shape.ink === "fence" || shape.ink === "danger");
  assert.deepEqual(fences.map((shape) => [shape.kind, shape.ink]), [["path", "fence"], ["circle", "danger"]]);
});

test("counts and commands are read as words", () => {
  assert.equal(countsText(CHECKED), "4 mission items, 2 fence polygons, 1 fence circle");
  assert.equal(commandText("MAV_CMD_NAV_RETURN_TO_LAUNCH"), "return to launch");
  assert.equal(commandText("MAV_CMD_DO_CHANGE_SPEED"), "change speed");
});
