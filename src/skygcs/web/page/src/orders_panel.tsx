// Orders for the selected vehicles. Hold, STOP and the end of setpoints act at once; everything else is held down for a second.

import { useEffect, useRef, useState } from "preact/hooks";
import { namesText } from "./format.ts";
import { Goto } from "./goto_order.tsx";
import { HoldButton } from "./hold_button.tsx";
import { useStore, useWindowEvent } from "./hooks.ts";
import { OrderHistory } from "./order_list.tsx";
import { Key, useTargetsText, type ButtonsProps } from "./order_parts.tsx";
import { sendOrder, type OrderRequest } from "./orders.ts";
import { OriginOrder } from "./origin_order.tsx";
import type { PanelProps } from "./panels/registry.ts";
import { isControlled, keptText } from "./setpoint_orders.ts";
import { ShapeOrder } from "./shape_order.tsx";
import { modesFor } from "./modes.ts";
import { isLetterFor } from "./stop_key.ts";
import { isHeard, serverNowS, type OrderState, type State } from "./store.ts";

const DEFAULT_HEIGHT_M = 10;
const MOST_HEIGHT_M = 500;

export function OrdersPanel(props: PanelProps) {
  const { store, connection } = props;
  const names = useStore(store, selectedNames);
  const role = useStore(store, (state) => state.hello?.role ?? null);
  const replay = useStore(store, (state) => state.hello?.replay ?? false);
  const open = useStore(store, (state) => state.phase.kind === "open" && state.daemon?.connected === true);
  const targets = names === "" ? [] : names.split("\n");
  if (replay) return <p class="note">A recording: nothing can be ordered.</p>;
  if (role === "view") return <p class="note">This address may only look. <code>skygcs web link</code> prints one that may order.</p>;
  const send = (request: Omit<OrderRequest, "targets">): Promise<OrderState> => sendOrder(store, connection, { ...request, targets });
  const enabled = open && targets.length > 0;
  return (
    <div class="orders">
      <Targets {...props} targets={targets} />
      <OrderButtons {...props} targets={targets} enabled={enabled} send={send} />
      <OrderHistory store={store} connection={connection} />
    </div>
  );
}

/** In the order of the fleet, as one string: it changes only if the names do. */
function selectedNames(state: State): string {
  return state.names.filter((name) => state.selection.has(name)).join("\n");
}

function Targets({ store, targets }: PanelProps & { targets: readonly string[] }) {
  const all = useStore(store, (state) => state.names);
  const groups = useStore(store, (state) => [...new Set([...state.vehicles.values()].flatMap((v) => v.groups))].sort().join("\n"));
  const select = (names: readonly string[]): void => store.dispatch({ type: "select", names, how: "only" });
  const where = (test: (name: string) => boolean): readonly string[] => all.filter(test);
  const { state } = store;
  return (
    <section class="targets" aria-label="Targets">
      <p class="for" aria-live="polite">
        {targets.length === 0 ? <span class="muted">Select vehicles in the view or the table.</span> : (
          <><b>{targets.length === all.length && all.length > 1 ? `All ${all.length}` : targets.length === 1 ? targets[0] : `${targets.length} vehicles`}</b>
            {targets.length > 1 && <span class="muted"> {namesText(targets, 6)}</span>}</>
        )}
      </p>
      <div class="chips">
        <button type="button" title="Select all vehicles (Ctrl+A)" onClick={() => select(all)}>All</button>
        <button type="button" title="Select none (Escape)" onClick={() => select([])}>None</button>
        <button type="button" onClick={() => {
          const now_s = serverNowS(state, performance.now());
          select(where((name) => { const v = store.state.vehicles.get(name); return v?.armed === true && isHeard(v, now_s); }));
        }}>Armed</button>
        {groups.split("\n").filter(Boolean).map((group) => (
          <button key={group} type="button" onClick={() => select(where((name) => store.state.vehicles.get(name)?.groups.includes(group) === true))}>{group}</button>
        ))}
      </div>
    </section>
  );
}

function OrderButtons(props: ButtonsProps) {
  const { targets, enabled, send } = props;
  const who = useTargetsText(props);
  const [heightText, setHeightText] = useState(String(DEFAULT_HEIGHT_M));
  const height = Number(heightText);
  const heightOk = heightText.trim() !== "" && height > 0 && height <= MOST_HEIGHT_M;
  const hold = useRef<HTMLButtonElement>(null);
  const holdNow = (): void => void send({ label: "Hold", method: "vehicles.hold", params: {} });
  // at once: it is the one order that makes things calmer
  useWindowEvent("keydown", (event) => { if (enabled && isLetterFor(event, "h", hold.current)) holdNow(); });
  const held = (title: string, method: "vehicles.land" | "vehicles.rtl" | "vehicles.arm" | "vehicles.disarm", letter: string) => (
    <HoldButton targets={targets} class="order" hotkey={letter.toLowerCase()} disabled={!enabled} what={`${title} ${who}`} act={() => void send({ label: title, method, params: {} })}>
      <span>{title}</span><Key letter={letter} />
    </HoldButton>
  );
  return (
    <>
      <section class="buttons" aria-label="Orders">
        <button ref={hold} type="button" class="order primary first" disabled={!enabled} aria-keyshortcuts="H" title={`Hold ${who} where ${targets.length === 1 ? "it is" : "they are"}, at once`}
          onClick={(event) => event.isTrusted && holdNow()}>
          <span>Hold</span><Key letter="H" />
        </button>
        {held("Arm", "vehicles.arm", "A")}
        {held("Disarm", "vehicles.disarm", "D")}
        <div class="pair">
          <HoldButton targets={targets} class="order" hotkey="t" disabled={!enabled || !heightOk} what={`Take off ${who} to ${heightText} m`}
            act={() => void send({ label: `Take off to ${height} m`, method: "vehicles.takeoff", params: { height_m: height } })}>
            <span>Take off</span><Key letter="T" />
          </HoldButton>
          <label class="field">
            <input type="text" inputMode="decimal" value={heightText} aria-label="Height of the take-off in metres" aria-invalid={!heightOk}
              onInput={(event) => setHeightText(event.currentTarget.value)} />
            <span>m</span>
          </label>
        </div>
        {held("Return", "vehicles.rtl", "R")}
        {held("Land", "vehicles.land", "L")}
      </section>
      <Goto {...props} />
      <Mode {...props} />
      <Setpoints {...props} />
      <ShapeOrder {...props} />
      <OriginOrder {...props} />
      <Emergency {...props} />
    </>
  );
}

/** What a mode is for, for vehicles of different firmware at once. Following setpoints is engaged, not only set. */
const MEANINGS = [
  { title: "Hold", method: "vehicles.hold", params: {} },
  { title: "Return", method: "vehicles.rtl", params: {} },
  { title: "Land", method: "vehicles.land", params: {} },
  { title: "Follow setpoints", method: "control.set", params: { mode: "position" } },
] as const;

function Mode({ store, targets, enabled, send }: ButtonsProps) {
  const families = useStore(store, (state) => [...new Set(targets.map((name) => state.vehicles.get(name)?.autopilot ?? ""))].sort().join(" "));
  const who = useTargetsText({ store, targets });
  const [mode, setMode] = useState("");
  const names = modesFor(families.split(" "));
  const meaning = MEANINGS.find(({ title }) => title === mode);
  useEffect(() => {
    if (mode !== "" && meaning === undefined && !names.includes(mode)) setMode("");
  }, [mode, meaning, names]);
  return (
    <section class="mode" aria-label="Mode">
      <label class="field grow">
        <span>Mode</span>
        <select value={mode} disabled={!enabled} onChange={(event) => setMode(event.currentTarget.value)}>
          <option value="">choose</option>
          <optgroup label="By meaning, for any firmware">{MEANINGS.map(({ title }) => <option key={title} value={title}>{title}</option>)}</optgroup>
          {names.length > 0 && <optgroup label="By name">{names.map((name) => <option key={name} value={name}>{name}</option>)}</optgroup>}
        </select>
      </label>
      <HoldButton targets={targets} class="order" disabled={!enabled || mode === ""} what={`Set ${mode} on ${who}`}
        act={() => void send(meaning === undefined ? { label: `Mode ${mode}`, method: "vehicles.mode", params: { mode } } : { ...meaning, label: meaning.title })}>
        <span>Set</span>
      </HoldButton>
    </section>
  );
}

/** Flight by skygcs' own setpoints, of all that are selected. */
function Setpoints({ store, targets, enabled, send }: ButtonsProps) {
  const who = useTargetsText({ store, targets });
  const controlled = useStore(store, (state) => targets.some((name) => isControlled(state.vehicles.get(name))));
  const kept = useStore(store, (state) => keptText(targets.flatMap((name) => state.vehicles.get(name) ?? [])));
  return (
    <section class="setpoints" aria-label="Setpoints">
      <h3>Setpoints</h3>
      {([["position", "Position"], ["velocity", "Velocity"]] as const).map(([mode, title]) => (
        <HoldButton key={mode} targets={targets} disabled={!enabled} what={`Fly ${who} by ${mode} setpoints`}
          act={() => void send({ label: `Fly by ${mode} setpoints`, method: "control.set", params: { mode } })}>
          {title}
        </HoldButton>
      ))}
      <button type="button" disabled={!enabled || !controlled} title={`End the setpoints; ${who} ${targets.length === 1 ? "holds" : "hold"}`}
        onClick={() => void send({ label: "Setpoints off", method: "control.set", params: { mode: "off" } })}>
        Off
      </button>
      {kept !== "" && <p class="muted small" role="status">{kept}</p>}
    </section>
  );
}

/** What stops motors: folded away, held down, and confirmed to the daemon with the number of vehicles. */
function Emergency(props: ButtonsProps) {
  const { targets, enabled, send } = props;
  const who = useTargetsText(props);
  return (
    <details class="emergency">
      <summary>Emergency</summary>
      <HoldButton targets={targets} class="order wide" danger disabled={!enabled} what={`Land ${who} now, over every link`}
        act={() => void send({ label: "Emergency landing", method: "vehicles.stop", params: { action: "land" }, withinS: 10 })}>
        <span>Land now, over every link</span>
      </HoldButton>
      <HoldButton targets={targets} class="order wide" danger disabled={!enabled} what={`Stop the motors of ${who}: what flies falls`}
        act={() => void send({ label: "Motors off", method: "vehicles.stop", params: { action: "kill", confirm: `kill-${targets.length}` }, withinS: 10 })}>
        <span>Stop motors: what flies falls</span>
      </HoldButton>
    </details>
  );
}
