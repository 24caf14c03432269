// The origin of the fleet's frame: taken from a vehicle, typed, or clicked. Nothing moves by it, but every place is counted anew.

import { useEffect, useState } from "preact/hooks";
import { fixed } from "./format.ts";
import { HoldButton } from "./hold_button.tsx";
import { useStore } from "./hooks.ts";
import type { ButtonsProps } from "./order_parts.tsx";
import { runOrder } from "./orders.ts";
import { Check } from "./panels/parts.tsx";
import type { Method, Origin, Params } from "./types.ts";

const DIGITS_DEG = 7;
const FIELDS = [["lat", "Latitude, °"], ["lon", "Longitude, °"], ["alt", "Height, m AMSL"], ["heading", "Heading of x, °"]] as const;
const LIMITS: Readonly<Record<string, number>> = { lat: 90, lon: 180, alt: 9000, heading: 360 };

type Fields = Readonly<Record<(typeof FIELDS)[number][0], string>>;

export function OriginOrder({ store, connection, view, targets }: ButtonsProps) {
  const origin = useStore(store, (state) => state.origin);
  const open = useStore(store, (state) => state.phase.kind === "open" && state.daemon?.connected === true);
  const [fields, setFields] = useState<Fields>(() => fieldsOf(origin));
  const [nose, setNose] = useState(false);
  const [shown, setShown] = useState(false);
  useEffect(() => setFields(fieldsOf(origin)), [origin]);
  const [lat_deg = NaN, lon_deg = NaN, alt_amsl_m = NaN, x_heading_deg = NaN] = FIELDS.map(([key]) => (fields[key].trim() === "" ? NaN : Number(fields[key])));
  const valid = FIELDS.every(([key]) => fields[key].trim() !== "" && Math.abs(Number(fields[key])) <= (LIMITS[key] ?? 0));
  const one = targets.length === 1 ? targets[0] : undefined;
  const order = <M extends Method>(label: string, method: M, params: Params[M]): void => void runOrder(store, connection, { label, method, params, targets: [] });
  const click = (): void => {
    view.setTool({
      cursor: "crosshair",
      hint: "Click where zero is to be, then hold “Set the origin”.",
      click: ({ x, y }) => {
        const place = view.geodeticOf(x, y);
        if (place !== null) setFields((before) => ({ ...before, lat: place.lat_deg.toFixed(DIGITS_DEG), lon: place.lon_deg.toFixed(DIGITS_DEG) }));
        view.setTool(null);
      },
    });
  };
  return (
    <details class="origin" onToggle={(event) => setShown(event.currentTarget.open)}>
      <summary>Origin{origin === null ? ": none" : ""}</summary>
      {shown && <>
        <div class="fields">
          {FIELDS.map(([key, label]) => (
            <label key={key} class="field">
              <span>{label}</span>
              <input type="text" inputMode="decimal" value={fields[key]} onInput={(event) => setFields({ ...fields, [key]: event.currentTarget.value })} />
            </label>
          ))}
        </div>
        <div class="row">
          <button type="button" disabled={!open} onClick={click}>Choose in the view</button>
          <HoldButton targets={[]} disabled={!open || !valid} what={`Set the origin to ${fields.lat}, ${fields.lon}, ${fields.alt} m: every place is counted from there`}
            act={() => order("Set the origin", "origin.set", { lat_deg, lon_deg, alt_amsl_m, x_heading_deg })}>
            Set the origin
          </HoldButton>
        </div>
        <div class="row">
          <HoldButton targets={one === undefined ? [] : [one]} disabled={!open || one === undefined} what={`Set the origin to where ${one ?? "the selected vehicle"} is`}
            act={() => one !== undefined && order(`Origin from ${one}`, "origin.from_vehicle", { target: one, heading: nose })}>
            {one === undefined ? "Where one vehicle is" : `Where ${one} is`}
          </HoldButton>
          <Check checked={nose} onChecked={setNose}>x along its nose</Check>
        </div>
      </>}
    </details>
  );
}

function fieldsOf(origin: Origin | null): Fields {
  if (origin === null) return { lat: "", lon: "", alt: "", heading: "90" };
  return {
    lat: origin.lat_deg.toFixed(DIGITS_DEG),
    lon: origin.lon_deg.toFixed(DIGITS_DEG),
    alt: fixed(origin.alt_amsl_m, 1)?.replace("−", "-") ?? "",
    heading: fixed(origin.x_heading_deg, 1) ?? "90",
  };
}
