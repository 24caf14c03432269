import assert from "node:assert/strict";
import { test } from "node:test";
import { countText } from "../src/format.ts";
import { ClassRates, reportRow } from "../src/panels/radio_figures.ts";

test("rates of classes come from their counters", () => {
  const rates = new ClassRates();
  rates.take(10, { command: { sent_bytes: 100 }, setpoint: { sent_bytes: 1000 } });
  assert.equal(rates.total, null);
  rates.take(12, { command: { sent_bytes: 140 }, setpoint: { sent_bytes: 3000 } });
  assert.deepEqual([rates.of("command"), rates.of("setpoint"), rates.total], [20, 1000, 1020]);
  // the daemon began anew
  rates.take(13, { command: { sent_bytes: 5 } });
  assert.deepEqual([rates.of("command"), rates.of("setpoint"), rates.total], [null, null, null]);
});

test("a report is a row", () => {
  assert.deepEqual(reportRow({ age_s: 1, txbuf_percent: 90, rssi: 180, noise: 40, remrssi: 170, remnoise: 50 }), [90, 180, 40, 170, 50]);
});

test("large counts are read in groups of three", () => {
  assert.equal(countText(1234567), "1 234 567");
  assert.equal(countText(123), "123");
  assert.equal(countText(undefined), "–");
});
