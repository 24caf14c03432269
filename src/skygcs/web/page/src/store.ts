// What the page knows: one immutable state, changed by pure reducers only. Ages are worked out when they are shown.

import type { ClockSample, Phase } from "./connection.ts";
import { toggled } from "./format.ts";
import { frameKey } from "./framed.ts";
import { briefVehicle, siteOf, vehicleOf } from "./levels.ts";
import { stateOf } from "./outcomes.ts";
import type { Alarm, DaemonLink, FleetEvent, Hello, Origin, Outcome, PlanStatus, SiteCounts, StateBatch, Vec3, VehicleState } from "./types.ts";
import { Trails } from "./trails.ts";

/** A vehicle of which nothing came for so long is shown as not heard, whatever was last said of it. */
export const SILENT_S = 5;
export const MAX_EVENTS = 500;
export const MAX_ORDERS = 40;
/** A vehicle that is so near to where it was sent is there. */
const REACHED_M = 1.5;

/** A vehicle's newest state and the server's time that its ages refer to. */
export interface Vehicle extends VehicleState {
  heard_s: number;
  /** Only this much is sent of it now: what is null is not asked for. */
  brief?: boolean;
}

export type OrderState = "pending" | "done" | "failed" | "unknown";

/** An order that this page sent. */
export interface OrderRun {
  id: number;
  /** As a person reads it: "Take off to 10 m". */
  label: string;
  method: string;
  targets: readonly string[];
  startedMs: number;
  endedMs: number | null;
  state: OrderState;
  outcomes: Readonly<Record<string, Outcome>>;
  /** Why there are no outcomes, in the words of what refused it. */
  error: string | null;
  /** A person has seen it. */
  dismissed?: boolean;
}

/** Events with a number of their own, by which a list can know them. */
export interface NumberedEvent extends FleetEvent {
  id: number;
}

export interface State {
  phase: Phase;
  hello: Hello | null;
  daemon: DaemonLink | null;
  origin: Origin | null;
  /** The count of the origin's changes that `origin` is from; null: it has to be asked for. */
  originGeneration: number | null;
  /** The daemon's plan; null: not known. */
  plan: PlanStatus | null;
  clock: ClockSample | null;
  vehicles: ReadonlyMap<string, Vehicle>;
  /** Names by site and system id. */
  names: readonly string[];
  /** Sites of these vehicles; "" is the station's own. */
  sites: readonly string[];
  /** Of a large fleet: what the server counted of each site. */
  counts: readonly SiteCounts[] | null;
  leftOut: number;
  /** Sites whose vehicles the table shows. */
  unfolded: ReadonlySet<string>;
  /** The table's filter. */
  search: string;
  selection: ReadonlySet<string>;
  /** The one whose panel is shown: the one selected last. */
  shown: string | null;
  events: readonly NumberedEvent[];
  eventsSeen: number;
  /** Those of the daemon, open ones first. */
  alarms: readonly Alarm[];
  orders: readonly OrderRun[];
  /** Where this page sent vehicles, until they are there or get another order. */
  goals: ReadonlyMap<string, Vec3>;
  /** Rises when everything is shown anew: after a connection, a gap, a jump in a recording. */
  generation: number;
}

export const EMPTY: State = {
  phase: { kind: "connecting" },
  hello: null,
  daemon: null,
  origin: null,
  originGeneration: null,
  plan: null,
  clock: null,
  vehicles: new Map(),
  names: [],
  sites: [],
  counts: null,
  leftOut: 0,
  unfolded: new Set(),
  search: "",
  selection: new Set(),
  shown: null,
  events: [],
  eventsSeen: 0,
  alarms: [],
  orders: [],
  goals: new Map(),
  generation: 0,
};

export type Action =
  | { type: "phase"; phase: Phase }
  | { type: "hello"; hello: Hello; atMs: number }
  | { type: "slept"; ms: number }
  | { type: "daemon"; daemon: DaemonLink }
  | { type: "origin"; origin: Origin | null; generation: number }
  | { type: "originChanged" }
  | { type: "plan"; plan: PlanStatus }
  | { type: "batch"; batch: StateBatch; atMs: number }
  | { type: "select"; names: readonly string[]; how: "only" | "add" | "toggle" }
  | { type: "search"; search: string }
  | { type: "unfold"; site: string }
  | { type: "event"; event: FleetEvent }
  | { type: "recentEvents"; events: readonly FleetEvent[]; askedAfter: number }
  | { type: "alarms"; alarms: readonly Alarm[] }
  | { type: "goals"; goals: ReadonlyMap<string, Vec3> }
  | { type: "orderBegun"; order: OrderRun }
  | { type: "orderEnded"; id: number; atMs: number; state: OrderState; outcomes: Readonly<Record<string, Outcome>>; error: string | null }
  | { type: "orderReported"; id: number; vehicles: readonly string[]; outcomes: Readonly<Record<string, Outcome>> }
  | { type: "outcomesFound"; id: number; atMs: number; outcomes: Readonly<Record<string, Outcome>> }
  | { type: "orderDismissed"; id: number };

export function reduce(state: State, action: Action): State {
  switch (action.type) {
    case "phase": return { ...state, phase: action.phase };
    case "hello":
      return {
        ...state,
        hello: action.hello,
        daemon: action.hello.daemon,
        originGeneration: null,
        plan: null,
        clock: { now_s: action.hello.now_s, atMs: action.atMs },
      };
    case "slept": // the page's clock stood still meanwhile, and the vehicles did not
      return state.clock === null ? state : { ...state, clock: { ...state.clock, atMs: state.clock.atMs - action.ms } };
    case "daemon": // what a daemon said of its plan is not true of the next one, which counts its origins anew
      return {
        ...state,
        daemon: action.daemon,
        originGeneration: action.daemon.connected && state.daemon?.connected !== true ? null : state.originGeneration,
        plan: action.daemon.connected ? state.plan : null,
      };
    case "origin": // goals are in metres from the one before
      return {
        ...state,
        origin: action.origin,
        originGeneration: action.generation,
        goals: frameKey(state.origin) === frameKey(action.origin) ? state.goals : new Map(),
      };
    case "originChanged": return { ...state, originGeneration: null };
    case "plan": return { ...state, plan: action.plan };
    case "batch": return applyBatch(state, action.batch, action.atMs);
    case "select": return select(state, action.names, action.how);
    case "search": return { ...state, search: action.search };
    case "unfold": return { ...state, unfolded: toggled(state.unfolded, action.site) };
    case "event": return addEvents(state, [action.event]);
    case "recentEvents": return addEvents({ ...state, events: [] }, [...action.events, ...cameMeanwhile(state, action)]);
    case "alarms": return { ...state, alarms: action.alarms };
    case "goals": return { ...state, goals: new Map([...state.goals, ...action.goals]) };
    case "orderBegun":
      return {
        ...state,
        orders: [action.order, ...state.orders].slice(0, MAX_ORDERS),
        goals: without(state.goals, (name) => action.order.targets.includes(name)),
      };
    case "orderEnded": return withOrder(state, action.id, (order) => endOrder(order, action));
    case "orderReported": return withOrder(state, action.id, (order) => withReport(order, action));
    case "outcomesFound": return withOrder(state, action.id, (order) => withOutcomes(order, action));
    case "orderDismissed": return withOrder(state, action.id, (order) => ({ ...order, dismissed: true }));
  }
}

function applyBatch(state: State, batch: StateBatch, atMs: number): State {
  const vehicles = new Map(batch.full ? [] : state.vehicles);
  for (const name of batch.gone) vehicles.delete(name);
  for (const vehicle of batch.vehicles) vehicles.set(vehicle.name, vehicleOf(vehicle, batch.heard_s));
  for (const row of batch.brief ?? []) vehicles.set(row[0], briefVehicle(row));
  const same = !batch.full && vehicles.size === state.names.length && [...vehicles.keys()].every((name) => state.vehicles.has(name));
  const names = same && batch.gone.length === 0 ? state.names : namesBySysid(vehicles);
  const selection = names === state.names ? state.selection : keepKnown(state.selection, vehicles);
  return {
    ...state,
    vehicles,
    names,
    sites: names === state.names ? state.sites : [...new Set(names.map(siteOf))],
    counts: batch.sites ?? (batch.full || batch.brief === undefined ? null : state.counts),
    leftOut: batch.left_out ?? 0,
    selection,
    goals: without(state.goals, (name, goal) => isOver(vehicles.get(name), goal)),
    shown: state.shown !== null && vehicles.has(state.shown) ? state.shown : lastOf(selection),
    clock: { now_s: batch.now_s, atMs },
    generation: batch.full ? state.generation + 1 : state.generation,
  };
}

/** The goal is reached, or the vehicle is gone. */
function isOver(vehicle: Vehicle | undefined, goal: Vec3): boolean {
  const place = vehicle?.position?.enu_m;
  return vehicle === undefined || (place != null && Math.hypot(place[0] - goal[0], place[1] - goal[1]) < REACHED_M);
}

function without(goals: ReadonlyMap<string, Vec3>, gone: (name: string, goal: Vec3) => boolean): ReadonlyMap<string, Vec3> {
  const kept = [...goals].filter(([name, goal]) => !gone(name, goal));
  return kept.length === goals.size ? goals : new Map(kept);
}

function namesBySysid(vehicles: ReadonlyMap<string, Vehicle>): readonly string[] {
  return [...vehicles.values()]
    .sort((a, b) => siteOf(a.name).localeCompare(siteOf(b.name)) || a.sysid - b.sysid || a.compid - b.compid || a.name.localeCompare(b.name))
    .map((vehicle) => vehicle.name);
}

function keepKnown(selection: ReadonlySet<string>, vehicles: ReadonlyMap<string, Vehicle>): ReadonlySet<string> {
  const kept = [...selection].filter((name) => vehicles.has(name));
  return kept.length === selection.size ? selection : new Set(kept);
}

function lastOf(selection: ReadonlySet<string>): string | null {
  return [...selection].at(-1) ?? null;
}

function select(state: State, names: readonly string[], how: "only" | "add" | "toggle"): State {
  const wanted = names.filter((name) => state.vehicles.has(name));
  const selection = new Set(how === "only" ? [] : state.selection);
  for (const name of wanted) {
    if (how === "toggle" && selection.has(name)) selection.delete(name);
    else selection.add(name);
  }
  const newest = wanted.filter((name) => selection.has(name)).at(-1);
  return { ...state, selection, shown: newest ?? lastOf(selection) };
}

/** Events that came while the recent ones were asked for (``askedAfter``: `eventsSeen` then), and later than the answer. */
function cameMeanwhile(state: State, { events, askedAfter }: Extract<Action, { type: "recentEvents" }>): readonly FleetEvent[] {
  const newest_s = Math.max(...events.map((event) => event.time_unix_s));
  return state.events.filter((event) => event.id > askedAfter && event.time_unix_s > newest_s);
}

function addEvents(state: State, events: readonly FleetEvent[]): State {
  const numbered = events.map((event, index) => ({ ...event, id: state.eventsSeen + index + 1 }));
  return { ...state, events: [...state.events, ...numbered].slice(-MAX_EVENTS), eventsSeen: state.eventsSeen + events.length };
}

function withOrder(state: State, id: number, change: (order: OrderRun) => OrderRun): State {
  return { ...state, orders: state.orders.map((order) => (order.id === id ? change(order) : order)) };
}

function endOrder(order: OrderRun, end: Extract<Action, { type: "orderEnded" }>): OrderRun {
  // what was reported before a connection was lost stays true
  return { ...order, state: end.state, outcomes: { ...order.outcomes, ...end.outcomes }, error: end.error, endedMs: end.atMs };
}

/** What has come of an order that is under way; an order that has ended has all of it. */
function withReport(order: OrderRun, report: Extract<Action, { type: "orderReported" }>): OrderRun {
  if (order.endedMs !== null) return order;
  const targets = [...order.targets, ...report.vehicles.filter((name) => !order.targets.includes(name))];
  return { ...order, targets, outcomes: { ...order.outcomes, ...report.outcomes } };
}

function withOutcomes(order: OrderRun, found: Extract<Action, { type: "outcomesFound" }>): OrderRun {
  const outcomes = { ...order.outcomes, ...found.outcomes };
  return { ...order, outcomes, state: stateOf(outcomes), endedMs: found.atMs };
}

/** The server's clock at a moment of the page's own; 0 before it was heard. */
export function serverNowS(state: Pick<State, "clock">, nowMs: number): number {
  return state.clock === null ? 0 : state.clock.now_s + (nowMs - state.clock.atMs) / 1000;
}

/** How old a part of a vehicle's state is now. */
export function ageOf(vehicle: Pick<Vehicle, "heard_s">, part: { age_s: number } | null, now_s: number): number | null {
  return part === null ? null : part.age_s + Math.max(now_s - vehicle.heard_s, 0);
}

/** Seconds since anything was heard of a vehicle; null: never. */
export function silenceOf(vehicle: Vehicle, now_s: number): number | null {
  const ages = Object.values(vehicle.links).map((link) => link.age_s);
  if (vehicle.last_heartbeat_age_s !== null) ages.push(vehicle.last_heartbeat_age_s);
  return ages.length === 0 ? null : Math.min(...ages) + Math.max(now_s - vehicle.heard_s, 0);
}

/** Whether a vehicle's values are of now. A frozen good value is never shown as one. */
export function isHeard(vehicle: Vehicle, now_s: number): boolean {
  return isHeardAfter(vehicle, silenceOf(vehicle, now_s));
}

/** The same where its silence is known already: the view asks for each vehicle in each frame. */
export function isHeardAfter({ connected }: Pick<Vehicle, "connected">, silence: number | null): boolean {
  return connected && silence !== null && silence < SILENT_S;
}

/** ``inFrame``: it is called in a frame of the screen, and may draw; otherwise in the handler of a key or a click. */
export type Listener = (state: State, inFrame: boolean) => void;

/** Holds the state. Listeners are called once for each animation frame in which it changed, and at once when the selection
 * does: the next key or click must find the orders drawn for it. `onAction` at once. */
export class Store {
  state: State = EMPTY;
  readonly trails = new Trails();
  /** Vehicles that the fleet view draws in detail, if they are few. */
  near: readonly string[] = [];
  private readonly listeners = new Set<Listener>();
  private readonly actionListeners = new Set<(action: Action, state: State) => void>();
  private scheduled = false;

  constructor(private readonly schedule: (run: () => void) => void = (run) => void requestAnimationFrame(run)) {}

  dispatch(action: Action): void {
    this.state = reduce(this.state, action);
    if (action.type === "batch") this.trails.take(action.batch);
    for (const listener of this.actionListeners) listener(action, this.state);
    if (action.type === "select") {
      this.notify(false);
      return;
    }
    if (this.scheduled) return;
    this.scheduled = true;
    this.schedule(() => {
      this.scheduled = false;
      this.notify(true);
    });
  }

  private notify(inFrame: boolean): void {
    for (const listener of this.listeners) listener(this.state, inFrame);
  }

  subscribe(listener: Listener): () => void {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

  /** Each action, at once: sounds, and what may miss none. */
  onAction(listener: (action: Action, state: State) => void): () => void {
    this.actionListeners.add(listener);
    return () => this.actionListeners.delete(listener);
  }
}
