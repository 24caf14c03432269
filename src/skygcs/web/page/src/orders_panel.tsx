// Orders for the selected vehicles. Hold and STOP act at once; everything else is held down for a second.

import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { namesText, fixed } from "./format.ts";
import { beginGoto, goalsOf, type GotoDraft } from "./goto_draft.ts";
import { HoldButton } from "./hold_button.tsx";
import { useStore } from "./hooks.ts";
import { fullName } from "./levels.ts";
import { OrderHistory } from "./order_list.tsx";
import { sendOrder, type OrderRequest } from "./orders.ts";
import type { PanelProps } from "./panels/registry.ts";
import { modesFor } from "./modes.ts";
import { isSeen, isTextField } from "./stop_key.ts";
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
        {targets.length === 0 ? (
          <span class="muted">Select vehicles in the view or the table.</span>
        ) : (
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

interface ButtonsProps extends PanelProps {
  targets: readonly string[];
  enabled: boolean;
  send: (request: Omit<OrderRequest, "targets">) => Promise<OrderState>;
}

function OrderButtons(props: ButtonsProps) {
  const { targets, enabled, send } = props;
  const who = useTargetsText(props);
  const [heightText, setHeightText] = useState(String(DEFAULT_HEIGHT_M));
  const height = Number(heightText);
  const heightOk = heightText.trim() !== "" && height > 0 && height <= MOST_HEIGHT_M;
  const hold = useRef<HTMLButtonElement>(null);
  useHoldKey(enabled, hold, () => void send({ label: "Hold", method: "vehicles.hold", params: {} }));
  return (
    <>
      <section class="buttons" aria-label="Orders">
        <button ref={hold} type="button" class="order primary first" disabled={!enabled} aria-keyshortcuts="H" title={`Hold ${who} where ${targets.length === 1 ? "it is" : "they are"}, at once`}
          onClick={(event) => event.isTrusted && void send({ label: "Hold", method: "vehicles.hold", params: {} })}>
          <span>Hold</span><Key letter="H" />
        </button>
        <HoldButton targets={targets} class="order" hotkey="a" disabled={!enabled} what={`Arm ${who}`} act={() => void send({ label: "Arm", method: "vehicles.arm", params: {} })}>
          <span>Arm</span><Key letter="A" />
        </HoldButton>
        <HoldButton targets={targets} class="order" hotkey="d" disabled={!enabled} what={`Disarm ${who}`} act={() => void send({ label: "Disarm", method: "vehicles.disarm", params: {} })}>
          <span>Disarm</span><Key letter="D" />
        </HoldButton>
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
        <HoldButton targets={targets} class="order" hotkey="r" disabled={!enabled} what={`Return ${who}`} act={() => void send({ label: "Return", method: "vehicles.rtl", params: {} })}>
          <span>Return</span><Key letter="R" />
        </HoldButton>
        <HoldButton targets={targets} class="order" hotkey="l" disabled={!enabled} what={`Land ${who}`} act={() => void send({ label: "Land", method: "vehicles.land", params: {} })}>
          <span>Land</span><Key letter="L" />
        </HoldButton>
      </section>
      <Goto {...props} />
      <Mode {...props} />
      <Emergency {...props} />
    </>
  );
}

/** Who an order is for, each with its site where there are several. */
function useTargetsText({ store, targets }: Pick<ButtonsProps, "store" | "targets">): string {
  useStore(store, (state) => state.daemon?.site);
  return namesText(targets.map((name) => fullName(store.state, name)));
}

function Key({ letter }: { letter: string }) {
  return <kbd aria-hidden="true">{letter}</kbd>;
}

/** H acts at once: it is the one order that makes things calmer. The listener has the targets that it was drawn with, so it
 * is replaced before any further event: one that waited for the next frame would hold those that were selected before. */
function useHoldKey(enabled: boolean, button: { readonly current: HTMLElement | null }, act: () => void): void {
  useLayoutEffect(() => {
    if (!enabled) return undefined;
    const onKey = (event: KeyboardEvent): void => {
      if (event.key.toLowerCase() !== "h" || event.repeat || !event.isTrusted || isTextField(event.target)) return;
      if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey || !isSeen(button.current)) return;
      act();
    };
    addEventListener("keydown", onKey);
    return () => removeEventListener("keydown", onKey);
  });
}

function Goto({ store, view, targets, enabled, send }: ButtonsProps) {
  const who = useTargetsText({ store, targets });
  const chooser = useRef<HTMLButtonElement>(null);
  const [draft, setDraft] = useState<GotoDraft | null>(null);
  const [fields, setFields] = useState({ x: "", y: "", height: "" });
  const x = Number(fields.x);
  const y = Number(fields.y);
  const height = fields.height.trim() === "" ? null : Number(fields.height);
  const valid = fields.x.trim() !== "" && fields.y.trim() !== "" && Number.isFinite(x) && Number.isFinite(y) && (height === null || Number.isFinite(height));
  const place = valid ? view.geodeticOf(x, y) : null;
  const pick = (): void => {
    setDraft(beginGoto(store, view, (at) => setFields((before) => ({ ...before, x: at.x.toFixed(1), y: at.y.toFixed(1) }))));
  };
  useEffect(() => () => draft?.end(), [draft]);
  useEffect(() => {
    if (valid) draft?.show(x, y);
  }, [draft, valid, x, y, targets]);
  useLayoutEffect(() => {
    const onKey = (event: KeyboardEvent): void => {
      if (event.key.toLowerCase() !== "g" || !enabled || event.repeat || isTextField(event.target) || !isSeen(chooser.current)) return;
      if (!(event.ctrlKey || event.metaKey || event.altKey)) pick();
    };
    addEventListener("keydown", onKey);
    return () => removeEventListener("keydown", onKey);
  });
  const up = height === null ? "" : `, ${fixed(height, 1) ?? ""} m up`;
  return (
    <section class="goto" aria-label="Go to">
      <div class="heading"><h3>Go to</h3>
        <button ref={chooser} type="button" disabled={!enabled} aria-keyshortcuts="G" onClick={pick} aria-pressed={draft !== null && view.tool !== null}>Choose in the view<Key letter="G" /></button>
      </div>
      <div class="fields">
        {([["x", "x, m"], ["y", "y, m"], ["height", "Height, m"]] as const).map(([key, label]) => (
          <label key={key} class="field">
            <span>{label}</span>
            <input type="text" inputMode="decimal" value={fields[key]} placeholder={key === "height" ? "as it is" : ""}
              aria-label={key === "height" ? "Height above home in metres; empty: as it is" : `${key} in metres from the origin`}
              onInput={(event) => setFields({ ...fields, [key]: event.currentTarget.value })} />
          </label>
        ))}
      </div>
      <HoldButton targets={targets} class="order wide" disabled={!enabled || place === null} what={`Send ${who} to x ${fields.x}, y ${fields.y}${up}`}
        act={() => {
          if (place === null) return;
          const goals = new Map(goalsOf(store, view.frame, x, y).map(({ name, to }) => [name, to]));
          const label = `Go to x ${fixed(x, 1) ?? ""}, y ${fixed(y, 1) ?? ""}${up}`;
          void send({ label, method: "vehicles.goto", params: { ...place, height_m: height } }).then((state) => {
            if (state === "done") store.dispatch({ type: "goals", goals });
          });
          draft?.end();
          setDraft(null);
        }}>
        <span>Send there</span>
      </HoldButton>
      {targets.length > 1 && <p class="muted small">They keep their formation; its middle flies there.</p>}
    </section>
  );
}

function Mode({ store, targets, enabled, send }: ButtonsProps) {
  const families = useStore(store, (state) => [...new Set(targets.map((name) => state.vehicles.get(name)?.autopilot ?? ""))].sort().join(" "));
  const who = useTargetsText({ store, targets });
  const [mode, setMode] = useState("");
  const choices = modesFor(families.split(" "));
  useEffect(() => {
    if (mode !== "" && !choices.includes(mode)) setMode("");
  }, [mode, choices]);
  return (
    <section class="mode" aria-label="Mode">
      <label class="field grow">
        <span>Mode</span>
        <select value={mode} disabled={!enabled || choices.length === 0} onChange={(event) => setMode(event.currentTarget.value)}>
          <option value="">{targets.length > 0 && choices.length === 0 ? "none that all of them have" : "choose"}</option>
          {choices.map((name) => <option key={name} value={name}>{name}</option>)}
        </select>
      </label>
      <HoldButton targets={targets} class="order" disabled={!enabled || mode === ""} what={`Set ${mode} on ${who}`}
        act={() => void send({ label: `Mode ${mode}`, method: "vehicles.mode", params: { mode } })}>
        <span>Set</span>
      </HoldButton>
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
