// Missions and fences: a file or a drawing, its check, the upload to the selected vehicles, and the flight.

import { useEffect, useMemo, useReducer, useRef, useState } from "preact/hooks";
import { namesText } from "../format.ts";
import { HoldButton } from "../hold_button.tsx";
import { useFrameKnown, useOverlay, useSelected, useStore } from "../hooks.ts";
import { sendOrder } from "../orders.ts";
import type { Store } from "../store.ts";
import type { Origin, Vec3 } from "../types.ts";
import { mayOrder } from "./calls.ts";
import { type Draft, type DraftSettings, type Drawing, drawnShapes, type KeptDraft, NEW_DRAFT, overlay, pointsTool, shownDraft, withDrawing, without, withSettings } from "./drafts.ts";
import { commandText, countsText, lengthOf, missionShapes, type CheckedMission } from "./mission_shapes.ts";
import { HomeFencePanel } from "./home_fence.tsx";
import { ALIKE, arrangementOf, askedPaths, bySystemId, SeveralFields, severalShapes, type Several } from "./mission_several.tsx";
import { MissionFlight, useMissionStatus } from "./mission_flight.tsx";
import { Choice, contentOf, DropZone, Failure, Kept, NumberField, SubTabs, useAsk, useKept, useTool, useWork, type FileContent } from "./parts.tsx";
import type { PanelProps } from "./registry.ts";

const OVERLAY = "mission";
/** Between the last change of a drawing and its check. */
const CHECK_AFTER_MS = 350;

type What = "file" | "mission" | "polygon" | "circle" | "home";

const TABS: readonly { id: What; title: string }[] = [
  { id: "file", title: "File" },
  { id: "mission", title: "Waypoints" },
  { id: "polygon", title: "Fence" },
  { id: "circle", title: "Round fence" },
  { id: "home", title: "About home" },
];

/** They outlive the panel. */
const drafts = new Map<What, KeptDraft>();
const TAB = new Kept<What>("file");
const FILE = new Kept<FileContent | null>(null);
const SEVERAL = new Kept(ALIKE);

export default function MissionPanel(props: PanelProps) {
  const { store, view } = props;
  const targets = useSelected(store);
  const [tab, keepTab] = useKept(TAB);
  const [checked, setChecked] = useState<CheckedMission | null>(null);
  const { note, ...keeper } = useDraft(store, tab);
  const { draft } = keeper;
  const known = useFrameKnown(store);
  const [several, keepSeveral] = useKept(SEVERAL);
  const [file, keepFile] = useKept(FILE);
  const orders = useStore(store, mayOrder);
  const arranged = targets.length > 1 && (tab === "file" || tab === "mission");
  const status = useMissionStatus(props, targets);
  const [first] = status;
  const current = first?.item ?? null;
  const shapes = useMemo(() => {
    const drawn = tab === "file" ? [] : drawnShapes(draft.drawing, tab === "polygon");
    const circle = tab === "circle" ? circleShapes(draft) : [];
    const shown = checked === null || tab !== "file" ? [] : missionShapes(checked, current);
    const others = tab === "file" || tab === "mission" ? severalShapes(checked?.several ?? null) : [];
    return overlay([...shown, ...others], circle, drawn);
  }, [checked, draft, tab, current]);
  useOverlay(view, OVERLAY, shapes);
  const go = (id: string): void => {
    keepTab(id as What);
    setChecked(null);
  };
  return (
    <div class="panel missionpanel">
      <SubTabs label="Where it comes from" tabs={TABS} now={tab} go={go} />
      {tab === "file" && <FromFile {...props} file={file} keepFile={keepFile} targets={targets} several={several} setChecked={setChecked} />}
      {tab === "home" && <HomeFencePanel {...props} targets={targets} />}
      {tab !== "home" && note !== null && <p class="note" role="status">{note}</p>}
      {tab !== "file" && tab !== "home" && <Drawn key={tab} {...props} what={tab} keeper={keeper} several={several} setChecked={setChecked} targets={targets} />}
      {arranged && orders && <SeveralFields several={several} keep={keepSeveral} names={bySystemId(store, targets)} problem={checked?.several?.problem ?? null} />}
      {checked !== null && known && <Checked {...props} checked={checked} targets={targets} several={arranged ? several : ALIKE} fenceOnly={tab === "polygon" || tab === "circle"} />}
      <MissionFlight {...props} status={status} targets={targets} showDownloaded={(next) => { keepFile(next); go("file"); }} />
    </div>
  );
}

interface DraftKeeper {
  draft: Draft;
  set: (settings: Partial<DraftSettings>) => void;
  draw: (drawing: Drawing) => void;
}

/** What is drawn on this tab, in the frame as it is now, and a word about a frame that has changed since. */
function useDraft(store: Store, tab: What): DraftKeeper & { note: string | null } {
  const origin = useStore(store, (state) => state.origin);
  const known = useFrameKnown(store);
  const [, redraw] = useReducer((n: number) => n + 1, 0);
  const kept = drafts.get(tab) ?? NEW_DRAFT;
  const shown = useMemo(() => shownDraft(kept, origin, known), [kept, origin, known]);
  const keep = (next: KeptDraft): void => {
    drafts.set(tab, next);
    redraw(0);
  };
  const last = (): KeptDraft => drafts.get(tab) ?? NEW_DRAFT;
  return { ...shown, set: (settings) => keep(withSettings(last(), settings)), draw: (drawing) => keep(withDrawing(last(), drawing, store.state)) };
}

function circleShapes(draft: Draft): Parameters<typeof overlay>[0] {
  const [centre] = draft.drawing.points;
  if (centre === undefined) return [];
  return [{ kind: "circle", centre, radiusM: draft.radiusM, ink: draft.inclusion ? "draft" : "danger", filled: true, dashed: !draft.inclusion }];
}

/** What a check has to know of the vehicle and of the picture. */
function context(store: Store, origin: Origin | null, targets: readonly string[], several: Several): object {
  const { state } = store;
  const asked = askedPaths(several, store, targets);
  const vehicle = targets[0] === undefined ? undefined : state.vehicles.get(targets[0]);
  const place = vehicle?.position?.enu_m;
  const family = vehicle?.autopilot === "px4" || vehicle?.autopilot === "ardupilot" ? vehicle.autopilot : null;
  return {
    origin,
    autopilot: family,
    ...(place === null || place === undefined ? {} : { vehicle_xy_m: [place[0], place[1]] }),
    ...(asked === null ? {} : { several: asked }),
  };
}

// --- from a file ------------------------------------------------------------------------------------------------------

interface FileProps extends PanelProps {
  file: FileContent | null;
  keepFile: (file: FileContent) => void;
  targets: readonly string[];
  several: Several;
  setChecked: (checked: CheckedMission | null) => void;
}

function FromFile({ store, connection, file, keepFile, targets, several, setChecked }: FileProps) {
  const check = useAsk<CheckedMission>(store, connection, "web.mission.check");
  const origin = useStore(store, (state) => state.origin);
  const known = useFrameKnown(store);
  const { run, clear } = check;
  // the file is checked again for another vehicle, or about another origin
  useEffect(() => {
    setChecked(null); // what was found of another file, or for another vehicle, is not to be uploaded
    if (file === null || !known) return clear;
    const { text } = file;
    void run({ file, ...context(store, origin, targets, several) }).then((found) => {
      if (found !== null) setChecked({ ...found, text: text ?? null });
    });
    return clear; // nor what is found once another tab is open
  }, [run, clear, store, origin, known, targets, several, file, setChecked]);
  const read = useWork<FileContent>();
  const take = async ([first]: File[]): Promise<void> => {
    const content = first === undefined ? null : await read.run(() => contentOf(first));
    if (content !== null) keepFile(content);
  };
  return (
    <>
      <DropZone label="Open a file" accept=".plan,.waypoints,.txt,.mission,.json" onFiles={(files) => void take(files)} />
      <p class="muted">QGroundControl .plan, Mission Planner .waypoints (QGC WPL 110): mission, fence and rally points.</p>
      {check.busy && <p class="note">Checking …</p>}
      <Failure text={read.error ?? check.error} />
    </>
  );
}

// --- drawn ------------------------------------------------------------------------------------------------------------

function Drawn(props: PanelProps & { what: What; keeper: DraftKeeper; several: Several; setChecked: (checked: CheckedMission | null) => void; targets: readonly string[] }) {
  const { store, connection, view, what, keeper, several, setChecked, targets } = props;
  const { draft, set, draw } = keeper;
  const fence = what !== "mission";
  const check = useAsk<CheckedMission>(store, connection, fence ? "web.fence.check" : "web.mission.check");
  const origin = useStore(store, (state) => state.origin);
  const latest = useRef(keeper);
  latest.current = keeper;
  const tool = useTool(
    view,
    () => {
      const points = { get: () => latest.current.draft.drawing, set: (drawing: Drawing) => latest.current.draw(drawing) };
      const hint = what === "circle" ? "Click: the middle of the fence. Drag moves it." : "Click: a point. Drag moves one.";
      return pointsTool(points, hint, () => (fence ? 0 : latest.current.draft.heightM), what === "circle" ? 1 : undefined);
    },
    what,
  );
  const { run, clear } = check;
  const asked = drawnParams(what, draft);
  const key = JSON.stringify(asked);
  useEffect(() => {
    setChecked(null); // what was found of the drawing before, or once another tab is open, is not to be uploaded
    if (key === "null") return clear;
    const timer = setTimeout(() => {
      const more = context(store, origin, targets, several) as { autopilot: string | null };
      void run({ drawn: JSON.parse(key) as object, ...(fence ? { origin, autopilot: more.autopilot } : more) }).then((found) => {
        if (found !== null) setChecked(found);
      });
    }, CHECK_AFTER_MS);
    return () => {
      clearTimeout(timer);
      clear();
    };
  }, [key, run, clear, store, origin, targets, several, fence, setChecked]);
  return (
    <>
      <p class="muted">{hintOf(what)}</p>
      {!tool.active && <button type="button" onClick={tool.resume}>Draw on</button>}
      {origin === null && <p class="failure">The fleet has no origin yet: what is drawn has no place on earth.</p>}
      {what === "mission" && <MissionFields draft={draft} set={set} />}
      {what === "circle" && <NumberField label="Radius" unit="m" value={draft.radiusM} least={1} most={100000} onValue={(value) => value !== null && set({ radiusM: value })} />}
      {fence && <Choice label="Vehicles stay" value={draft.inclusion ? "in" : "out"} options={[["in", "inside"], ["out", "outside"]]} onValue={(value) => set({ inclusion: value === "in" })} />}
      <Points drawing={draft.drawing} draw={draw} heights={!fence} />
      {check.busy && <p class="note">Checking …</p>}
      <Failure text={check.error} />
    </>
  );
}

function hintOf(what: What): string {
  switch (what) {
    case "mission": return "Click waypoints on the view; drag them; their heights are above home.";
    case "polygon": return "Click the corners of the fence on the view.";
    default: return "Click the middle of the fence on the view.";
  }
}

function drawnParams(what: What, draft: Draft): object | null {
  const { points } = draft.drawing;
  switch (what) {
    case "mission": return points.length === 0 ? null : { waypoints: points, takeoff_height_m: draft.takeoffM, end: draft.end };
    case "polygon": return points.length < 3 ? null : { polygons: [{ inclusion: draft.inclusion, corners: points.map(([x, y]) => [x, y]) }] };
    default: {
      const [centre] = points;
      return centre === undefined ? null : { circles: [{ inclusion: draft.inclusion, center: [centre[0], centre[1]], radius_m: draft.radiusM }] };
    }
  }
}

function MissionFields({ draft, set }: Pick<DraftKeeper, "draft" | "set">) {
  return (
    <div class="row wrap">
      <NumberField label="Height of new points" unit="m" value={draft.heightM} least={1} most={500} onValue={(value) => value !== null && set({ heightM: value })} />
      <NumberField label="Take off to" unit="m" value={draft.takeoffM} least={1} most={500} placeholder="none" onValue={(value) => set({ takeoffM: value })} />
      <Choice label="Then" value={draft.end} options={[["return", "return and land"], ["land", "land at the last point"], ["hold", "hold at the last point"]]} onValue={(end) => set({ end })} />
    </div>
  );
}

function Points({ drawing, draw, heights }: { drawing: Drawing; draw: (drawing: Drawing) => void; heights: boolean }) {
  const { points, selected } = drawing;
  const set = (next: readonly Vec3[], index: number | null): void => draw({ points: next, selected: index });
  if (points.length === 0) return null;
  return (
    <>
      <ol class="points" aria-label="Points">
        {points.map(([x, y, up], i) => (
          <li key={i} aria-selected={i === selected}>
            <button type="button" class="link" onClick={() => set(points, i)}>{x.toFixed(1)}, {y.toFixed(1)}</button>
            {heights && (
              <NumberField label={`Height of point ${i + 1}`} unit="m" value={up} least={0.5} most={500} onValue={(value) => value !== null && set(points.map((point, k): Vec3 => (k === i ? [point[0], point[1], value] : point)), i)} />
            )}
            <button type="button" class="quiet" aria-label={`Remove point ${i + 1}`} onClick={() => set(without(points, i), null)}>×</button>
          </li>
        ))}
      </ol>
      <button type="button" onClick={() => set([], null)}>Clear the drawing</button>
    </>
  );
}

// --- what was found ---------------------------------------------------------------------------------------------------

interface CheckedProps extends PanelProps {
  checked: CheckedMission;
  targets: readonly string[];
  several: Several;
  fenceOnly: boolean;
}

function Checked({ store, connection, checked, targets, several, fenceOnly }: CheckedProps) {
  const orders = useStore(store, mayOrder);
  const [refused, setRefused] = useState(false);
  useEffect(() => setRefused(false), [targets, several]);
  const { text } = checked;
  const lists = fenceOnly ? (["fence"] as const) : checked.holds;
  const upload = (force: boolean): void =>
    void sendOrder(store, connection, {
      label: `Upload ${checked.name}`,
      method: "missions.upload",
      params: { plan: text ?? "", name: checked.name, lists, force, arrangement: checked.holds.includes("mission") ? arrangementOf(several) : null },
      targets,
    }).then((state) => setRefused(state === "failed"));
  const length = lengthOf(checked);
  return (
    <section class="card" aria-label={`Check of ${checked.name}`}>
      <header class="row wrap">
        <h3>{checked.name}</h3>
        <span class={checked.ok ? "verdict good" : "verdict failure"}>{checked.ok ? "can be flown" : "refused"}</span>
      </header>
      <p>
        {countsText(checked)}
        {length > 0 ? `, ${length < 1000 ? `${Math.round(length)} m` : `${(length / 1000).toFixed(1)} km`} between its waypoints` : ""}
      </p>
      <ul class="findings">
        {checked.findings.map((finding, i) => (
          <li key={i} data-verdict={finding.severity === "error" ? "fail" : "unknown"}>
            <span class="verdict">{finding.severity}</span> {finding.item === null ? finding.list : `${finding.list} item ${finding.item}`}: {finding.text}
          </li>
        ))}
      </ul>
      {[...checked.notes, ...checked.changes.map((change) => `changed at the upload: ${change}`)].map((note) => <p key={note} class="muted">{note}</p>)}
      {checked.mission.length > 0 && (
        <details>
          <summary>Items</summary>
          <ol class="items">
            {checked.mission.slice(0, 500).map((item) => (
              <li key={item.number} value={item.number}>
                {commandText(item.name)}
                {item.height_m !== null && <span class="muted"> {item.height_m.toFixed(1)} m above {item.height_above ?? "?"}</span>}
              </li>
            ))}
          </ol>
        </details>
      )}
      {orders && (
        <div class="row wrap">
          <button type="button" class="primary" disabled={targets.length === 0 || text === null || !checked.ok} onClick={() => upload(false)}>
            Upload to {targets.length === 0 ? "selected vehicles" : namesText(targets)}
          </button>
          {(!checked.ok || refused) && text !== null && targets.length > 0 && (
            <HoldButton danger targets={targets} what={`Upload ${checked.name} to ${namesText(targets)} in spite of ${checked.ok ? "what was refused" : "its errors"}`} act={() => upload(true)}>
              Upload all the same
            </HoldButton>
          )}
        </div>
      )}
    </section>
  );
}
