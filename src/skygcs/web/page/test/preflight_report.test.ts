import assert from "node:assert/strict";
import { test } from "node:test";
import { matrixOf } from "../src/panels/preflight_report.ts";
import type { PreflightFinding, PreflightStatus } from "../src/rpc_types.ts";
import { part } from "./fleet.ts";

function status(verdicts: Readonly<Record<string, PreflightFinding["verdict"]>> | null, passed: PreflightStatus["state"] = "passed"): PreflightStatus {
  const findings = Object.entries(verdicts ?? {}).map(([check, verdict]) => ({ check, verdict, severity: "fault" as const, text: "", todo: "", fixes: [] }));
  const ok = findings.every(({ verdict }) => verdict === "pass");
  const report = verdicts === null ? null : part<NonNullable<PreflightStatus["report"]>>({ ok, findings });
  return { state: report === null ? "never" : ok ? passed : "failed", required: false, age_s: 1, valid_s: null, refusal: null, report };
}

test("what failed stands first, by check and by vehicle; what could not be checked follows", () => {
  const matrix = matrixOf({
    a: status({ gps: "pass", battery: "pass", clock: "unknown", home: "pass", poses: "skipped" }),
    b: status({ gps: "fail", battery: "pass", clock: "unknown", home: "pass" }),
    c: status({ gps: "fail", battery: "fail", clock: "pass", poses: "skipped" }),
    d: status(null),
    e: status({ gps: "pass", battery: "pass", clock: "pass", home: "pass" }),
  });
  assert.deepEqual(matrix.vehicles, ["c", "b", "a", "e"]);
  assert.deepEqual(matrix.rows.map(({ check }) => check), ["gps", "battery", "clock", "home"]);
  assert.deepEqual([matrix.never, matrix.skipped, matrix.ready], [["d"], ["poses"], 1]);
  assert.equal(matrix.rows[3]?.findings.get("c"), undefined, "a check that was not made of it has no cell");
  assert.deepEqual(matrixOf({}), { vehicles: [], rows: [], skipped: [], never: [], ready: 0, expired: [] });
});

test("a pass that is too old to arm with is not ready", () => {
  const matrix = matrixOf({ a: status({ gps: "pass" }, "expired"), b: status({ gps: "pass" }), c: status({ gps: "fail" }) });
  assert.deepEqual([matrix.ready, matrix.expired], [1, ["a"]]);
});
