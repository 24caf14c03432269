// Faults that a simulated vehicle may be given, to practise.

import { useState } from "preact/hooks";
import { beginFault, endFault, STATUS, STATUS_EVERY_MS } from "../drill_bar.tsx";
import type { ActiveDrillFault, DrillFault } from "../rpc_types.ts";
import { namesText } from "../format.ts";
import { useStore } from "../hooks.ts";
import { mayOrder } from "./calls.ts";
import { Failure, NumberField, usePolled } from "./parts.tsx";
import type { VehicleProps } from "./vehicle_panel.tsx";

/** What a person meets; the daemon's words are short. */
const WHAT: Readonly<Record<string, string>> = {
  deaf: "It hears nothing that is sent to it, and goes on sending.",
  link: "Nothing passes between it and the ground.",
  gps: "Its GPS has no fix.",
  battery: "Its charge falls to this, and goes on falling.",
  wind: "Wind from the west.",
};

export function VehicleDrill({ store, connection, name }: VehicleProps) {
  const { answer, error, again } = usePolled(store, connection, STATUS, {}, STATUS_EVERY_MS);
  const selection = useStore(store, (state) => state.selection);
  const orders = useStore(store, mayOrder);
  if (answer === null) return error === null ? <p class="note">Asking …</p> : <Failure text={error} />;
  const simulated = (one: string): boolean => answer.simulated.includes(one);
  if (!simulated(name)) return <p class="note">{name} is not simulated by this station: no fault can be made in it.</p>;
  const targets = selection.has(name) ? [...selection].filter(simulated) : [name];
  const active = answer.active.filter(({ vehicle }) => vehicle === name);
  return (
    <section class="card" aria-label="Faults">
      <p class="muted">Faults of the simulated {targets.length === 1 ? "vehicle" : "vehicles"} {namesText(targets)}, to practise. Each lasts until it is ended.</p>
      <ul class="drillfaults">
        {answer.faults.map((fault) => (
          <FaultRow key={fault.fault} fault={fault} active={active.find((one) => one.fault === fault.fault) ?? null} may={orders}
            begin={(value) => { beginFault(store, connection, targets, fault, value); again(); }}
            end={() => { endFault(store, connection, targets, fault.fault, fault.text); again(); }} />
        ))}
      </ul>
    </section>
  );
}

function FaultRow({ fault, active, may, begin, end }: { fault: DrillFault; active: ActiveDrillFault | null; may: boolean; begin: (value: number | null) => void; end: () => void }) {
  const [value, setValue] = useState(fault.default);
  const title = fault.text.charAt(0).toUpperCase() + fault.text.slice(1);
  return (
    <li data-active={active !== null}>
      <span class="what">
        <b>{title}</b> {active !== null && <span class="verdict">active, {active.lasts_s.toFixed(0)} s</span>}
        <span class="muted small">{WHAT[fault.fault] ?? ""}</span>
      </span>
      {may && fault.unit !== null && <NumberField label={`${title} value`} unit={fault.unit} value={value} least={fault.least} most={fault.most} onValue={setValue} />}
      {may && (active === null || fault.unit !== null) && <button type="button" disabled={fault.unit !== null && value === null} aria-label={`Begin ${active === null ? "" : "again "}${fault.text}`} onClick={() => begin(fault.unit === null ? null : value)}>{active === null ? "Begin" : "Begin again"}</button>}
      {may && active !== null && <button type="button" class="primary" aria-label={`End ${fault.text}`} onClick={end}>End</button>}
    </li>
  );
}
