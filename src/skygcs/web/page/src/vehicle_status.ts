// One line for what a vehicle does or suffers: trouble, else the guard, the plan, our control, the mission. Pure.

import { cell, UNKNOWN, type Cell } from "./cells.ts";
import { AT_REST } from "./plan_status.ts";
import { isHeard, type State, type Vehicle } from "./store.ts";
import { isControlled, isEngaging, isFlown, isHeld } from "./setpoint_orders.ts";
import { troubleOf, troubleRank } from "./trouble.ts";

/** What is around a vehicle: its state alone does not say why it is in failsafe, or which plan flies it. */
export type Surroundings = Pick<State, "plan" | "events">;

/** What a vehicle does by itself in this mode, in a word that follows a comma. */
const DOES: readonly (readonly [RegExp, string])[] = [[/LAND/, "landing"], [/RTL/, "returning"], [/LOITER|HOLD|BRAKE/, "holding"]];

/** Missions are flown in these modes alone. */
const MISSION_MODES = new Set(["AUTO.MISSION", "AUTO"]);

/** After all ranks of trouble. */
const RANK = { held: 200, guarded: 201, plan: 202, control: 203, mission: 204, replay: 205, nothing: 206 };

interface Ranked {
  rank: number;
  cell: Cell;
}

export function statusOf(v: Vehicle, now_s: number, around: Surroundings): Cell {
  return ranked(v, now_s, around).cell;
}

/** By which vehicles are sorted: the worst first, then what they do. */
export function statusRank(v: Vehicle, now_s: number, around: Surroundings): number {
  return ranked(v, now_s, around).rank;
}

function ranked(v: Vehicle, now_s: number, around: Surroundings): Ranked {
  const trouble = troubleOf(v, now_s);
  if (trouble !== null) {
    const failsafe = v.failsafe && isHeard(v, now_s);
    return { rank: troubleRank(v, now_s), cell: failsafe ? failsafeCell(v, trouble.reasons.slice(1), around) : cell(trouble.text, trouble.severity) };
  }
  if (!isHeard(v, now_s)) return { rank: RANK.nothing, cell: UNKNOWN };
  return guarded(v) ?? flown(v, around) ?? { rank: RANK.nothing, cell: UNKNOWN };
}

/** The newest failsafe event of each vehicle, worked out once for each list of events: a whole fleet may be in failsafe. */
function failsafesOf(events: State["events"]): ReadonlyMap<string, State["events"][number]> {
  let found = failsafes.get(events);
  if (found === undefined) {
    found = new Map(events.filter(({ kind }) => kind === "failsafe").map((event) => [event.vehicle ?? "", event]));
    failsafes.set(events, found);
  }
  return found;
}

const failsafes = new WeakMap<State["events"], ReadonlyMap<string, State["events"][number]>>();

/** "FAILSAFE: GPS glitch, returning". The words are the vehicle's own. */
function failsafeCell(v: Vehicle, others: readonly string[], { events }: Surroundings): Cell {
  const words = failsafesOf(events).get(v.name)?.data["last_warning"];
  const does = DOES.find(([mode]) => mode.test(v.mode ?? ""))?.[1];
  const what = [...(typeof words === "string" && words !== "" ? [words] : []), ...(does === undefined ? [] : [does]), ...others];
  return cell(what.length === 0 ? "FAILSAFE" : `FAILSAFE: ${what.join(", ")}`, "danger", v.system_status);
}

/** What the guard says of our control, and another vehicle that is near, though not dangerously. */
function guarded(v: Vehicle): Ranked | null {
  const reasons = isControlled(v) ? (v.control?.reasons ?? []) : [];
  if (isHeld(v)) return { rank: RANK.held, cell: cell(`held${reasons.length > 0 ? `: ${reasons.join(", ")}` : ""}`, "danger", reasons.join("; ")) };
  if (v.separation !== null) return { rank: RANK.guarded, cell: cell(`near ${v.separation.with}`, "warning") };
  return reasons.length === 0 ? null : { rank: RANK.guarded, cell: cell(reasons.join(", "), "warning", reasons.join("; ")) };
}

/** By what it is flown. */
function flown(v: Vehicle, { plan }: Surroundings): Ranked | null {
  if (plan !== null && !AT_REST.has(plan.state) && plan.vehicles.some(({ vehicle, left }) => vehicle === v.name && left === null)) {
    const left = plan.clock?.finishes_in_s == null ? plan.state.replaceAll("_", " ") : `${plan.clock.finishes_in_s.toFixed(0)} s left`;
    return { rank: RANK.plan, cell: cell(`plan ${plan.name ?? ""}, ${left}`) };
  }
  if (v.control !== null && isFlown(v)) {
    const control = v.control.control_mode ?? v.control.mode ?? v.control.state;
    return { rank: RANK.control, cell: cell(control.replaceAll("_", " "), isEngaging(v) ? "" : "good") };
  }
  if (v.mission !== null && v.mission.count !== null && v.mission.count > 0 && MISSION_MODES.has(v.mode ?? "")) {
    return { rank: RANK.mission, cell: cell(`mission ${v.mission.item ?? "?"}/${v.mission.count}`) };
  }
  return v.replayed ? { rank: RANK.replay, cell: cell("replay", "muted") } : null;
}
