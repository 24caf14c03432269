// All telemetry of one vehicle by group, with ages; its texts, components and messages, and the rate at which one is wanted.

import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import { timeText } from "../format.ts";
import { useStore, useTick } from "../hooks.ts";
import { sendOrder } from "../orders.ts";
import { mayOrder } from "./calls.ts";
import { Age, Facts, Failure, Fold, NumberField, PlainTable, usePolled } from "./parts.tsx";
import { fieldText, groupsOf, labelOf } from "./telemetry_text.ts";
import type { VehicleProps } from "./vehicle_panel.tsx";
import type { VehicleState } from "../rpc_types.ts";

const OPEN_GROUPS = new Set(["position", "battery", "gps"]);
/** A group that is so old is not of now. */
const OLD_S = 5;

export function useFullState({ store, connection, name }: VehicleProps, everyMs = 1000): { state: VehicleState | null; sinceS: number; error: string | null } {
  const { answer, atMs, error } = usePolled(store, connection, "vehicles.get", { target: name }, everyMs);
  const nowMs = useTick(500);
  return { state: answer, sinceS: Math.max(nowMs - atMs, 0) / 1000, error };
}

export function VehicleFields(props: VehicleProps) {
  const { state, sinceS, error } = useFullState(props);
  if (state === null) return error === null ? <p class="note">Asking …</p> : <Failure text={error} />;
  const { groups, plain } = groupsOf({ ...state });
  return (
    <>
      <Failure text={error} />
      {groups.map(({ name, fields, age_s }) => (
        <Fold key={name} open={OPEN_GROUPS.has(name)} title={labelOf(name).text} side={age_s === null ? undefined : <Age age_s={age_s + sinceS} old_s={OLD_S} />}>
          <div class={age_s !== null && age_s + sinceS > OLD_S ? "lost" : undefined}><Fields fields={fields} /></div>
        </Fold>
      ))}
      <Fold title="vehicle"><Fields fields={plain} /></Fold>
      <Fold title="components" side={state.components.length}>
        <PlainTable rows={state.components} keyOf={(one) => one.compid} columns={[
          ["component", (one) => `${one.compid} ${one.name ?? ""}`],
          ["type", (one) => one.type ?? "–"],
          ["messages", (one) => one.messages, "number"],
          ["age", (one) => <Age age_s={one.age_s + sinceS} />, "number"],
        ]} />
      </Fold>
    </>
  );
}

function Fields({ fields }: { fields: readonly (readonly [string, unknown])[] }) {
  return <Facts facts={fields.map(([key, value]) => {
    const { text, unit } = labelOf(key);
    return [text, <>{fieldText(key, value)}{unit !== "" && value !== null && <span class="unit"> {unit}</span>}</>];
  })} />;
}

export function VehicleTexts(props: VehicleProps) {
  const { state, sinceS, error } = useFullState(props);
  const events = useStore(props.store, (all) => all.events).filter((event) => event.vehicle === props.name && event.kind !== "statustext");
  if (state === null) return error === null ? <p class="note">Asking …</p> : <Failure text={error} />;
  return (
    <>
      {state.status_texts.length === 0 && <p class="note">The vehicle has sent no text.</p>}
      <ul class="texts">
        {[...state.status_texts].reverse().map((one, i) => (
          <li key={`${i} ${one.text}`} data-tone={one.level <= 3 ? "danger" : one.level === 4 ? "warning" : "info"}>
            <span class="muted">{one.severity}{one.compid !== 1 ? ` from ${one.compid}` : ""}</span>{" "}
            {one.text} <Age age_s={one.age_s + sinceS} old_s={Infinity} />
          </li>
        ))}
      </ul>
      <h3>Events of {props.name}</h3>
      <ul class="texts">
        {events.slice(-60).reverse().map((event) => (
          <li key={event.id}><span class="muted">{timeText(event.time_unix_s)} {event.kind.replace("_", " ")}</span>{" "}{event.text}</li>
        ))}
      </ul>
    </>
  );
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
  const { answer, error } = usePolled(store, connection, "messages.latest", { target: name, name: message }, 1000);
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
