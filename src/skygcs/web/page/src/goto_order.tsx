// The order to fly to a place: typed, clicked, or taken over from where the vehicles are or are sent.

import { useEffect, useRef, useState } from "preact/hooks";
import { fixed } from "./format.ts";
import { frameKeyOf } from "./framed.ts";
import { beginGoto, currentPlace, goalsOf, type GotoDraft, type Place, targetPlace } from "./goto_draft.ts";
import { HoldButton } from "./hold_button.tsx";
import { useFramed, useStore, useWindowEvent } from "./hooks.ts";
import { OrderChain } from "./orders.ts";
import { FrameNote, Key, useTargetsText, type ButtonsProps } from "./order_parts.tsx";
import { Check } from "./panels/parts.tsx";
import { engage } from "./setpoint_orders.ts";
import { isLetterFor } from "./stop_key.ts";
import type { Store, Vehicle } from "./store.ts";

const NOWHERE = { x: "", y: "" };
const FIELDS = [["x", "x, m"], ["y", "y, m"], ["height", "Height, m"]] as const;

type Fields = Readonly<Record<(typeof FIELDS)[number][0], string>>;

export function Goto({ store, connection, view, targets, enabled, send }: ButtonsProps) {
  const who = useTargetsText({ store, targets });
  const [at, setAt] = useFramed(store, NOWHERE);
  const [heightText, setHeightText] = useState("");
  const [kept, setKept] = useState(false);
  const fields = { ...at, height: heightText };
  const { x, y, height, valid } = read(fields);
  const draft = useGotoDraft({ store, view }, valid ? at : null, targets, setAt);
  const place = valid ? view.geodeticOf(x, y) : null;
  const take = (place: Place | null): void => {
    if (place === null) return;
    setAt({ x: place.x.toFixed(1), y: place.y.toFixed(1) });
    setHeightText(place.heightM?.toFixed(1) ?? "");
  };
  const up = height === null ? "" : `, ${fixed(height, 1) ?? ""} m up`;
  const act = (): void => {
    const now = view.geodeticOf(x, y);
    if (now === null) return;
    const goals = new Map(goalsOf(store, view.frame, x, y).map(({ name, to }) => [name, to]));
    const label = `Go to x ${fixed(x, 1) ?? ""}, y ${fixed(y, 1) ?? ""}${up}`;
    const go = async (): Promise<void> => {
      const chain = new OrderChain(targets);
      if (kept && !(await engage(store, connection, targets, chain))) return;
      const state = await send({ label, method: "vehicles.goto", params: { ...now, height_m: height }, chain });
      if (state === "done" && chain.goesOn) store.dispatch({ type: "goals", goals });
      chain.end();
    };
    void go();
    draft.end();
  };
  return (
    <section class="goto" aria-label="Go to">
      <div class="heading"><h3>Go to</h3>
        <button type="button" disabled={!enabled} title="Take over where they are" onClick={() => take(currentPlace(flying(store, targets), view.frame))}>Present place</button>
        <button type="button" disabled={!enabled} title="Take over where skygcs' setpoints send them" onClick={() => take(targetPlace(flying(store, targets)))}>Present target</button>
        <ChooseButton enabled={enabled} pressed={draft.active && view.tool !== null} pick={draft.begin} />
      </div>
      <PlaceFields fields={fields} onField={(key, text) => (key === "height" ? setHeightText(text) : setAt((before) => ({ ...before, [key]: text })))} />
      <Check checked={kept} onChecked={setKept} title="The daemon sends the place as a setpoint, over and over, until Off or another order">Keep sending it, by setpoints</Check>
      <HoldButton targets={targets} class="order wide" disabled={!enabled || place === null} what={`Send ${who} to x ${at.x}, y ${at.y}${up}${kept ? ", by setpoints until Off" : ""}`} act={act}>
        <span>Send there</span>
      </HoldButton>
      <FrameNote store={store} />
      {targets.length > 1 && <p class="muted small">They keep their formation; its middle flies there.</p>}
    </section>
  );
}

/** The place that is typed; `height` null: as it is. */
function read(fields: Fields): { x: number; y: number; height: number | null; valid: boolean } {
  const x = Number(fields.x);
  const y = Number(fields.y);
  const height = fields.height.trim() === "" ? null : Number(fields.height);
  const valid = fields.x.trim() !== "" && fields.y.trim() !== "" && Number.isFinite(x) && Number.isFinite(y) && (height === null || Number.isFinite(height));
  return { x, y, height, valid };
}

type At = typeof NOWHERE;

/** The place shown in the view while it is chosen; `at` null: there is none in this frame. */
function useGotoDraft({ store, view }: Pick<ButtonsProps, "store" | "view">, at: At | null, targets: readonly string[], setAt: (at: At) => void) {
  const frame = useStore(store, frameKeyOf);
  const [draft, setDraft] = useState<GotoDraft | null>(null);
  useEffect(() => () => draft?.end(), [draft]);
  useEffect(() => setDraft(null), [frame]);
  const x = at === null ? null : Number(at.x);
  const y = at === null ? null : Number(at.y);
  useEffect(() => {
    if (x !== null && y !== null) draft?.show(x, y);
  }, [draft, x, y, targets]);
  return {
    active: draft !== null,
    begin: () => setDraft(beginGoto(store, view, (place) => setAt({ x: place.x.toFixed(1), y: place.y.toFixed(1) }))),
    end: () => {
      draft?.end();
      setDraft(null);
    },
  };
}

function ChooseButton({ enabled, pressed, pick }: { enabled: boolean; pressed: boolean; pick: () => void }) {
  const chooser = useRef<HTMLButtonElement>(null);
  useWindowEvent("keydown", (event) => { if (enabled && isLetterFor(event, "g", chooser.current)) pick(); });
  return <button ref={chooser} type="button" disabled={!enabled} aria-keyshortcuts="G" onClick={pick} aria-pressed={pressed}>Choose in the view<Key letter="G" /></button>;
}

function PlaceFields({ fields, onField }: { fields: Fields; onField: (key: keyof Fields, text: string) => void }) {
  return (
    <div class="fields">
      {FIELDS.map(([key, label]) => (
        <label key={key} class="field">
          <span>{label}</span>
          <input type="text" inputMode="decimal" value={fields[key]} placeholder={key === "height" ? "as it is" : ""}
            aria-label={key === "height" ? "Height above home in metres; empty: as it is" : `${key} in metres from the origin`}
            onInput={(event) => onField(key, event.currentTarget.value)} />
        </label>
      ))}
    </div>
  );
}

function flying(store: Store, targets: readonly string[]): Vehicle[] {
  return targets.flatMap((name) => store.state.vehicles.get(name) ?? []);
}
