// Flight by setpoints of one vehicle: who flies it and why, the error as it is now, and the gains.

import { useEffect, useState } from "preact/hooks";
import { fixed } from "../format.ts";
import { HoldButton } from "../hold_button.tsx";
import { useStore, useTick } from "../hooks.ts";
import { runOrder, sendOrder } from "../orders.ts";
import { mayOrder } from "./calls.ts";
import { Chart } from "./chart.tsx";
import { histories } from "./histories.ts";
import { Facts, Failure, NumberField, useAsk } from "./parts.tsx";
import type { VehicleProps } from "./vehicle_panel.tsx";
import { isControlled, isFlown, isHeld } from "../setpoint_orders.ts";
import type { Params } from "../types.ts";
import type { GainsOfVehicle } from "../rpc_types.ts";

const MODES = [["position", "Position"], ["velocity", "Velocity"], ["attitude", "Attitude"]] as const;

export function VehicleControl(props: VehicleProps) {
  const { store, connection, name } = props;
  useTick(200);
  const orders = useStore(store, mayOrder);
  const vehicle = store.state.vehicles.get(name);
  const control = vehicle?.control ?? null;
  const errors = histories.errorOf(name);
  const order = (mode: Params["control.set"]["mode"]): void =>
    void sendOrder(store, connection, { label: mode === "off" ? "Setpoints off" : `Fly by ${mode} setpoints`, method: "control.set", params: { mode }, targets: [name] });
  return (
    <>
      <p>
        {control === null || !isControlled(vehicle)
          ? "Its autopilot flies it: skygcs sends no setpoints."
          : isHeld(vehicle) ? "The guard has ended the setpoints: skygcs sends none." : `Setpoints: ${control.state}${control.control_mode === null ? "" : `, by ${control.control_mode}`}`}
      </p>
      {(control?.reasons ?? []).map((reason) => <p key={reason} class="failure">{reason}</p>)}
      {orders && (
        <div class="row">
          {MODES.map(([mode, title]) => (
            <HoldButton key={mode} targets={[name]} what={`Fly ${name} by ${mode} setpoints`} act={() => order(mode)}>{title}</HoldButton>
          ))}
          <button type="button" disabled={!isControlled(vehicle)} onClick={() => order("off")}>Off</button>
        </div>
      )}
      <Chart
        title="Error, m"
        curves={[{ label: "distance", colour: 2 }, { label: "x", colour: 1 }, { label: "y", colour: 3 }, { label: "up", colour: 5 }]}
        columns={() => errors.columns()}
        version={errors.version}
        heightPx={160}
      />
      {control !== null && isFlown(vehicle) && <Figures control={control} />}
      <Gains {...props} enabled={orders} />
    </>
  );
}

function Figures({ control }: { control: Readonly<Record<string, unknown>> }) {
  const rows: readonly (readonly [string, string])[] = [
    ["follows", (control["stream"] as { client?: string } | null | undefined)?.client ?? "nobody's setpoints"],
    ["error", metres(control["error_m"])],
    ["reference", vector((control["reference"] as { pos_enu_m?: unknown } | null)?.pos_enu_m)],
    ["age of the state", seconds(control["state_age_s"])],
    ["delay, p95", seconds(control["delay_p95_s"])],
    ["round trip, p95", seconds(control["rtt_s"])],
    ["rate", `${number(control["rate_hz"], 1)} Hz`],
    ["late ticks", `${number(control["late"], 0)} of ${number(control["ticks"], 0)}`],
    ["lateness, p99", seconds(control["lateness_p99_s"])],
    ["thrust", number(control["thrust"], 3)],
    ["roll, pitch", `${number(control["roll_deg"], 1)}°, ${number(control["pitch_deg"], 1)}°`],
    ["at its limits", list(control["saturation"])],
  ];
  return <Facts facts={rows} />;
}

function number(value: unknown, digits: number): string {
  return typeof value === "number" ? (fixed(value, digits) ?? "–") : "–";
}

function metres(value: unknown): string {
  return typeof value === "number" ? `${number(value, 2)} m` : "–";
}

function seconds(value: unknown): string {
  return typeof value === "number" ? `${number(value, 3)} s` : "–";
}

function vector(value: unknown): string {
  return Array.isArray(value) ? `${value.map((one) => number(one, 1)).join(", ")} m` : "–";
}

function list(value: unknown): string {
  return Array.isArray(value) && value.length > 0 ? value.join(", ") : "none";
}

// --- gains ------------------------------------------------------------------------------------------------------------

const GAIN_WORDS: Readonly<Record<string, string>> = { pos_p_per_s: "place P", vel_p: "speed P", vel_i: "speed I", vel_d: "speed D" };

function Gains({ store, connection, name, enabled }: VehicleProps & { enabled: boolean }) {
  const { answer, error, run, show } = useAsk(store, connection, "control.gains");
  const gains = answer?.gains[name] ?? null;
  const [changes, setChanges] = useState<Readonly<Record<string, number>>>({});
  const change = (key: string) => (typed: number | null): void => {
    const now = typed === null ? [] : [[key, typed] as const]; // what is no number is no change
    setChanges((before) => Object.fromEntries([...Object.entries(before).filter(([other]) => other !== key), ...now]));
  };
  useEffect(() => { if (enabled) void run({ targets: [name] }); }, [run, name, enabled]);
  if (gains === null) return <Failure text={error} />;
  const changed = Object.entries(changes).filter(([key, value]) => value !== valueAt(gains, key));
  const apply = async (): Promise<void> => {
    const request = { label: `Set ${changed.length} gains`, method: "control.gains" as const, params: { targets: [name], ...nested(changed) }, targets: [name] };
    const set = await runOrder(store, connection, request);
    if (set === null) return;
    show(set);
    setChanges({});
  };
  return (
    <section class="panelbody" aria-label="Gains">
      <h3>Gains of attitude control</h3>
      <div class="gains">
        {(["xy", "z"] as const).map((axis) => (
          <fieldset key={axis} class="card">
            <legend>{axis === "xy" ? "horizontal" : "vertical"}</legend>
            {Object.entries(gains[axis]).map(([key, value]) => (
              <NumberField
                key={key}
                label={GAIN_WORDS[key] ?? key}
                value={changes[`${axis}.${key}`] ?? value}
                least={0}
                most={100}
                onValue={change(`${axis}.${key}`)}
              />
            ))}
          </fieldset>
        ))}
      </div>
      <NumberField label="hover thrust" value={changes["hover_thrust"] ?? gains.hover_thrust} least={0} most={1} onValue={change("hover_thrust")} />
      <div class="row">
        <HoldButton targets={[name]} what={`Set ${changed.length} gains of ${name}`} disabled={changed.length === 0} act={() => void apply()}>
          Set gains
        </HoldButton>
        <button type="button" disabled={Object.keys(changes).length === 0} onClick={() => setChanges({})}>Discard</button>
      </div>
    </section>
  );
}

function valueAt(gains: GainsOfVehicle, key: string): number | undefined {
  const [axis, gain] = key.split(".");
  if (axis === "xy" || axis === "z") return gains[axis][gain ?? ""];
  return gains.hover_thrust;
}

/** {"xy.vel_p": 1} as {xy: {vel_p: 1}}. */
function nested(changes: readonly (readonly [string, number])[]): object {
  const found: Record<string, unknown> = {};
  for (const [key, value] of changes) {
    const [axis = "", gain] = key.split(".");
    if (gain === undefined) found[axis] = value;
    else found[axis] = { ...(found[axis] as object | undefined), [gain]: value };
  }
  return found;
}
