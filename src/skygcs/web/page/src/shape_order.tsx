// Squares, circles, paths and loaded trajectories: flown by the daemon from where each vehicle is, all on one clock.

import { useMemo, useState } from "preact/hooks";
import { toDecimetre } from "./format.ts";
import { frameIsKnown, frameKeyOf } from "./framed.ts";
import { HoldButton } from "./hold_button.tsx";
import { useFramed, useFrameKnown, useOverlay, useStore, useTick } from "./hooks.ts";
import { OrderChain, runOrder } from "./orders.ts";
import { useTargetsText, type ButtonsProps } from "./order_parts.tsx";
import { Choice, NumberField, usePolled } from "./panels/parts.tsx";
import { canPause, engage, isOnTrajectory, isPaused, keptPlace } from "./setpoint_orders.ts";
import { circlePieces, durationOf, pathPieces, pointsAlong, squarePoints, type Piece } from "./shape_pieces.ts";
import type { Store } from "./store.ts";
import type { Vec3 } from "./types.ts";
import type { Shape } from "./view/overlays.ts";
import type { TrajectoryStatus } from "./rpc_types.ts";

const OVERLAY = "shape";
const SHAPES = [["square", "Square"], ["circle", "Circle"], ["path", "Points on the view"], ["loaded", "Loaded trajectory"]] as const;
type Kind = (typeof SHAPES)[number][0];

const MOST_LAPS = 20;
/** Of the default limits of control.trajectory. */
const MOST_SPEED_MPS = 5;
const DRAWN_EACH_PIECE = 8;
const NO_POINTS: readonly Vec3[] = [];

export function ShapeOrder(props: ButtonsProps) {
  const [shown, setShown] = useState(false);
  return (
    <details class="shapes" onToggle={(event) => setShown(event.currentTarget.open)}>
      <summary>Square, circle, trajectory</summary>
      {shown && <ShapeForm {...props} />}
    </details>
  );
}

function ShapeForm(props: ButtonsProps) {
  const { store, connection, view, targets, enabled } = props;
  const who = useTargetsText(props);
  const [kind, setKind] = useState<Kind>("square");
  const [size, setSize] = useState<number | null>(10);
  const [speed, setSpeed] = useState<number | null>(2);
  const [laps, setLaps] = useState<number | null>(1);
  const [points, setPoints] = useFramed(store, NO_POINTS);
  const loaded = usePolled(store, connection, kind === "loaded" && targets.length > 0 ? "trajectory.status" : null, { targets }, 2_000);
  const found = (loaded.answer?.trajectories ?? []).filter(({ vehicle }) => targets.includes(vehicle));
  useTick(1_000); // the preview begins where they are now
  const made = useMemo(
    () => (kind === "loaded" || size === null || speed === null || laps === null ? null : makerOf(kind, { size, speed, laps, points })),
    [kind, size, speed, laps, points],
  );
  // to a decimetre: the preview does not tremble with the vehicles
  const flies = useStore(store, (state) => targets.some((name) => isOnTrajectory(state.vehicles.get(name))));
  const begin = JSON.stringify((flies ? [] : startsOf(store, targets)).map(([name, place]) => [name, place.map(toDecimetre)]));
  const drafts = useMemo(() => draftsOf(JSON.parse(begin) as [string, Vec3][], made), [begin, made]);
  useOverlay(view, OVERLAY, useMemo(() => (drafts.length === 0 ? null : { shapes: drafts.map(([name, pieces]) => draftShape(name, pieces)) }), [drafts]));
  const pick = (): void => view.setTool({
    cursor: "crosshair",
    hint: "Click the points in turn. Each vehicle flies them from where it is, at its height.",
    click: ({ x, y }) => setPoints((before) => [...before, [toDecimetre(x), toDecimetre(y), 0]]),
  });
  const what = { square: "the square", circle: "the circle", path: "these points", loaded: "what is loaded" }[kind];
  const known = useFrameKnown(store);
  const ready = known && (kind === "loaded" ? targets.length > 0 && found.length === targets.length : drafts.length > 0 && drafts.length === targets.length);
  const { begun, begin: fly } = useChain(targets, (chain) => flyShape(props, kind, made, chain));
  return (
    <>
      <div class="row">
        <Choice label="Shape" value={kind} options={SHAPES} onValue={setKind} />
        {kind === "path" && <button type="button" disabled={!enabled} onClick={pick}>Click points</button>}
        {kind === "path" && points.length > 0 && <button type="button" onClick={() => setPoints(NO_POINTS)}>Clear {points.length}</button>}
      </div>
      {kind !== "loaded" && (
        <div class="fields">
          {kind !== "path" && <NumberField label={kind === "square" ? "Side, m" : "Radius, m"} value={size} least={0.5} most={1000} onValue={setSize} />}
          <NumberField label="Speed, m/s" value={speed} least={0.1} most={MOST_SPEED_MPS} onValue={setSpeed} />
          {kind !== "path" && <NumberField label="Laps" value={laps} least={1} most={MOST_LAPS} step={1} onValue={setLaps} />}
        </div>
      )}
      <p class="muted small" role="status">{noteOf(kind, drafts[0]?.[1], found.map(({ vehicle, name }) => `${vehicle}: ${name}`), targets.length, flies)}</p>
      {kind === "loaded" && found.length > 0 && (
        <HoldButton targets={targets} class="order wide" disabled={!enabled || !known} what={`Send ${who} to where their trajectories begin`} act={() => void toStarts(props, found)}>
          <span>To their first points</span>
        </HoldButton>
      )}
      <HoldButton targets={targets} class="order wide" disabled={!enabled || !ready} what={`Have ${who} fly ${what}, by setpoints`} act={() => fly()}>
        <span>Fly it</span>
      </HoldButton>
      {begun && <p class="muted small" role="status">The orders are under way. Another hold begins anew; any other order ends them.</p>}
      <OnTheWay {...props} />
    </>
  );
}

/** Begins a chain of orders for the targets, and shows whether it is under way for them. */
function useChain(targets: readonly string[], run: (chain: OrderChain) => Promise<void>): { begun: boolean; begin: () => void } {
  const [chain, setChain] = useState<OrderChain | null>(null);
  const begin = async (): Promise<void> => {
    const mine = new OrderChain(targets);
    setChain(mine);
    await run(mine);
    mine.end();
    setChain((now) => (now === mine ? null : now));
  };
  return { begun: chain?.goesOn === true && chain.targets.join("\n") === targets.join("\n"), begin: () => void begin() };
}

/** What is flown can be stopped at once; going on is held down. */
function OnTheWay(props: ButtonsProps) {
  const { store, targets, send } = props;
  const who = useTargetsText(props);
  const flown = useStore(store, (state) => targets.some((name) => isOnTrajectory(state.vehicles.get(name))));
  const paused = useStore(store, (state) => targets.some((name) => isPaused(state.vehicles.get(name))));
  const goesOn = useStore(store, (state) => targets.some((name) => canPause(state.vehicles.get(name))));
  if (!flown) return null;
  return (
    <div class="row">
      <button type="button" disabled={!goesOn} onClick={() => void send({ label: "Pause on the path", method: "trajectory.pause", params: {} })}>Pause</button>
      <HoldButton targets={targets} disabled={!paused} what={`Let ${who} go on`} act={() => void send({ label: "Go on", method: "trajectory.resume", params: {} })}>Resume</HoldButton>
      <button type="button" onClick={() => void send({ label: "Stop on the path", method: "trajectory.abort", params: {} })}>Stop there</button>
    </div>
  );
}

/** Engages setpoints, loads what each is to fly from where it is kept then, and starts all of them. Ends at what fails. */
async function flyShape({ store, connection, targets, send }: ButtonsProps, kind: Kind, made: Maker | null, chain: OrderChain): Promise<void> {
  if (!frameIsKnown(store.state)) return;
  const frame = frameKeyOf(store.state);
  if (!(await engage(store, connection, targets, chain))) return;
  if (made !== null) {
    const starts = startsOf(store, targets);
    const first = starts[0]?.[1];
    if (first === undefined || starts.length !== targets.length) return;
    for (const [name, start] of starts) {
      if (frameKeyOf(store.state) !== frame) return; // its places are others now
      const request = { label: `Load a ${kind}`, method: "trajectory.load" as const, params: { target: name, pieces: made(start, first), name: kind }, targets: [name], chain };
      const answer = await runOrder(store, connection, request);
      if (answer?.outcomes[name]?.ok !== true) return;
    }
  }
  await send({ label: `Fly the ${kind === "loaded" ? "trajectory" : kind}`, method: "trajectory.start", params: {}, chain });
}

async function toStarts({ store, connection }: ButtonsProps, found: TrajectoryStatus["trajectories"]): Promise<void> {
  if (!frameIsKnown(store.state)) return;
  const frame = frameKeyOf(store.state);
  const chain = new OrderChain(found.map(({ vehicle }) => vehicle));
  for (const { vehicle, start_enu_m } of found) {
    if (frameKeyOf(store.state) !== frame) break;
    const request = { label: "Go to the first point", method: "vehicles.goto" as const, params: { targets: [vehicle], enu_m: start_enu_m }, targets: [vehicle], chain };
    await runOrder(store, connection, request);
  }
  chain.end();
}

/** Where each begins: where its setpoints keep it, else where it is. Those without a place are left out. */
function startsOf(store: Store, targets: readonly string[]): [string, Vec3][] {
  return targets.flatMap((name): [string, Vec3][] => {
    const vehicle = store.state.vehicles.get(name);
    const place = keptPlace(vehicle) ?? vehicle?.position?.enu_m ?? null;
    return place === null ? [] : [[name, place]];
  });
}

/** Makes a vehicle's pieces from where it begins, and where the first one of all does. */
type Maker = (start: Vec3, first: Vec3) => Piece[];

function makerOf(kind: Kind, { size, speed, laps, points }: { size: number; speed: number; laps: number; points: readonly Vec3[] }): Maker {
  if (kind === "circle") return (start) => circlePieces(start, size, speed, Math.round(laps));
  if (kind === "square") return (start) => pathPieces(squarePoints(start, size, Math.round(laps)), speed);
  return (start, first) => pathPieces([start, ...points.map((point) => moved(point, start, first))], speed);
}

function draftsOf(starts: readonly [string, Vec3][], made: Maker | null): [string, Piece[]][] {
  const first = starts[0]?.[1];
  if (made === null || first === undefined) return [];
  return starts.map(([name, start]): [string, Piece[]] => [name, made(start, first)]).filter(([, pieces]) => pieces.length > 0);
}

/** The points are the first vehicle's; the others keep their places beside it, and their heights. */
function moved([x, y]: Vec3, start: Vec3, first: Vec3): Vec3 {
  return [x + start[0] - first[0], y + start[1] - first[1], start[2]];
}

function draftShape(vehicle: string, pieces: readonly Piece[]): Shape {
  return { kind: "path", points: pointsAlong(pieces, DRAWN_EACH_PIECE), ink: "draft", dashed: true, widthPx: 1.5, vehicle };
}

function noteOf(kind: Kind, pieces: readonly Piece[] | undefined, loaded: readonly string[], count: number, flies: boolean): string {
  if (count === 0) return "Select vehicles.";
  if (kind === "loaded") return loaded.length === 0 ? "None is loaded: skygcs-cli trajectory load, or a program." : loaded.join(", ");
  if (pieces === undefined && flies) return "They fly a trajectory.";
  if (pieces === undefined) return kind === "path" ? "Click points on the view." : "Their places in the fleet's frame are not known.";
  const text = `${Math.round(durationOf(pieces))} s from where each is, at its height`;
  if (kind === "path") return text;
  return kind === "square" ? `${text}: along +x first, counter-clockwise, and back` : `${text}, on its +x side: counter-clockwise, and back`;
}
