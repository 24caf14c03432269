// The flight of a plan by the daemon: give it to the daemon, check it against the fleet, run, pause, resume, abort, land.

import { useEffect, useRef, useState } from "preact/hooks";
import { namesText } from "../format.ts";
import { HoldButton } from "../hold_button.tsx";
import { useStore } from "../hooks.ts";
import { runOrder } from "../orders.ts";
import { PlanButtons } from "../plan_bar.tsx";
import { AT_REST, FAILED, planText } from "../plan_status.ts";
import { ask, mayOrder, readMessage, said } from "./calls.ts";
import { Choice, Failure, NumberField, PlainTable, useWork } from "./parts.tsx";
import { approachText, type Certificate, type CheckedPlan } from "./plan_shapes.ts";
import { givenPlan } from "./plan_upload.ts";
import type { PanelProps } from "./registry.ts";
import type { PlanReport } from "../rpc_types.ts";
import type { Params, PlanStatus } from "../types.ts";

type Mode = "position" | "velocity" | "attitude";

export function PlanFlight(props: PanelProps & { checked: CheckedPlan | null; follow: (t_s: number) => void }) {
  const { store, checked, follow } = props;
  const orders = useStore(store, mayOrder);
  const replay = useStore(store, (state) => state.hello?.replay ?? false);
  const status = useStore(store, (state) => state.plan);
  const flies = status !== null && !AT_REST.has(status.state);
  const follower = useRef(follow);
  follower.current = follow;
  const at_s = flies ? (status.clock?.trajectory_s ?? null) : null;
  useEffect(() => {
    if (at_s !== null) follower.current(at_s);
  }, [at_s]);
  if (replay) return null;
  return (
    <section class="card" aria-label="Flight of the plan">
      <h3>Flight</h3>
      {status !== null && status.state !== "none" && <StatusView status={status} />}
      {orders && (flies ? <Running {...props} status={status} /> : <Before {...props} checked={checked} status={status} />)}
    </section>
  );
}

function StatusView({ status }: { status: PlanStatus }) {
  return (
    <>
      <p><b>{status.name ?? "plan"}</b>: {planText(status)}</p>
      {status.reason !== "" && <p class={FAILED.has(status.state) ? "failure" : "muted"}>{status.reason}</p>}
      {status.waits_for.length > 0 && <p class="muted">Waits for {namesText(status.waits_for)}.</p>}
      {status.vehicles.length > 0 && !AT_REST.has(status.state) && (
        <PlainTable rows={status.vehicles} keyOf={(one) => one.vehicle} row={(one) => ({ class: one.left === null ? "" : "lost" })} columns={[
          ["vehicle", (one) => one.vehicle],
          ["state", (one) => (one.left === null ? one.state : `left: ${one.left}`)],
          ["error", (one) => metres(one.error_m), "number"],
          ["allowed", (one) => metres(one.tube_m), "number"],
        ]} />
      )}
    </>
  );
}

function metres(m: number | null): string {
  return m === null ? "–" : `${m.toFixed(2)} m`;
}

function Running({ store, connection, status }: PanelProps & { status: PlanStatus }) {
  const targets = status.vehicles.map((one) => one.vehicle);
  const [speed, setSpeed] = useState<number | null>(status.speed ?? 1);
  const order = <M extends "plan.abort" | "plan.speed">(label: string, method: M, params: Params[M]): void =>
    void runOrder(store, connection, { label, method, params, targets }, readMessage);
  const whom = namesText(targets);
  return (
    <>
      <div class="row wrap">
        <PlanButtons store={store} connection={connection} status={status} />
        <HoldButton danger targets={targets} what={`Abort the plan of ${whom}: all stop where they are`} act={() => order("Abort plan", "plan.abort", {})}>
          Abort
        </HoldButton>
      </div>
      {status.kind === "timed" && (
        <div class="row">
          <NumberField label="Speed" unit="×" value={speed} least={0.1} most={2} onValue={setSpeed} />
          <button type="button" disabled={speed === null} onClick={() => order(`Speed ${speed ?? 1}×`, "plan.speed", { speed: speed ?? 1 })}>Change</button>
        </div>
      )}
    </>
  );
}

function Before({ store, connection, checked, status }: PanelProps & { checked: CheckedPlan | null; status: PlanStatus | null }) {
  const [mode, setMode] = useState<Mode>("position");
  const [speed, setSpeed] = useState<number | null>(1);
  /** What the daemon found of this plan in this mode, and its number of the plan: no other one is flown. */
  const { busy, answer: found, error, run: work, show, clear } = useWork<{ plan: string; report: PlanReport }>();
  const report = found?.report ?? null;
  const text = checked?.text ?? null;
  useEffect(clear, [checked, mode, speed, clear]);
  const params = { mode, speed: speed ?? 1 };
  const targets = Object.keys(checked?.goals ?? {});
  const examine = (name: string, given: string): Promise<unknown> => work(async () => {
    const parts = await givenPlan(given, (part) => ask(store, connection, "plan.upload", part));
    const { plan } = await ask(store, connection, "plan.load", { ...parts, name: name.slice(0, 64) });
    return { plan, report: await ask(store, connection, "plan.check", { plan, ...params }) };
  });
  const run = async (more: { force?: boolean; set_return_heights?: boolean }): Promise<void> => {
    if (found === null) return;
    const { plan } = found;
    const mine = show(found);
    const request = { label: `Fly ${checked?.name ?? "plan"}`, method: "plan.run" as const, params: { plan, ...params, ...more }, targets };
    const answer = await runOrder(store, connection, request, ({ started, report: after }) =>
      said(started, after.findings.filter((one) => one.severity === "refused").map((one) => one.text).join("; ")));
    if (answer !== null && mine()) show(answer.started ? null : { plan, report: answer.report });
  };
  if (checked === null) return status === null || status.state === "none" ? <p class="note">Open or make a plan to fly it.</p> : null;
  const whom = namesText(targets);
  const heights = Object.entries(report?.return_heights ?? {}).filter(([, [is, offered]]) => is !== offered)
    .map(([name, [, offered]]) => `${name} ${offered} m`);
  const insists = report !== null && !report.ok && report.findings.filter((one) => one.severity === "refused").every((one) => one.insist);
  return (
    <>
      <div class="row wrap">
        <Choice label="Flown by" value={mode} options={[["position", "position setpoints"], ["velocity", "velocity setpoints"], ["attitude", "attitude setpoints"]]} onValue={setMode} />
        <NumberField label="Speed" unit="×" value={speed} least={0.1} most={2} onValue={setSpeed} />
      </div>
      <button type="button" disabled={!checked.ok || busy || text === null} onClick={() => text !== null && void examine(checked.name, text)}>
        {busy ? "Checking with the fleet …" : "Check with the fleet"}
      </button>
      <Failure text={error} />
      {report !== null && <ReportView report={report} />}
      {report !== null && report.ok && (
        <HoldButton targets={targets} what={`Fly the plan with ${whom}: arms and takes off`} act={() => void run({})}>Fly it</HoldButton>
      )}
      {report !== null && !report.ok && heights.length > 0 && (
        <HoldButton targets={targets} what={`Set the return heights (${heights.join(", ")}) and fly the plan with ${whom}`} act={() => void run({ set_return_heights: true })}>
          Set return heights and fly
        </HoldButton>
      )}
      {insists && (
        <HoldButton danger targets={targets} what={`Fly the plan with ${whom} in spite of what is refused`} act={() => void run({ force: true })}>
          Fly it all the same
        </HoldButton>
      )}
    </>
  );
}

const SEVERITIES = ["refused", "warning", "note", "ok"];
const VERDICTS: Readonly<Record<string, string>> = { refused: "fail", warning: "unknown", note: "skipped", ok: "pass" };

function ReportView({ report }: { report: PlanReport }) {
  const [all, setAll] = useState(false);
  const findings = [...report.findings].sort((a, b) => SEVERITIES.indexOf(a.severity) - SEVERITIES.indexOf(b.severity));
  const wayThere = report.way_there as Certificate | null;
  const shown = all ? findings : findings.filter((one) => one.severity !== "ok");
  return (
    <>
      <p class={report.ok ? "good" : "failure"}>{report.ok ? "The fleet is ready for it." : "It is not flown as it is."}</p>
      <ul class="findings">
        {shown.map((one, i) => (
          <li key={i} data-verdict={VERDICTS[one.severity]}>
            <span class="verdict">{one.severity}</span> {one.vehicle === null ? "" : `${one.vehicle}: `}
            {one.text}
            {one.todo !== "" && <p class="muted">{one.todo}</p>}
          </li>
        ))}
      </ul>
      {findings.length > shown.length && (
        <button type="button" class="quiet" onClick={() => setAll(true)}>{findings.length - shown.length} checks passed</button>
      )}
      {wayThere?.closest != null && <p class="muted">On the way to the start: {approachText(wayThere.closest)}</p>}
      {report.steps.length > 0 && <p class="muted">Steps: {report.steps.map((step) => step.name).join(", ")}</p>}
    </>
  );
}
