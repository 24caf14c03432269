import assert from "node:assert/strict";
import { test } from "node:test";
import { areThere, fixesText, sourceText, surveyText } from "../src/panels/radio_figures.ts";
import type { CorrectionsStatus, OwnSource } from "../src/rpc_types.ts";
import { part } from "./fleet.ts";

const NONE = part<CorrectionsStatus>({ source: null, age_s: null, bytes_per_s: 0, messages: 0, vehicles: [], rtk_float: 0, rtk_fixed: 0, own_source: null });
const CASTER = part<OwnSource>({ kind: "ntrip", name: "caster.example/BASE", state: "streaming", text: "", bytes_per_s: 300, age_s: 0.4 });

test("nothing is shown where there are none", () => {
  assert.ok(!areThere(NONE));
  assert.ok(areThere({ ...NONE, source: "a program" }) && areThere({ ...NONE, own_source: CASTER }));
});

test("the source: its state, what flows, and its latest trouble", () => {
  assert.deepEqual(sourceText({ ...NONE, own_source: CASTER, age_s: 0.4, bytes_per_s: 312.4 }), { text: "caster.example/BASE, streaming, 312 B/s, the last 0.4 s ago", ok: true });
  const refused = { ...CASTER, state: "held_off" as const, text: "wrong user or password (401)" };
  assert.deepEqual(sourceText({ ...NONE, own_source: refused }), { text: "caster.example/BASE, held off, nothing came yet: wrong user or password (401)", ok: false });
  assert.deepEqual(sourceText({ ...NONE, source: "a program", age_s: 40 }), { text: "a program, 0 B/s, the last 40 s ago", ok: false });
});

test("the survey: how far it is", () => {
  const survey = { state: "surveying" as const, duration_s: 40, minimum_s: 120, accuracy_m: 1.834, wanted_m: 2, observations: 40 };
  assert.equal(surveyText(survey), "surveying, 40 of 120 s, 1.8 m of 2.0 m wanted");
  assert.equal(surveyText({ ...survey, state: "setting_up", duration_s: null, accuracy_m: null }), "setting up");
  assert.equal(surveyText({ ...survey, state: "fixed" }), "at a fixed position");
  assert.deepEqual([surveyText(null), surveyText(undefined)], [null, null]);
});

test("the vehicles: fixed, float and neither", () => {
  const vehicles = ["a", "b", "c"].map((name) => ({ name, fix: null, satellites: null }));
  assert.equal(fixesText({ ...NONE, vehicles, rtk_fixed: 1, rtk_float: 1 }), "1 fixed, 1 float, 1 neither");
  assert.equal(fixesText({ ...NONE, vehicles, rtk_fixed: 3 }), "3 fixed, 0 float");
});
