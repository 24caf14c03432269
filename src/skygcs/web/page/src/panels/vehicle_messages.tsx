// The messages that a vehicle sends, with rates; one of them with its fields; and the rate at which it is wanted.

import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import { useStore } from "../hooks.ts";
import { sendOrder } from "../orders.ts";
import { mayOrder } from "./calls.ts";
import { Age, Facts, Failure, NumberField, PlainTable, usePolled } from "./parts.tsx";
import type { VehicleProps } from "./vehicle_panel.tsx";
import { useFullState } from "./vehicle_state.tsx";

interface LatestMessage {
  name: string;
  compid: number;
  age_s: number;
  fields: Readonly<Record<string, unknown>>;
}

export function VehicleMessages(props: VehicleProps) {
  const { state, sinceS, error } = useFullState(props);
  const [search, setSearch] = useState("");
  const [open, setOpen] = useState<string | null>(null);
  if (state === null) return error === null ? <p class="note">Asking …</p> : <Failure text={error} />;
  const rows = Object.entries(state.messages).filter(([name]) => name.toLowerCase().includes(search.trim().toLowerCase().replaceAll(" ", "_")))
    .sort(([a], [b]) => a.localeCompare(b));
  return (
    <>
      <Failure text={error} />
      <input type="search" placeholder="Search messages" aria-label="Search messages" value={search} onInput={(event) => setSearch(event.currentTarget.value)} />
      {open !== null && <Message {...props} message={open} close={() => setOpen(null)} />}
      <PlainTable rows={rows} keyOf={([name]) => name} row={([name]) => ({ "aria-selected": name === open })} columns={[
        ["message", ([name]) => <button type="button" class="link" onClick={() => setOpen(name === open ? null : name)}>{breakable(name)}</button>],
        ["rate, Hz", ([, rate]) => rate.rate_hz.toFixed(1), "number"],
        ["count", ([, rate]) => rate.count, "number"],
        ["age", ([, rate]) => <Age age_s={rate.age_s + sinceS} />, "number"],
      ]} />
      {rows.length === 0 && <p class="note">No message of that name.</p>}
    </>
  );
}

/** A long name is broken after an underscore, not within a word. */
function breakable(name: string): ComponentChildren {
  return name.split(/(?<=_)/).flatMap((part, i) => (i === 0 ? [part] : [<wbr key={i} />, part]));
}

function Message({ store, connection, name, message, close }: VehicleProps & { message: string; close: () => void }) {
  const { answer, error } = usePolled<LatestMessage | null>(store, connection, "messages.latest", { target: name, name: message }, 1000);
  const orders = useStore(store, mayOrder);
  const [rate, setRate] = useState<number | null>(null);
  const want = (rate_hz: number | null): void => {
    const label = rate_hz === null ? `${message} at its own rate` : `${message} at ${rate_hz} Hz`;
    void sendOrder(store, connection, { label, method: "vehicles.interval", params: { message, rate_hz }, targets: [name] });
  };
  return (
    <section class="card" aria-label={message}>
      <header class="row"><h3>{message}</h3><button type="button" class="quiet" aria-label="Close" onClick={close}>×</button></header>
      <Failure text={error} />
      {answer !== null && <Facts raw facts={Object.entries(answer.fields).map(([field, value]) => [field, typeof value === "string" ? value : JSON.stringify(value)])} />}
      {orders && (
        <div class="row">
          <NumberField label="Rate" unit="Hz" value={rate} least={0} most={1000} onValue={setRate} />
          <button type="button" disabled={rate === null} onClick={() => want(rate)}>Request</button>
          <button type="button" onClick={() => want(null)}>Default</button>
        </div>
      )}
    </section>
  );
}
