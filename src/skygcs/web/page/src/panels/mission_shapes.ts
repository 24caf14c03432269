// The answer of web.mission.check and web.fence.check, and how it is drawn.

import type { Vec3 } from "../types.ts";
import type { SeveralPaths } from "./mission_several.tsx";
import type { Ink, Shape } from "../view/overlays.ts";

export interface CheckedItem {
  number: number;
  command: number;
  name: string;
  moves: boolean;
  params: readonly (number | null)[];
  xy_m: readonly [number, number] | null;
  height_m: number | null;
  height_above: string | null;
}

export interface Finding {
  severity: "error" | "warning";
  list: string;
  item: number | null;
  text: string;
}

export interface CheckedMission {
  name: string;
  ok: boolean;
  format: string;
  holds: readonly ("mission" | "fence" | "rally")[];
  counts: Readonly<Record<"mission" | "fence" | "rally", number>>;
  home: { xy_m: readonly [number, number] | null } | null;
  mission: readonly CheckedItem[];
  rally: readonly CheckedItem[];
  fence: {
    polygons: readonly { inclusion: boolean; corners: number; xy_m: readonly (readonly [number, number])[] | null }[];
    circles: readonly { inclusion: boolean; center_xy_m: readonly [number, number] | null; radius_m: number }[];
  };
  notes: readonly string[];
  changes: readonly string[];
  findings: readonly Finding[];
  errors: number;
  warnings: number;
  /** The paths of several vehicles, if they were asked for. */
  several?: SeveralPaths | null;
  /** Of a drawing: the .plan to upload. */
  text: string | null;
}

/** Numbers beside waypoints, up to so many: more cannot be read. */
const NUMBERED = 60;

/** Mission, fence and rally points as shapes. `current`: the item that is flown now. */
export function missionShapes(checked: CheckedMission, current: number | null): Shape[] {
  const shapes: Shape[] = [];
  for (const polygon of checked.fence.polygons) {
    if (polygon.xy_m === null) continue;
    const points = polygon.xy_m.map(([x, y]): Vec3 => [x, y, 0]);
    shapes.push({ kind: "path", points, ink: fenceInk(polygon.inclusion), closed: true, filled: !polygon.inclusion, dashed: !polygon.inclusion });
  }
  for (const circle of checked.fence.circles) {
    if (circle.center_xy_m === null) continue;
    const centre: Vec3 = [circle.center_xy_m[0], circle.center_xy_m[1], 0];
    shapes.push({ kind: "circle", centre, radiusM: circle.radius_m, ink: fenceInk(circle.inclusion), filled: !circle.inclusion, dashed: !circle.inclusion });
  }
  const flown = checked.mission.filter((item) => item.xy_m !== null && item.moves);
  if (flown.length > 1) shapes.push({ kind: "path", points: flown.map(placeOf), ink: "plan" });
  flown.forEach((item) => {
    const text = flown.length <= NUMBERED ? String(item.number) : undefined;
    shapes.push({ kind: "mark", at: placeOf(item), symbol: "waypoint", ink: "plan", emphasised: item.number === current, ...(text === undefined ? {} : { text }) });
  });
  for (const item of checked.rally.slice(0, NUMBERED)) {
    if (item.xy_m !== null) shapes.push({ kind: "mark", at: placeOf(item), symbol: "goal", ink: "goal", text: `R${item.number}` });
  }
  const home = checked.home?.xy_m ?? null;
  if (home !== null) shapes.push({ kind: "mark", at: [home[0], home[1], 0], symbol: "home", ink: "muted" });
  return shapes;
}

function fenceInk(inclusion: boolean): Ink {
  return inclusion ? "fence" : "danger";
}

function placeOf(item: CheckedItem): Vec3 {
  return [item.xy_m?.[0] ?? 0, item.xy_m?.[1] ?? 0, item.height_m ?? 0];
}

/** "3 mission items, a fence of 5 points": what a file holds. */
export function countsText(checked: CheckedMission): string {
  const words: string[] = [];
  if (checked.counts.mission > 0) words.push(`${checked.counts.mission} mission item${checked.counts.mission === 1 ? "" : "s"}`);
  const { polygons, circles } = checked.fence;
  if (polygons.length > 0) words.push(`${polygons.length} fence polygon${polygons.length === 1 ? "" : "s"}`);
  if (circles.length > 0) words.push(`${circles.length} fence circle${circles.length === 1 ? "" : "s"}`);
  if (checked.counts.rally > 0) words.push(`${checked.counts.rally} rally point${checked.counts.rally === 1 ? "" : "s"}`);
  return words.length === 0 ? "nothing" : words.join(", ");
}

/** "waypoint", "return to launch": the command without its prefixes. */
export function commandText(name: string): string {
  return name.replace(/^MAV_CMD_(NAV_|DO_|CONDITION_)?/, "").replaceAll("_", " ").toLowerCase();
}

/** The length of the way through the items, in metres. */
export function lengthOf(checked: CheckedMission): number {
  const flown = checked.mission.filter((item) => item.xy_m !== null && item.moves).map(placeOf);
  return flown.slice(1).reduce((sum, point, i) => {
    const before = flown[i] ?? point;
    return sum + Math.hypot(point[0] - before[0], point[1] - before[1], point[2] - before[2]);
  }, 0);
}
