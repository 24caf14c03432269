// A plan as it is drawn: paths, starts and goals, where it comes closest, and the vehicles at one time.

import type { Vec3 } from "../types.ts";
import type { Shape } from "../view/overlays.ts";
import type { PlanPaths, PlanTimeline } from "./plan_timeline.ts";

/** Two vehicles where their clearance is least. */
export interface Approach {
  vehicles: readonly [string, string];
  distance_m: number;
  margin_m: number;
  terms: Readonly<Record<string, Readonly<Record<string, number>>>>;
  places_m: readonly [Vec3, Vec3];
  t_s: number | null;
  phase: string | null;
}

export interface Certificate {
  certified: boolean;
  kind: string;
  vehicles: number;
  downwash_ratio: number;
  duration_s: number | null;
  closest: Approach | null;
  too_close: readonly Approach[];
  reasons: readonly string[];
}

/** The answer of web.plan.check. */
export interface CheckedPlan {
  name: string;
  ok: boolean;
  format: string;
  kind: string | null;
  certificate: Certificate | null;
  reasons: readonly string[];
  attempts: readonly string[];
  goals: Readonly<Record<string, Vec3>>;
  paths: PlanPaths | null;
  space?: { fence: readonly (readonly [number, number])[]; boxes: readonly (readonly [Vec3, Vec3])[]; standing: Readonly<Record<string, Vec3>> };
  text: string | null;
}

/** Points of all paths in a picture. */
const MOST_POINTS = 20_000;
/** Named vehicles in a picture: more names hide the paths. */
const NAMED = 40;

/** What does not change with time. */
export function planShapes(checked: CheckedPlan, timeline: PlanTimeline | null): Shape[] {
  const shapes: Shape[] = [];
  const { space, certificate } = checked;
  if (space !== undefined && space.fence.length > 2) {
    shapes.push({ kind: "path", points: space.fence.map(([x, y]): Vec3 => [x, y, 0]), ink: "fence", closed: true });
  }
  for (const [[x, y, z], [tox, toy]] of space?.boxes ?? []) {
    shapes.push({ kind: "path", points: [[x, y, z], [tox, y, z], [tox, toy, z], [x, toy, z]], ink: "danger", closed: true, filled: true });
  }
  for (const at of Object.values(space?.standing ?? {})) shapes.push({ kind: "mark", at, symbol: "cross", ink: "muted" });
  if (timeline !== null) {
    const each = Math.max(2, Math.floor(MOST_POINTS / Math.max(1, timeline.paths.size)));
    for (const [vehicle, path] of timeline.paths) {
      shapes.push({ kind: "path", points: path.points(Math.min(each, 400)), ink: "plan", vehicle });
      shapes.push({ kind: "mark", at: path.at(0), symbol: "start", ink: "plan", vehicle });
    }
  }
  const named = Object.keys(checked.goals).length <= NAMED;
  for (const [name, at] of Object.entries(checked.goals)) {
    shapes.push({ kind: "mark", at, symbol: "goal", ink: "goal", ...(named ? { text: name } : {}) });
  }
  const close = certificate?.certified === true ? [certificate.closest] : (certificate?.too_close ?? []);
  for (const approach of close.slice(0, 10)) {
    if (approach === null) continue;
    const ink = certificate?.certified === true ? "warning" : "danger";
    shapes.push({ kind: "path", points: approach.places_m, ink, widthPx: 2 });
    for (const at of approach.places_m) shapes.push({ kind: "mark", at, symbol: "cross", ink });
  }
  return shapes;
}

/** The vehicles at one time of the plan. */
export function ghostShapes(timeline: PlanTimeline, t_s: number): Shape[] {
  const named = timeline.paths.size <= NAMED;
  return [...timeline.at(t_s)].map(([name, at]): Shape => ({ kind: "mark", at, symbol: "ghost", ink: "plan", vehicle: name, ...(named ? { text: name } : {}) }));
}

/** The terms of the margin as rows: name, of the one, of the other; the last is the sum. */
export function termRows(approach: Approach): (readonly [string, number, number])[] {
  const [one, other] = approach.vehicles.map((name) => approach.terms[name] ?? {});
  const names = [...new Set([...Object.keys(one ?? {}), ...Object.keys(other ?? {})])];
  const rows = names.map((name) => [name, one?.[name] ?? 0, other?.[name] ?? 0] as const);
  const sum = (column: 1 | 2): number => rows.reduce((total, row) => total + row[column], 0);
  return [...rows, ["sum", sum(1), sum(2)]];
}

export function approachText(approach: Approach): string {
  const when = approach.t_s !== null ? `at ${approach.t_s.toFixed(1)} s` : `in phase ${approach.phase ?? "?"}`;
  return `${approach.vehicles.join(" and ")} come within ${approach.distance_m.toFixed(2)} m ${when}; margin ${approach.margin_m.toFixed(2)} m`;
}
