import assert from "node:assert/strict";
import { test } from "node:test";
import { ERROR_ROWS, Histories, ROWS } from "../src/panels/histories.ts";
import type { Vehicle } from "../src/store.ts";

function vehicle(name: string, more: object = {}): Vehicle {
  return {
    name,
    connected: true,
    position: { alt_rel_m: 12, vel_enu_mps: [3, 4, 1], age_s: 0 },
    vfr: null,
    battery: { volts: 12.5, percent: 80, age_s: 0 },
    uplink: null,
    gps: null,
    control: null,
    links: { radio: { loss_ratio: 0.02 }, usb: { loss_ratio: null } },
    ...more,
  } as unknown as Vehicle;
}

test("a row every two seconds, and no more than there is room for", () => {
  const histories = new Histories();
  for (let i = 0; i < 20_000; i++) histories.take([vehicle("alpha")], 1000 + i / 10);
  const [times, height, speed, climb] = histories.of("alpha").columns();
  assert.equal(times.length, ROWS);
  assert.ok((times[1] ?? 0) - (times[0] ?? 0) >= 2);
  assert.deepEqual([height?.[0], speed?.[0], climb?.[0]], [12, 5, 1]);
});

test("a vehicle that is not heard leaves a gap", () => {
  const histories = new Histories();
  histories.take([vehicle("alpha")], 10);
  histories.take([vehicle("alpha", { connected: false })], 20);
  assert.deepEqual(histories.of("alpha").columns([0])[1], [12, null]);
});

test("the control error is kept at the rate of the updates while setpoints fly it", () => {
  const histories = new Histories();
  const control = { state: "flying", error_m: 0.5, error_enu_m: [0.3, 0.4, 0] };
  for (let i = 0; i < 1000; i++) histories.take([vehicle("alpha", { control })], i / 10);
  histories.take([vehicle("alpha", { control: { ...control, state: "held" } })], 999);
  assert.equal(histories.errorOf("alpha").length, ERROR_ROWS);
  assert.ok(histories.errorOf("alpha").lastTime() < 999);
});

test("vehicles that are made up take no memory without end", () => {
  const histories = new Histories();
  for (let i = 0; i < 1000; i++) histories.take([vehicle(`v${i}`)], 10);
  assert.equal(histories.of("v999").length, 0);
  assert.equal(histories.of("v10").length, 1);
});
