// The order to fly to a place: typed, clicked, or taken over from where the vehicles are or are sent.

import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { fixed } from "./format.ts";
import { beginGoto, goalsOf, type GotoDraft } from "./goto_draft.ts";
import { currentPlace, targetPlace, type Place } from "./goto_places.ts";
import { HoldButton } from "./hold_button.tsx";
import { useStore } from "./hooks.ts";
import { Key, useTargetsText, type ButtonsProps } from "./order_parts.tsx";
import { engage } from "./setpoint_orders.ts";
import { isSeen, isTextField } from "./stop_key.ts";
import type { Store, Vehicle } from "./store.ts";

export function Goto({ store, connection, view, targets, enabled, send }: ButtonsProps) {
  const who = useTargetsText({ store, targets });
  const origin = useStore(store, (state) => state.origin);
  const chooser = useRef<HTMLButtonElement>(null);
  const [draft, setDraft] = useState<GotoDraft | null>(null);
  const [fields, setFields] = useState({ x: "", y: "", height: "" });
  const [kept, setKept] = useState(false);
  const x = Number(fields.x);
  const y = Number(fields.y);
  const height = fields.height.trim() === "" ? null : Number(fields.height);
  const valid = fields.x.trim() !== "" && fields.y.trim() !== "" && Number.isFinite(x) && Number.isFinite(y) && (height === null || Number.isFinite(height));
  const place = valid ? view.geodeticOf(x, y) : null;
  const take = (place: Place | null): void => {
    if (place !== null) setFields({ x: place.x.toFixed(1), y: place.y.toFixed(1), height: place.heightM?.toFixed(1) ?? "" });
  };
  const pick = (): void => {
    setDraft(beginGoto(store, view, (at) => setFields((before) => ({ ...before, x: at.x.toFixed(1), y: at.y.toFixed(1) }))));
  };
  useEffect(() => () => draft?.end(), [draft]);
  useEffect(() => { // x and y were of the frame before
    setDraft(null);
    setFields((before) => ({ ...before, x: "", y: "" }));
  }, [origin?.lat_deg, origin?.lon_deg, origin?.x_heading_deg]);
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
        <button type="button" disabled={!enabled} title="Take over where they are" onClick={() => take(currentPlace(flying(store, targets), view.frame))}>Now</button>
        <button type="button" disabled={!enabled} title="Take over where skygcs' setpoints send them" onClick={() => take(targetPlace(flying(store, targets)))}>Target</button>
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
      <label class="check" title="The daemon sends the place as a setpoint, over and over, until Off or another order">
        <input type="checkbox" checked={kept} onChange={(event) => setKept(event.currentTarget.checked)} /> Keep sending it, by setpoints
      </label>
      <HoldButton targets={targets} class="order wide" disabled={!enabled || place === null} what={`Send ${who} to x ${fields.x}, y ${fields.y}${up}${kept ? ", by setpoints until Off" : ""}`}
        act={() => {
          const now = view.geodeticOf(x, y);
          if (now === null) return;
          const goals = new Map(goalsOf(store, view.frame, x, y).map(({ name, to }) => [name, to]));
          const label = `Go to x ${fixed(x, 1) ?? ""}, y ${fixed(y, 1) ?? ""}${up}`;
          const go = async (): Promise<void> => {
            if (kept && !(await engage(store, connection, targets))) return;
            const state = await send({ label, method: "vehicles.goto", params: { ...now, height_m: height } });
            if (state === "done") store.dispatch({ type: "goals", goals });
          };
          void go();
          draft?.end();
          setDraft(null);
        }}>
        <span>Send there</span>
      </HoldButton>
      {targets.length > 1 && <p class="muted small">They keep their formation; its middle flies there.</p>}
    </section>
  );
}

function flying(store: Store, targets: readonly string[]): Vehicle[] {
  return targets.flatMap((name) => store.state.vehicles.get(name) ?? []);
}
