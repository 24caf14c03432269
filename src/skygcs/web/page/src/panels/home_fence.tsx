// The fence about home that an autopilot's parameters make: read, and set on the selected vehicles.

import { useEffect } from "preact/hooks";
import { namesText } from "../format.ts";
import { HoldButton } from "../hold_button.tsx";
import { useStore } from "../hooks.ts";
import { runOrder } from "../orders.ts";
import { ask, mayOrder } from "./calls.ts";
import { Choice, Failure, Kept, NumberField, useKept, useWork } from "./parts.tsx";
import type { PanelProps } from "./registry.ts";
import type { FenceResults } from "../rpc_types.ts";

type Outcomes = FenceResults["outcomes"];

type Action = "leave" | "none" | "warn" | "hold" | "return" | "land" | "terminate";

const ACTIONS: readonly (readonly [Action, string])[] = [
  ["leave", "as it is"],
  ["none", "no fence"],
  ["warn", "warn"],
  ["hold", "hold"],
  ["return", "return"],
  ["land", "land"],
  ["terminate", "stop the motors: it falls"],
];

interface Form {
  radiusM: number | null;
  heightM: number | null;
  action: Action;
}

const FORM = new Kept<Form>({ radiusM: null, heightM: null, action: "leave" });

/** The parameters of fence.set: what is left empty stays as it is; null: nothing would be set. */
export function fenceParams({ radiusM, heightM, action }: Form): object | null {
  const params = {
    ...(radiusM === null ? {} : { radius_m: radiusM }),
    ...(heightM === null ? {} : { height_m: heightM }),
    ...(action === "leave" ? {} : { action }),
  };
  return Object.keys(params).length === 0 ? null : params;
}

/** What a person reads of it: "radius 100 m, height 50 m, then return". */
export function fenceText({ radiusM, heightM, action }: Form): string {
  const parts = [
    radiusM === null ? null : radiusM === 0 ? "no radius" : `radius ${radiusM} m`,
    heightM === null ? null : heightM === 0 ? "no height" : `height ${heightM} m`,
    action === "leave" ? null : action === "none" ? "off" : `then ${action === "terminate" ? "stop the motors" : action}`,
  ];
  return parts.filter((part) => part !== null).join(", ");
}

export function HomeFencePanel({ store, connection, targets }: PanelProps & { targets: readonly string[] }) {
  const orders = useStore(store, mayOrder);
  const [form, keep] = useKept(FORM);
  const { busy, answer: found, error, run, show, clear } = useWork<Outcomes>();
  const about = targets.join("\n");
  useEffect(clear, [about, clear]); // what was read of others is not shown
  const read = (): Promise<unknown> => run(async () => (await ask(store, connection, "fence.status", { targets })).outcomes);
  const params = fenceParams(form);
  const set = async (): Promise<void> => {
    if (params === null) return;
    const mine = show(found);
    const request = { label: `Fence about home: ${fenceText(form)}`, method: "fence.set" as const, params: { targets, ...params }, targets };
    const answer = await runOrder(store, connection, request);
    if (answer !== null && mine()) show(answer.outcomes);
  };
  if (targets.length === 0) return <p class="note">Select the vehicles whose fence it is.</p>;
  const whom = namesText(targets);
  return (
    <>
      <p class="muted">A cylinder about home, made by parameters (PX4 GF_*, ArduCopter FENCE_*). An empty field stays as it is; 0 removes a limit.</p>
      {orders && (
        <>
          <div class="row wrap">
            <NumberField label="Radius" unit="m" value={form.radiusM} least={0} most={100_000} placeholder="as it is" onValue={(radiusM) => keep({ ...form, radiusM })} />
            <NumberField label="Height" unit="m" value={form.heightM} least={0} most={10_000} placeholder="as it is" onValue={(heightM) => keep({ ...form, heightM })} />
            <Choice label="Outside of it" value={form.action} options={ACTIONS} onValue={(action) => keep({ ...form, action })} />
          </div>
          <div class="row wrap">
            <HoldButton danger={form.action === "none" || form.action === "terminate"} targets={targets} disabled={params === null}
              what={`Set the fence of ${whom}: ${fenceText(form)}`} act={() => void set()}>
              Set fence
            </HoldButton>
            <button type="button" disabled={busy} onClick={() => void read()}>{busy ? "Reading …" : "Read from the vehicles"}</button>
          </div>
        </>
      )}
      <Failure text={error} />
      {found !== null && <Fences outcomes={found} />}
    </>
  );
}

function Fences({ outcomes }: { outcomes: Outcomes }) {
  return (
    <table class="plain" aria-label="Fences about home">
      <thead><tr><th>vehicle</th><th class="number">radius</th><th class="number">height</th><th>outside of it</th></tr></thead>
      <tbody>
        {Object.entries(outcomes).map(([name, { ok, message, fence }]) => (
          <tr key={name}>
            <td>{name}</td>
            {fence === null ? <td colSpan={3} class={ok ? "" : "failure"}>{message}</td> : (
              <>
                <td class="number">{limitText(fence.radius_m)}</td>
                <td class="number">{limitText(fence.height_m)}</td>
                <td>{fence.enabled === false ? "off" : (fence.action ?? "?")}{ok ? "" : `: ${message}`}</td>
              </>
            )}
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function limitText(limitM: number | null): string {
  return limitM === null ? "none" : `${limitM} m`;
}
