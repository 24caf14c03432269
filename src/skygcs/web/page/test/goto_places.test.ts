import assert from "node:assert/strict";
import { test } from "node:test";
import { currentPlace, targetPlace } from "../src/goto_draft.ts";
import { vehicleOf } from "../src/levels.ts";
import { frameAt } from "../src/view/frame.ts";
import { position, vehicle } from "./fleet.ts";

const FRAME = frameAt({ lat_deg: 43.7806, lon_deg: -79.4653, alt_amsl_m: 180, x_heading_deg: 90 });
const at = (name: string, x: number, y: number, up: number, more: object = {}) => vehicleOf(vehicle(name, 1, { position: position(x, y, up), ...more }), 1000);
const control = (pos_enu_m: readonly (number | null)[], state = "flying") => ({ control: { state, mode: "position", control_mode: "position", reference: { pos_enu_m, vel_enu_mps: null } } });

test("where they are: the middle, and the height if it is one", () => {
  assert.deepEqual(currentPlace([at("a", 2, 4, 10)], FRAME), { x: 2, y: 4, heightM: 10 });
  assert.deepEqual(currentPlace([at("a", 0, 0, 10), at("b", 4, 2, 10.2)], FRAME), { x: 2, y: 1, heightM: 10.1 });
  assert.equal(currentPlace([at("a", 0, 0, 10), at("b", 4, 2, 20)], FRAME)?.heightM, null);
  assert.equal(currentPlace([at("a", 0, 0, 0, { position: null })], FRAME), null);
});

test("where setpoints send them: of those that follow places, with heights above their homes", () => {
  const home = position(0, 0, 10, { alt_rel_m: 8 });
  assert.deepEqual(targetPlace([at("a", 0, 0, 10, { ...control([5, 6, 12]), position: home })]), { x: 5, y: 6, heightM: 10 });
  assert.deepEqual(targetPlace([at("a", 0, 0, 10, control([5, 6, null]))]), { x: 5, y: 6, heightM: null });
  assert.equal(targetPlace([at("a", 0, 0, 10, control([5, null, 12])), at("b", 0, 0, 1), at("c", 0, 0, 1, control([1, 2, 3], "off"))]), null);
});
