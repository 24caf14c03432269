// Preflight of the whole fleet: checks by vehicles, what is red first; a click shows the finding, and what would mend it.

import { useState } from "preact/hooks";
import { namesText } from "../format.ts";
import { useStore } from "../hooks.ts";
import { mayOrder } from "./calls.ts";
import { Failure, Scroll, useAsk, usePolled } from "./parts.tsx";
import type { PreflightFinding } from "../rpc_types.ts";
import { matrixOf, type Matrix, type MatrixRow } from "./preflight_report.ts";
import type { PanelProps } from "./registry.ts";
import { VehiclePreflight } from "./vehicle_preflight.tsx";

const POLL_MS = 3000;

/** In the table; the word itself is read out. */
const WORDS: Readonly<Record<PreflightFinding["verdict"], string>> = { fail: "FAIL", unknown: "?", pass: "ok", skipped: "–" };

export default function FleetPreflight(props: PanelProps) {
  const { store, connection } = props;
  const orders = useStore(store, mayOrder);
  const names = useStore(store, (state) => state.names);
  const chosen = [...useStore(store, (state) => state.selection)];
  const targets = chosen.length > 0 ? chosen : [...names];
  const status = usePolled(store, connection, names.length === 0 ? null : "preflight.status", { targets: [...names] }, POLL_MS);
  const run = useAsk(store, connection, "preflight.run");
  const [shown, setShown] = useState<string | null>(null);
  const matrix = matrixOf(status.answer ?? {});
  const examine = async (): Promise<void> => {
    await run.run({ targets });
    status.again();
  };
  return (
    <div class="fleetpreflight">
      <div class="row">
        <p>{summary(matrix)}</p>
        <button type="button" class="primary" disabled={!orders || run.busy || targets.length === 0} onClick={() => void examine()}>
          {run.busy ? "Examining …" : `Examine ${chosen.length > 0 ? namesText(chosen) : "all"}`}
        </button>
      </div>
      <Failure text={run.error ?? status.error} />
      <div class="beside">
        {matrix.rows.length > 0 && (
          <Scroll label="Checks by vehicles">
            <table class="matrix">
              <thead>
                <tr>
                  <th scope="col">Check</th>
                  {matrix.vehicles.map((name) => (
                    <th key={name} scope="col">
                      <button type="button" aria-pressed={shown === name} onClick={() => setShown(shown === name ? null : name)}>{name}</button>
                    </th>
                  ))}
                </tr>
              </thead>
              <tbody>
                {matrix.rows.map((row) => <CheckRow key={row.check} row={row} vehicles={matrix.vehicles} shown={shown} show={setShown} />)}
              </tbody>
            </table>
          </Scroll>
        )}
        {shown !== null && names.includes(shown) && (
          <section class="card panel" aria-label={`Preflight of ${shown}`}>
            <h2>{shown}</h2>
            <VehiclePreflight key={shown} {...props} name={shown} />
          </section>
        )}
      </div>
      {matrix.skipped.length > 0 && <p class="note">Not for these vehicles: {matrix.skipped.join(", ")}.</p>}
    </div>
  );
}

function CheckRow({ row, vehicles, shown, show }: { row: MatrixRow; vehicles: readonly string[]; shown: string | null; show: (name: string) => void }) {
  return (
    <tr>
      <th scope="row">{row.check}</th>
      {vehicles.map((name) => {
        const finding = row.findings.get(name);
        if (finding === undefined) return <td key={name} />;
        return (
          <td key={name} data-verdict={finding.verdict} data-shown={shown === name}>
            <button type="button" title={`${name}, ${row.check}: ${finding.verdict}: ${finding.text}`} onClick={() => show(name)}>
              {WORDS[finding.verdict]}
              <span class="unseen"> {finding.verdict}, {row.check} of {name}</span>
            </button>
          </td>
        );
      })}
    </tr>
  );
}

/** "1 of 3 is ready; expired: delta; not examined: echo." */
function summary({ vehicles, ready, expired, never }: Matrix): string {
  if (vehicles.length === 0) return "No vehicle was examined since the daemon started.";
  const rest = ([["expired", expired], ["not examined", never]] as const).map(([what, names]) => (names.length === 0 ? "" : `; ${what}: ${namesText(names)}`)).join("");
  return `${ready} of ${vehicles.length} ${vehicles.length === 1 ? "is" : "are"} ready${rest}.`;
}
