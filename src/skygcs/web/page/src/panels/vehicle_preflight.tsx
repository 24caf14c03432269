// Preflight of one vehicle: what was found, and the parameters that would mend it, set only as a person chose them.

import { useState } from "preact/hooks";
import { HoldButton } from "../hold_button.tsx";
import { toggled } from "../format.ts";
import { useStore } from "../hooks.ts";
import { runOrder } from "../orders.ts";
import { mayOrder, readParams } from "./calls.ts";
import { Age, Check, Failure, useAsk, usePolled } from "./parts.tsx";
import { valueText } from "./param_values.ts";
import { VERDICTS } from "./preflight_report.ts";
import type { VehicleProps } from "./vehicle_panel.tsx";
import type { PreflightFix } from "../rpc_types.ts";

export function VehiclePreflight({ store, connection, name }: VehicleProps) {
  const orders = useStore(store, mayOrder);
  const status = usePolled(store, connection, "preflight.status", { targets: [name] }, 3000);
  const run = useAsk(store, connection, "preflight.run");
  const [left, setLeft] = useState<ReadonlySet<string>>(new Set());
  const here = status.answer?.[name] ?? null;
  const report = run.answer?.vehicles[name] ?? here?.report ?? null;
  const chosen = (report?.fixes ?? []).filter((fix) => !left.has(fix.name));
  const fix = async (): Promise<void> => {
    const confirmed = { [name]: Object.fromEntries(chosen.map((one) => [one.name, one.value])) };
    const request = { label: `Set ${chosen.length} parameters`, method: "preflight.run" as const, params: { targets: [name], fix: true, confirmed }, targets: [name] };
    await runOrder(store, connection, request, ({ vehicles }) => readParams(vehicles[name]?.fixed ?? {}, vehicles[name]?.unfixed));
    run.clear();
    status.again();
  };
  return (
    <>
      <div class="row">
        <p>
          {here === null ? "" : here.state === "never" ? "Not examined since it started." : <>Preflight {here.state}, <Age age_s={here.age_s} old_s={Infinity} /> ago.</>}
          {here?.required === true ? " A pass is required to arm." : ""}
        </p>
        <button type="button" class="primary" disabled={!orders || run.busy} onClick={() => void run.run({ targets: [name] }).then(status.again)}>
          {run.busy ? "Examining …" : "Examine"}
        </button>
      </div>
      <Failure text={run.error ?? status.error} />
      {here?.refusal != null && <p class="failure">An order to arm is refused: {here.refusal}</p>}
      {report !== null && (
        <>
          <p class={report.ok ? "good" : "failure"}>{report.summary}</p>
          {report.unfixed !== "" && <p class="failure">{report.unfixed}</p>}
          <Fixes fixes={report.fixes} left={left} setLeft={setLeft} />
          {chosen.length > 0 && orders && (
            <HoldButton targets={[name]} what={`Set ${chosen.length} parameters of ${name}`} act={() => void fix()}>
              Set {chosen.length} {chosen.length === 1 ? "parameter" : "parameters"}
            </HoldButton>
          )}
          <ul class="findings">
            {[...report.findings].sort((a, b) => VERDICTS.indexOf(a.verdict) - VERDICTS.indexOf(b.verdict)).map((one) => (
              <li key={one.check} data-verdict={one.verdict} data-severity={one.severity}>
                <b>{one.check}</b> <span class="verdict">{one.verdict}</span>
                <p>{one.text}</p>
                {one.todo !== "" && one.verdict !== "pass" && <p class="muted">{one.todo}</p>}
              </li>
            ))}
          </ul>
        </>
      )}
    </>
  );
}

function Fixes({ fixes, left, setLeft }: { fixes: readonly PreflightFix[]; left: ReadonlySet<string>; setLeft: (left: ReadonlySet<string>) => void }) {
  if (fixes.length === 0) return null;
  return (
    <fieldset class="card">
      <legend>Parameters that would mend it</legend>
      {fixes.map((fix) => (
        <Check key={fix.name} checked={!left.has(fix.name)} onChecked={() => setLeft(toggled(left, fix.name))}>
          <code>{fix.name}</code> {valueText(fix.before)} → <b>{valueText(fix.value)}</b>
        </Check>
      ))}
    </fieldset>
  );
}
