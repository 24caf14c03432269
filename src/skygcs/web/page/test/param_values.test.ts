import assert from "node:assert/strict";
import { test } from "node:test";
import { aboutText, groupOf, matches, meaningText, outsideText, parseValue, rangeOf, sameValue, valueText } from "../src/panels/param_values.ts";
import type { ParamDescription } from "../src/rpc_types.ts";

test("a value has to fit its type", () => {
  assert.deepEqual(rangeOf("INT8"), { least: -128, most: 127, whole: true });
  assert.deepEqual(rangeOf("UINT32"), { least: 0, most: 4294967295, whole: true });
  assert.deepEqual(parseValue("127", "INT8"), { ok: true, value: 127 });
  assert.equal(parseValue("128", "INT8").ok, false);
  assert.equal(parseValue("1.5", "INT32").ok, false);
  assert.equal(parseValue("-1", "UINT16").ok, false);
  assert.deepEqual(parseValue(" −0.25 ", "REAL32"), { ok: true, value: -0.25 });
  assert.deepEqual(parseValue("1e3", "INT32"), { ok: true, value: 1000 });
  assert.deepEqual(parseValue("0x10", "UINT8"), { ok: true, value: 16 });
  for (const wrong of ["", " ", "NaN", "Infinity", "1e99", "12abc", "1,5"]) {
    assert.equal(parseValue(wrong, "REAL32").ok, false, wrong);
  }
});

test("values are compared as the 32-bit floats that they are", () => {
  assert.ok(sameValue(0.1, Math.fround(0.1)));
  assert.ok(!sameValue(0.1, 0.10001));
  assert.ok(sameValue(null, null) && !sameValue(null, 0));
  assert.equal(valueText(Math.fround(0.1)), "0.1");
  assert.equal(valueText(Math.fround(3.14159274)), "3.1415927");
  assert.equal(valueText(-5), "-5");
});

test("search takes words anywhere in the name, and patterns for all of it", () => {
  assert.ok(matches("MPC_XY_VEL_MAX", "xy vel"));
  assert.ok(!matches("MPC_XY_VEL_MAX", "xy acc"));
  assert.ok(matches("MPC_XY_VEL_MAX", "MPC_*"));
  assert.ok(!matches("A_MPC_XY", "MPC_*"));
  assert.ok(matches("RC3_MIN", "rc?_min"));
  assert.ok(!matches("RC3xMIN", "RC3.MIN"));
  assert.ok(matches("ANY", ""));
  assert.equal(groupOf("MPC_XY_P"), "MPC");
  assert.equal(groupOf("FRAME"), "FRAME");
});

test("a value outside its range is said, as the daemon judges it", () => {
  const cruise: ParamDescription = { unit: "m/s", least: 3, greatest: 20, range: "3 to 20 m/s", reboot: false, values: { "-1": "off" }, bits: {}, description: "Cruise" };
  assert.equal(outsideText(500, cruise, "px4"), "outside its range of 3 to 20 m/s");
  for (const good of [3, 20, -1]) assert.equal(outsideText(good, cruise, "px4"), null, String(good));
  assert.equal(outsideText(0, cruise, "ardupilot"), null);
  assert.notEqual(outsideText(0, cruise, "px4"), null);
  assert.equal(outsideText(Math.fround(0.1), { ...cruise, least: 0.1 }, "px4"), null);
  assert.equal(outsideText(1e9, undefined, "px4"), null);
  assert.equal(meaningText(-1, cruise), "off");
  assert.equal(meaningText(4, cruise), null);
  assert.equal(aboutText({ ...cruise, reboot: true }), "Cruise; 3 to 20 m/s; takes effect after a reboot");
});
