// The faults of a drill that last, in one line on every page: nobody takes them for real, and each has its End.

import type { Connection } from "./connection.ts";
import { useStore } from "./hooks.ts";
import { sendOrder } from "./orders.ts";
import { mayOrder } from "./panels/calls.ts";
import { usePolled } from "./panels/parts.tsx";
import type { ActiveDrillFault, DrillFault } from "./rpc_types.ts";
import type { Store } from "./store.ts";

/** More are counted. */
const SHOWN = 4;

export function DrillBar({ store, connection }: { store: Store; connection: Connection }) {
  const there = useStore(store, (state) => state.daemon?.drills === true && state.daemon.connected);
  const orders = useStore(store, mayOrder);
  const { answer } = usePolled(store, connection, there ? STATUS : null, {}, STATUS_EVERY_MS);
  const active = there ? (answer?.active ?? []) : [];
  if (active.length === 0) return null;
  const everyone = [...new Set(active.map(({ vehicle }) => vehicle))];
  const more = active.length - SHOWN;
  return (
    <section class="planbar drillbar" aria-label="Drill">
      <p><b>Drill</b></p>
      <ul>{active.slice(0, SHOWN).map((one) => <Fault key={`${one.vehicle} ${one.fault}`} one={one} end={orders ? () => endFault(store, connection, [one.vehicle], one.fault, one.text) : null} />)}</ul>
      {more > 0 && <p class="muted">and {more} more</p>}
      {orders && active.length > 1 && (
        <span class="buttons"><button type="button" onClick={() => endFault(store, connection, everyone, null, "all faults")}>End all faults</button></span>
      )}
    </section>
  );
}

function Fault({ one, end }: { one: ActiveDrillFault; end: (() => void) | null }) {
  return (
    <li>
      <span>{one.vehicle} {one.text} <span class="muted">{one.lasts_s.toFixed(0)} s</span></span>
      {end !== null && <button type="button" aria-label={`End ${one.text} of ${one.vehicle}`} onClick={end}>End</button>}
    </li>
  );
}

export const STATUS = "drills.status";
export const STATUS_EVERY_MS = 1_000;

export function beginFault(store: Store, connection: Connection, targets: readonly string[], { fault, text }: DrillFault, value: number | null): void {
  void sendOrder(store, connection, { label: `Drill: ${text}`, method: "drills.begin", params: { fault, value }, targets });
}

/** `fault` null: all that last in them. */
export function endFault(store: Store, connection: Connection, targets: readonly string[], fault: ActiveDrillFault["fault"] | null, text: string): void {
  void sendOrder(store, connection, { label: `End of the drill: ${text}`, method: "drills.end", params: { fault }, targets });
}
