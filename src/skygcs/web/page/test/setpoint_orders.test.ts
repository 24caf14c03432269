import assert from "node:assert/strict";
import { test } from "node:test";
import { engage, isControlled, isFlown, isHeld, isOnTrajectory, keptPlace, keptText } from "../src/setpoint_orders.ts";
import type { Control } from "../src/types.ts";
import { vehicle as reported } from "./fleet.ts";

const vehicle = (...given: Parameters<typeof reported>) => ({ ...reported(...given), heard_s: 0 });

function flown(name: string, more: Partial<Control> = {}) {
  const control = { state: "flying", mode: "OFFBOARD", control_mode: "position", reference: { pos_enu_m: [1, -2.04, 8], vel_enu_mps: null, yaw_deg: null }, ...more } as Control;
  return vehicle(name, 1, { control });
}

test("each state of control has one meaning", () => {
  const meanings = (["off", "engaging", "flying", "held"] as const).map((state) => flown("a", { state })).map((v) => [isFlown(v), isHeld(v), isControlled(v)]);
  assert.deepEqual(meanings, [[false, false, false], [true, false, true], [true, false, true], [false, true, true]]);
  assert.ok(!isFlown(vehicle("a", 1, { control: null })) && !isFlown(undefined));
});

test("what the guard holds gets no setpoints: the text says so, no place is kept, and it is engaged anew", async () => {
  const held = flown("a", { state: "held", trajectory: { name: "square", state: "running" } });
  assert.equal(keptText([held]), "held by the guard, no setpoints are sent");
  assert.equal(keptText([held, flown("b")]), "1 of 2: kept at 1.0, −2.0, 8.0 m until Off; 1 of 2: held by the guard, no setpoints are sent");
  assert.equal(keptText([flown("a", { state: "engaging" })]), "setpoints begin");
  assert.ok(keptPlace(held) === null && !isOnTrajectory(held));
  const asked: unknown[] = [];
  const vehicles = new Map([held, flown("b"), flown("c", { state: "engaging" })].map((v) => [v.name, v]));
  const store = { state: { vehicles, names: [...vehicles.keys()] }, dispatch: () => undefined } as unknown as Parameters<typeof engage>[0];
  const connection = { order: (method: string, params: object) => {
    asked.push([method, params]);
    return Promise.resolve({ outcomes: { a: { ok: true, result: "accepted", message: "", elapsed_s: 1 } } });
  } } as unknown as Parameters<typeof engage>[1];
  assert.ok(await engage(store, connection, ["a", "b", "c"]));
  assert.deepEqual(asked, [["control.set", { targets: ["a", "c"], mode: "position" }]]);
});

test("a place that is kept has three axes", () => {
  assert.deepEqual(keptPlace(flown("a")), [1, -2.04, 8]);
  assert.equal(keptPlace(flown("a", { reference: { pos_enu_m: [1, null, 8], vel_enu_mps: null, yaw_deg: null } })), null);
  assert.equal(keptPlace(flown("a", { state: "off" })), null);
});

test("what is kept is said in a line, and a trajectory by its name", () => {
  const idle = vehicle("b", 2, { control: null });
  assert.equal(keptText([idle]), "");
  assert.equal(keptText([flown("a")]), "kept at 1.0, −2.0, 8.0 m until Off");
  assert.equal(keptText([flown("a"), idle]), "1 of 2: kept at 1.0, −2.0, 8.0 m until Off");
  assert.equal(keptText([flown("a"), flown("c"), idle]), "2 of 3: setpoints are sent until Off");
  const on = flown("a", { trajectory: { name: "square", state: "running" } });
  assert.equal(keptText([on]), "on square, running");
  assert.ok(isOnTrajectory(on) && !isOnTrajectory(flown("a", { trajectory: { name: "square", state: "finished" } })) && !isOnTrajectory(flown("a")));
});
