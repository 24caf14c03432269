import assert from "node:assert/strict";
import { test } from "node:test";
import { vehicleOf } from "../src/levels.ts";
import { isProblem, troublesOf } from "../src/trouble.ts";
import type { VehicleState } from "../src/types.ts";
import { part, position, vehicle } from "./fleet.ts";

const NOW_S = 1000;
const heard = (...args: Parameters<typeof vehicle>) => vehicleOf(vehicle(...args), NOW_S);
const silent = (name: string, sysid: number, age_s: number, more: object = {}) =>
  vehicleOf(vehicle(name, sysid, { connected: false, last_heartbeat_age_s: age_s, links: { radio: part({ frames: 1, lost: 0, loss_ratio: 0, age_s }) }, ...more }), NOW_S);

test("a vehicle's trouble says what is wrong, all of it and the worst first", () => {
  const text = (more: object) => troublesOf([heard("u04", 4, more)], NOW_S)[0]?.text;
  assert.equal(text({}), undefined);
  const battery = part<NonNullable<VehicleState["battery"]>>({ volts: 20.1, percent: 6 });
  const uplink = { heard: false, unanswered: 3, rtt_s: null, age_s: 1 };
  assert.equal(text({ battery }), "battery 6 %");
  assert.equal(text({ uplink }), "does not hear us");
  assert.equal(text({ separation: { level: "warning", with: "u05", distance_m: 3.21 } }), "near u05, 3.2 m");
  assert.equal(text({ separation: { level: "notice", with: "u05" } }), undefined);
  assert.equal(text({ failsafe: true, uplink, battery }), "failsafe, does not hear us, battery 6 %");
});

test("one lost in the air comes first with its height, one that is silent on the ground last, one never heard not at all", () => {
  const found = troublesOf([
    silent("d", 4, 30, { landed: "on_ground", armed: false }),
    heard("c", 3, { failsafe: true }),
    silent("b", 2, 21, { position: position(0, 0, 9.7) }),
    silent("e", 5, 0, { last_heartbeat_age_s: null, links: {} }),
    heard("a", 1),
  ], NOW_S);
  assert.deepEqual(found.map(({ name, severity, text }) => ({ name, severity, text })), [
    { name: "b", severity: "danger", text: "lost at 9.7 m, 21 s" },
    { name: "c", severity: "danger", text: "failsafe" },
    { name: "d", severity: "warning", text: "not heard, 30 s" },
  ]);
});

test("of those that are heard a failsafe comes before one that is near, deaf, or has an empty battery", () => {
  const battery = part<NonNullable<VehicleState["battery"]>>({ volts: 20.1, percent: 6 });
  const found = troublesOf([
    heard("a", 1, { battery }),
    heard("b", 2, { uplink: { heard: false, unanswered: 3, rtt_s: null, age_s: 1 }, battery }),
    heard("c", 3, { separation: { level: "action", with: "a" } }),
    heard("d", 4, { failsafe: true }),
    heard("e", 5, { battery }),
  ], NOW_S);
  assert.deepEqual(found.map(({ name }) => name), ["d", "c", "b", "a", "e"]);
});

test("what the strip shows of a vehicle that is heard is what is counted as a problem", () => {
  for (const more of [{}, { failsafe: true }, { battery: part<NonNullable<VehicleState["battery"]>>({ volts: 1, percent: 10 }) }]) {
    const one = heard("a", 1, more);
    assert.equal(isProblem(one), troublesOf([one], NOW_S).length === 1);
  }
});
