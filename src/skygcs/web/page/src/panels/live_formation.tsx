// A formation that flies now: start it, move its leader, turn, scale and stop it. Its places are ghosts on the view.

import { useMemo, useState } from "preact/hooks";
import { namesText, toDecimetre } from "../format.ts";
import { HoldButton } from "../hold_button.tsx";
import { useFramed, useFrameKnown, useOverlay, useStore } from "../hooks.ts";
import type { Method, Params, Vec3 } from "../types.ts";
import { runOrder } from "../orders.ts";
import { mayOrder } from "./calls.ts";
import { overlay } from "./drafts.ts";
import { SHAPES, type FormationShape } from "./formation.ts";
import { Choice, Failure, NumberField, PlainTable, usePolled, useTool } from "./parts.tsx";
import type { PanelProps } from "./registry.ts";
import type { FormationStatus } from "../rpc_types.ts";

const OVERLAY = "live formation";

const VIRTUAL = "";

type Shape = FormationShape | "current";

export function LiveFormation(props: PanelProps) {
  const { store, connection, view } = props;
  const orders = useStore(store, mayOrder);
  const found = usePolled(store, connection, "formation.status", {}, 500);
  const status = found.answer;
  const flies = status?.state === "flying";
  const ghosts = useMemo(
    () => (flies ? overlay(status.members.map((one) => ({ kind: "mark", at: one.place_enu_m, symbol: "ghost", ink: "plan", text: one.vehicle }))) : null),
    [flies, status],
  );
  useOverlay(view, OVERLAY, ghosts);
  if (status === null) {
    const missing = found.error?.includes("formation.status") === true;
    return missing ? <p class="note">No live formations: add a table [formation] to the fleet file.</p> : <Failure text={found.error} />;
  }
  return (
    <section class="card" aria-label="Live formation">
      <Shown status={status} />
      {orders && flies && <Flying {...props} status={status} />}
      {orders && <Start {...props} flies={flies} />}
    </section>
  );
}

function Shown({ status }: { status: FormationStatus }) {
  if (status.state === "none") return <p class="muted">No formation flies.</p>;
  return (
    <>
      <p>
        <b>{status.settled ? "settled" : status.state}</b>
        {status.leader === "virtual" ? "" : ` behind ${status.leader ?? "?"}`}
        {status.rms_m == null ? "" : `, ${status.rms_m.toFixed(1)} m off their places in the mean`}
        {status.least_m == null ? "" : `, least distance ${status.least_m.toFixed(1)} m (${(status.least_pair ?? []).join(" and ")})`}
      </p>
      {status.reason !== "" && <p class="failure">{status.reason}</p>}
      <PlainTable rows={status.members} keyOf={(one) => one.vehicle} row={(one) => ({ class: one.left === null ? "" : "lost" })} columns={[
        ["vehicle", (one) => one.vehicle],
        ["state", (one) => (one.left !== null ? `left: ${one.left}` : one.hindered ? "another is in its way" : one.at_place ? "at its place" : "on its way")],
        ["off its place", (one) => (one.off_place_m === null ? "–" : `${one.off_place_m.toFixed(1)} m`), "number"],
      ]} />
    </>
  );
}

function Flying({ store, connection, view, status }: PanelProps & { status: FormationStatus }) {
  const targets = status.members.map((one) => one.vehicle);
  const [chosen, setChosen] = useFramed<Vec3 | null>(store, null);
  const known = useFrameKnown(store);
  const middle = status.middle_enu_m ?? [0, 0, 10];
  const to = chosen ?? middle;
  const [heading, setHeading] = useState(Math.round(status.heading_deg ?? 0));
  const [scale, setScale] = useState(status.scale ?? 1);
  const order = <M extends Method>(label: string, method: M, params: Params[M]): void => void runOrder(store, connection, { label, method, params, targets });
  const tool = useTool(
    view,
    () => ({
      cursor: "crosshair",
      hint: "Click: where the formation's middle is to fly to. Nothing flies before you say so.",
      click: (at) => setChosen((before) => [toDecimetre(at.x), toDecimetre(at.y), (before ?? middle)[2]]),
    }),
    "live formation",
  );
  const axis = (k: 0 | 1 | 2) => (value: number | null): void => {
    if (value !== null) setChosen((before) => (before ?? middle).map((old, n) => (n === k ? value : toDecimetre(old))) as unknown as Vec3);
  };
  return (
    <>
      {status.leader === "virtual" && (
        <div class="row wrap">
          <NumberField label="To x" unit="m" value={toDecimetre(to[0])} onValue={axis(0)} />
          <NumberField label="y" unit="m" value={toDecimetre(to[1])} onValue={axis(1)} />
          <NumberField label="Height" unit="m" value={toDecimetre(to[2])} onValue={axis(2)} />
          {!tool.active && <button type="button" onClick={tool.resume}>Point on the view</button>}
          <HoldButton targets={targets} disabled={chosen === null || !known} what={`Fly the formation of ${namesText(targets)} there`} act={() => order("Move formation", "formation.move", { to_enu_m: to })}>
            Fly there
          </HoldButton>
        </div>
      )}
      <div class="row wrap">
        <NumberField label="Looks to" unit="° from x" value={heading} least={-360} most={360} onValue={(value) => value !== null && setHeading(value)} />
        <HoldButton targets={targets} what={`Turn the formation of ${namesText(targets)}`} act={() => order("Turn formation", "formation.turn", { heading_deg: heading })}>
          Turn
        </HoldButton>
        <NumberField label="Scale" unit="×" value={scale} least={0.1} most={10} onValue={(value) => value !== null && setScale(value)} />
        <HoldButton targets={targets} what={`Scale the formation of ${namesText(targets)}`} act={() => order("Scale formation", "formation.scale", { factor: scale })}>
          Scale
        </HoldButton>
      </div>
      <div class="row">
        <button type="button" class="primary" onClick={() => order("Stop formation", "formation.stop", {})}>Stop: all brake and hold</button>
      </div>
    </>
  );
}

function Start({ store, connection, flies }: PanelProps & { flies: boolean }) {
  const selection = useStore(store, (state) => state.selection);
  const known = useStore(store, (state) => state.names);
  const [shape, setShape] = useState<Shape>("v");
  const [spacing, setSpacing] = useState(8);
  const [heading, setHeading] = useState(0);
  const [leader, setLeader] = useState(VIRTUAL);
  const targets = [...selection].filter((name) => name !== leader);
  const leaders = known.filter((name) => !selection.has(name));
  const params = { targets, shape, spacing_m: spacing, heading_deg: heading, ...(leader === VIRTUAL ? {} : { leader }) };
  const start = (): void => void runOrder(store, connection, { label: "Start formation", method: "formation.start", params, targets });
  return (
    <>
      <div class="row wrap">
        <Choice
          label="Shape"
          value={shape}
          options={[["current", "as they are"], ...SHAPES.map((one) => [one, one === "v" ? "V" : one] as const)]}
          onValue={setShape}
        />
        <NumberField label="Spacing" unit="m" value={spacing} least={0.5} most={1000} onValue={(value) => value !== null && setSpacing(value)} />
        <NumberField label="Heading" unit="° from x" value={heading} least={-360} most={360} onValue={(value) => value !== null && setHeading(value)} />
        <Choice label="Leader" value={leader} options={[[VIRTUAL, "a point"], ...leaders.map((name) => [name, name] as const)]} onValue={setLeader} />
      </div>
      {targets.length === 0 ? <p class="muted">Select the vehicles that are to follow.</p> : (
        <HoldButton targets={targets} what={`Fly ${namesText(targets)} as a formation`} act={start}>
          {flies ? `New places for ${targets.length}` : `Start formation of ${targets.length}`}
        </HoldButton>
      )}
    </>
  );
}
