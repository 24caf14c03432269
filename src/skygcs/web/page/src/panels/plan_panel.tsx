// Plans for the fleet: files, a formation or goals that are dragged; the certificate; the timeline; the flight.

import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { toDecimetre } from "../format.ts";
import { FRAME_UNKNOWN, frameIsKnown, frameKeyOf } from "../framed.ts";
import { FrameNote } from "../order_parts.tsx";
import { useFramed, useFrameKnown, useOverlay, useSelected, useStore } from "../hooks.ts";
import type { State } from "../store.ts";
import type { Vec3 } from "../types.ts";
import { goalsTool, overlay } from "./drafts.ts";
import { formation, SHAPES, type FormationShape } from "./formation.ts";
import { LiveFormation } from "./live_formation.tsx";
import { Check, Choice, contentOf, DropZone, type FileContent, Failure, Fold, Kept, NumberField, PlainTable, Scroll, SubTabs, useAsk, useKept, useTool, useWork } from "./parts.tsx";
import { PlanFlight } from "./plan_flight.tsx";
import { approachText, ghostShapes, planShapes, termRows, type Approach, type CheckedPlan } from "./plan_shapes.ts";
import { PlanTimeline } from "./plan_timeline.ts";
import { PositionTableLoader } from "./position_table.tsx";
import type { PanelProps } from "./registry.ts";
import { Timeline } from "./timeline.tsx";

const OVERLAY = "plan";
const SHAPE_OVERLAY = "plan draft";

type Source = "files" | "formation" | "goals" | "live";

const TABS: readonly { id: Source; title: string }[] = [
  { id: "files", title: "File" },
  { id: "formation", title: "Formation" },
  { id: "goals", title: "Final positions" },
  { id: "live", title: "Live" },
];

/** It outlives the panel: another tab must not lose a plan. */
const CHECKED = new Kept<CheckedPlan | null>(null);
const SOURCE = new Kept<Source>("files");

/** Shows what is found, in place of the plan before; but what a newer wish asked for is not replaced by it, on whichever tab. */
type Take = (asked: Promise<CheckedPlan | null>) => Promise<void>;

let newestWish = 0;

export default function PlanPanel(props: PanelProps) {
  const { view } = props;
  const [source, keepSource] = useKept(SOURCE);
  const [checked, keepChecked] = useKept(CHECKED);
  const timeline = useMemo(() => (checked === null || checked.paths === null ? null : new PlanTimeline(checked.paths)), [checked]);
  const still = useMemo(() => (checked === null ? [] : planShapes(checked, timeline)), [checked, timeline]);
  const [t_s, setT] = useState(0);
  useOverlay(view, OVERLAY, useMemo(() => overlay(still, timeline === null ? [] : ghostShapes(timeline, t_s)), [still, timeline, t_s]));
  const discard = (): number => {
    keepChecked(null);
    setT(0);
    return ++newestWish;
  };
  const take: Take = async (asked) => {
    const mine = discard();
    const found = await asked;
    if (mine === newestWish) keepChecked(found);
  };
  return (
    <div class="panel planpanel">
      <SubTabs label="Where it comes from" tabs={TABS} now={source} go={(id) => keepSource(id as Source)} />
      {source === "files" && <FromFiles {...props} take={take} />}
      {source === "formation" && <FromFormation {...props} take={take} />}
      {source === "goals" && <FromGoals {...props} take={take} />}
      {source === "live" && <LiveFormation {...props} />}
      {checked !== null && <Judged checked={checked} discard={discard} />}
      {timeline !== null && <Timeline timeline={timeline} phases={checked?.paths?.phases ?? []} downwashRatio={checked?.certificate?.downwash_ratio ?? 2} t_s={t_s} setT={setT} />}
      <PlanFlight {...props} checked={checked} follow={setT} />
    </div>
  );
}

/** Where the page sees vehicles that take no part. */
function standingBut(state: State, names: readonly string[]): Record<string, Vec3> {
  const found: Record<string, Vec3> = {};
  for (const vehicle of state.vehicles.values()) {
    const place = vehicle.position?.enu_m;
    if (place !== null && place !== undefined && !names.includes(vehicle.name)) found[vehicle.name] = place;
  }
  return found;
}

// --- files ------------------------------------------------------------------------------------------------------------

function FromFiles({ store, connection, take }: PanelProps & { take: Take }) {
  const check = useAsk<CheckedPlan>(store, connection, "web.plan.check");
  const read = useWork<FileContent[]>();
  const open = async (chosen: File[]): Promise<void> => {
    const files = await read.run(async () => {
      const contents = await Promise.all(chosen.map(contentOf));
      if (!frameIsKnown(store.state)) throw new Error(FRAME_UNKNOWN);
      return contents;
    });
    if (files === null) return; // what is shown stays
    const { origin } = store.state;
    await take(check.run({ files, standing: standingBut(store.state, []), ...(origin === null ? {} : { origin }) }));
  };
  return (
    <>
      <DropZone label="Open a plan" several accept=".json,.skyc,.csv" onFiles={(files) => void open(files)} />
      <p class="muted">Plans of skygcs (.json), Skybrush shows (.skyc), paths or Crazyswarm trajectories (.csv, one or several).</p>
      {check.busy && <p class="note">Certifying …</p>}
      <Failure text={read.error ?? check.error} />
    </>
  );
}

// --- planned here -----------------------------------------------------------------------------------------------------

/** The selected vehicles that have no position in the fleet's frame yet: no plan can start from where they are. */
function useUnplaced(store: PanelProps["store"], names: readonly string[]): readonly string[] {
  const joined = useStore(store, (state) => names.filter((name) => state.vehicles.get(name)?.position?.enu_m == null).join(" "));
  return useMemo(() => (joined === "" ? [] : joined.split(" ")), [joined]);
}

/** Asks for the plan of a task for some vehicles, and takes it in place of the one before. */
function usePlanning({ store, connection, take }: Pick<PanelProps, "store" | "connection"> & { take: Take }, names: readonly string[]) {
  const check = useAsk<CheckedPlan>(store, connection, "web.plan.check");
  const run = (task: object): Promise<void> => take(check.run({ task, standing: standingBut(store.state, names) }));
  return { check, run };
}

/** Places to start from: above where vehicles are, at least so high. */
function startsOf(state: State, names: readonly string[], leastM: number): Record<string, Vec3> {
  const found: Record<string, Vec3> = {};
  for (const name of names) {
    const place = state.vehicles.get(name)?.position?.enu_m;
    if (place !== null && place !== undefined) found[name] = [round(place[0]), round(place[1]), round(Math.max(place[2], leastM))];
  }
  return found;
}

function round(value: number): number {
  return Math.round(value * 100) / 100;
}

function FromFormation({ store, connection, view, take }: PanelProps & { take: Take }) {
  const names = useSelected(store);
  const [shape, setShape] = useState<FormationShape>("v");
  const [spacing, setSpacing] = useState(8);
  const [height, setHeight] = useState(20);
  const [yaw, setYaw] = useState(90);
  const [chosen, setMiddle] = useFramed<readonly [number, number] | null>(store, null);
  const unplaced = useUnplaced(store, names);
  const [x, y] = chosen ?? middleOf(store.state, names);
  const middle = useMemo(() => [x, y] as const, [x, y]);
  const { check, run } = usePlanning({ store, connection, take }, names);
  const places = useMemo(
    () => formation(shape, names.length, spacing, [middle[0], middle[1], height], (yaw * Math.PI) / 180),
    [shape, names, spacing, middle, height, yaw],
  );
  const ghosts = useMemo(() => overlay(places.map((at) => ({ kind: "mark", at, symbol: "ghost", ink: "draft", yawRad: (yaw * Math.PI) / 180 }))), [places, yaw]);
  useOverlay(view, SHAPE_OVERLAY, ghosts);
  const tool = useTool(
    view,
    () => ({ cursor: "crosshair", hint: "Click: the middle of the formation.", click: (at) => setMiddle([toDecimetre(at.x), toDecimetre(at.y)]) }),
    "formation",
  );
  const plan = async (): Promise<void> => {
    const starts = startsOf(store.state, names, height / 2);
    const task = { starts, formation: { shape, spacing_m: spacing, middle_m: [middle[0], middle[1], height], yaw_deg: yaw } };
    await run(task);
  };
  return (
    <>
      <div class="row wrap">
        <Choice label="Shape" value={shape} options={SHAPES.map((one) => [one, one === "v" ? "V" : one])} onValue={setShape} />
        <NumberField label="Spacing" unit="m" value={spacing} least={0.5} most={1000} onValue={(value) => value !== null && setSpacing(value)} />
        <NumberField label="Height" unit="m" value={height} least={1} most={500} onValue={(value) => value !== null && setHeight(value)} />
        <NumberField label="Looks to" unit="° from x" value={yaw} least={-360} most={360} onValue={(value) => value !== null && setYaw(value)} />
        <NumberField label="Middle x" unit="m" value={middle[0]} onValue={(value) => value !== null && setMiddle([value, middle[1]])} />
        <NumberField label="y" unit="m" value={middle[1]} onValue={(value) => value !== null && setMiddle([middle[0], value])} />
      </div>
      {!tool.active && <button type="button" onClick={tool.resume}>Point on the view</button>}
      <PlanButton store={store} names={names} unplaced={unplaced} busy={check.busy} plan={plan} error={check.error} />
    </>
  );
}

function middleOf(state: State, names: readonly string[]): readonly [number, number] {
  const places = Object.values(startsOf(state, names, 0));
  if (places.length === 0) return [0, 0];
  const mean = (k: 0 | 1): number => Math.round(places.reduce((sum, place) => sum + place[k], 0) / places.length);
  return [mean(0), mean(1)];
}

const NO_GOALS: ReadonlyMap<string, Vec3> = new Map();

function FromGoals({ store, connection, view, take }: PanelProps & { take: Take }) {
  const names = useSelected(store);
  const [height, setHeight] = useState(20);
  const [exchange, setExchange] = useState(false);
  const [goals, setGoals] = useFramed<ReadonlyMap<string, Vec3>>(store, NO_GOALS);
  const frame = useStore(store, frameKeyOf);
  const { check, run } = usePlanning({ store, connection, take }, names);
  const unplaced = useUnplaced(store, names);
  // who is selected anew, or has a position only now, begins where it is; who was dragged stays where it was put
  useEffect(() => {
    const starts = startsOf(store.state, names, height);
    setGoals((before) => new Map(names.flatMap((name) => {
      const place = before.get(name) ?? starts[name];
      return place === undefined ? [] : [[name, place] as const];
    })));
  }, [store, names, height, unplaced, frame, setGoals]);
  const latest = useRef(goals);
  latest.current = goals;
  const tool = useTool(
    view,
    () => goalsTool(() => latest.current, (name, place) => setGoals((before) => new Map([...before, [name, place]])), "Drag each vehicle's final position."),
    "goals",
  );
  const handles = useMemo(() => overlay([...goals].map(([name, at]) => ({ kind: "mark", at, symbol: "handle", ink: "draft", text: name }))), [goals]);
  useOverlay(view, SHAPE_OVERLAY, handles);
  const plan = async (): Promise<void> => {
    const task = { starts: startsOf(store.state, names, height / 2), goals: Object.fromEntries(goals), exchange };
    await run(task);
  };
  return (
    <>
      <PositionTableLoader store={store} connection={connection} view={view} take={setGoals} />
      <div class="row wrap">
        <NumberField label="Height of all" unit="m" value={height} least={1} most={500} onValue={(value) => {
          if (value === null) return;
          setHeight(value);
          setGoals((before) => new Map([...before].map(([name, [x, y]]) => [name, [x, y, value]])));
        }} />
        <Check checked={exchange} onChecked={setExchange}>vehicles may change places</Check>
      </div>
      {goals.size > 0 && (
        <Scroll label="Goals" tall>
          <table class="plain">
            <tbody>
              {[...goals].map(([name, [x, y, up]]) => (
                <tr key={name}>
                  <td>{name}</td>
                  <td class="number">{x.toFixed(1)}, {y.toFixed(1)}</td>
                  <td>
                    <NumberField label={`Height of ${name}`} unit="m" value={up} least={0.5} most={500} onValue={(value) => value !== null && setGoals(new Map([...goals, [name, [x, y, value]]]))} />
                  </td>
                </tr>
              ))}
            </tbody>
          </table>
        </Scroll>
      )}
      {!tool.active && <button type="button" onClick={tool.resume}>Point on the view</button>}
      <PlanButton store={store} names={names} unplaced={unplaced} busy={check.busy} plan={plan} error={check.error} />
    </>
  );
}

interface PlanButtonProps extends Pick<PanelProps, "store"> {
  names: readonly string[];
  unplaced: readonly string[];
  busy: boolean;
  plan: () => Promise<void>;
  error: string | null;
}

function PlanButton({ store, names, unplaced, busy, plan, error }: PlanButtonProps) {
  const known = useFrameKnown(store);
  return (
    <>
      <FrameNote store={store} />
      {names.length === 0 && <p class="note">Select the vehicles that take part.</p>}
      {unplaced.length > 0 && <p class="note">No position yet: {unplaced.join(", ")}. A plan starts where the vehicles are.</p>}
      <button type="button" class="primary" disabled={!known || names.length === 0 || unplaced.length > 0 || busy} onClick={() => void plan()}>
        {busy ? "Planning …" : `Plan for ${names.length} ${names.length === 1 ? "vehicle" : "vehicles"}`}
      </button>
      <Failure text={error} />
    </>
  );
}

// --- the judgement ----------------------------------------------------------------------------------------------------

function Judged({ checked, discard }: { checked: CheckedPlan; discard: () => void }) {
  const { certificate } = checked;
  return (
    <section class="card" aria-label="Certificate">
      <header class="row">
        <h3>{checked.name}</h3>
        <span class={checked.ok ? "verdict good" : "verdict failure"}>{checked.ok ? "certified" : "refused"}</span>
        <button type="button" class="quiet" aria-label="Discard the plan" onClick={discard}>×</button>
      </header>
      <p>
        {checked.format}
        {certificate !== null && `, ${certificate.vehicles} ${certificate.vehicles === 1 ? "vehicle" : "vehicles"}, ${certificate.kind}`}
        {checked.paths !== null && `, ${checked.paths.duration_s.toFixed(1)} s`}
        {checked.attempts.length > 0 && `, ${checked.attempts.at(-1) ?? ""}`}
      </p>
      {!checked.ok && <ul class="findings">{checked.reasons.slice(0, 20).map((reason) => <li key={reason} data-verdict="fail">{reason}</li>)}</ul>}
      {certificate?.closest != null && (
        <><p>Closest: {approachText(certificate.closest)}</p><Terms approach={certificate.closest} ratio={certificate.downwash_ratio} /></>
      )}
      {checked.paths?.exact === false && <p class="muted">Long: it is drawn by samples; the certificate is exact.</p>}
    </section>
  );
}

function Terms({ approach, ratio }: { approach: Approach; ratio: number }) {
  return (
    <Fold title="Terms of the margin">
      <PlainTable rows={termRows(approach)} keyOf={([name]) => name} columns={[
        [`m (heights / ${ratio})`, ([name]) => name],
        ...approach.vehicles.map((name, i) => [name, (row: readonly [string, number, number]) => row[i === 0 ? 1 : 2].toFixed(3), "number"] as const),
      ]} />
    </Fold>
  );
}
