import assert from "node:assert/strict";
import { test } from "node:test";
import { isFlown, isOnTrajectory, keptPlace, keptText } from "../src/setpoint_orders.ts";
import type { Control } from "../src/types.ts";
import { vehicle as reported } from "./fleet.ts";

const vehicle = (...given: Parameters<typeof reported>) => ({ ...reported(...given), heard_s: 0 });

function flown(name: string, more: Partial<Control> = {}) {
  const control = { state: "flying", mode: "OFFBOARD", control_mode: "position", reference: { pos_enu_m: [1, -2.04, 8], vel_enu_mps: null }, ...more } as Control;
  return vehicle(name, 1, { control });
}

test("a vehicle is flown by setpoints unless they are off, or the daemon says nothing of it", () => {
  assert.ok(isFlown(flown("a")) && isFlown(flown("a", { state: "held" })));
  assert.ok(!isFlown(flown("a", { state: "off" })) && !isFlown(vehicle("a", 1, { control: null })) && !isFlown(undefined));
});

test("a place that is kept has three axes", () => {
  assert.deepEqual(keptPlace(flown("a")), [1, -2.04, 8]);
  assert.equal(keptPlace(flown("a", { reference: { pos_enu_m: [1, null, 8], vel_enu_mps: null } })), null);
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
