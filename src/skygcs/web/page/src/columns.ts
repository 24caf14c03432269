// The columns of the fleet table: what a cell says, how it is sorted, and when it warns. Pure.

import { ageText, fixed, percentText } from "./format.ts";
import { ageOf, isHeard, SILENT_S, silenceOf, type Vehicle } from "./store.ts";
import { DEAF, EMPTY_BATTERY_PERCENT, isProblem, LOW_BATTERY_PERCENT, nearTo } from "./trouble.ts";

export type Tone = "" | "muted" | "warning" | "danger" | "good";

export interface Cell {
  text: string;
  tone: Tone;
  /** On a phone: a second line. */
  under?: string;
  /** On a phone: instead of the text. */
  narrow?: string;
  /** For people who want to know more, and for screen readers. */
  title?: string;
}

export interface Column {
  id: string;
  title: string;
  /** Numbers stand on the right. */
  numeric?: boolean;
  /** Shown on a phone. */
  narrow?: boolean;
  /** Shown only while a vehicle of the fleet has it. */
  when?: (vehicle: Vehicle) => boolean;
  /** A value of the vehicle, not of the connection to it: grey when it is not heard. */
  cell: (vehicle: Vehicle, now_s: number) => Cell;
  /** What it is sorted by; null last. */
  sortBy: (vehicle: Vehicle, now_s: number) => number | string | null;
}

const HIGH_LOSS = 0.05;
/** A group of telemetry that did not come for so long is grey although the vehicle is heard. */
const OLD_GROUP_S = 4;

const UNKNOWN: Cell = { text: "–", tone: "muted" };

function cell(text: string | null, tone: Tone = "", title?: string): Cell {
  if (text === null || text === "") return UNKNOWN;
  return title === undefined ? { text, tone } : { text, tone, title };
}

/** Grey with its age if the group is old. */
function aged(vehicle: Vehicle, part: { age_s: number } | null, now_s: number, text: string | null, tone: Tone = ""): Cell {
  const age = ageOf(vehicle, part, now_s);
  if (age === null || text === null) return UNKNOWN;
  return age > OLD_GROUP_S ? cell(text, "muted", `${ageText(age)} old`) : cell(text, tone);
}

export const COLUMNS: readonly Column[] = [
  {
    id: "name",
    title: "Name",
    narrow: true,
    cell: (v) => ({ ...cell(v.name), under: v.mode ?? "" }),
    sortBy: (v) => v.name,
  },
  { id: "id", title: "Id", numeric: true, cell: (v) => cell(String(v.sysid), v.duplicate_sysid ? "danger" : "muted"), sortBy: (v) => v.sysid },
  {
    id: "autopilot",
    title: "Autopilot",
    cell: (v) => cell([autopilotName(v.autopilot), v.firmware].filter(Boolean).join(" "), "", v.type.toLowerCase()),
    sortBy: (v) => `${v.autopilot} ${v.firmware ?? ""}`,
  },
  { id: "mode", title: "Mode", cell: (v) => cell(v.mode), sortBy: (v) => v.mode },
  { id: "armed", title: "Armed", narrow: true, cell: armedCell, sortBy: (v) => (v.armed === true ? 0 : 1) },
  {
    id: "height",
    title: "Height",
    numeric: true,
    narrow: true,
    cell: (v, now) => aged(v, v.position, now, withUnit(fixed(v.position?.alt_rel_m, 1), "m")),
    sortBy: (v) => v.position?.alt_rel_m ?? null,
  },
  { id: "battery", title: "Battery", numeric: true, narrow: true, cell: batteryCell, sortBy: (v) => v.battery?.percent ?? v.battery?.volts ?? null },
  { id: "gps", title: "GPS", cell: gpsCell, sortBy: (v) => v.gps?.fix_type ?? null },
  { id: "link", title: "Link", cell: linkCell, sortBy: (v) => bestLink(v)?.name ?? null },
  { id: "age", title: "Heard", numeric: true, narrow: true, cell: heardCell, sortBy: (v, now) => silenceOf(v, now) },
  { id: "loss", title: "Loss", numeric: true, cell: lossCell, sortBy: (v) => bestLink(v)?.loss ?? null },
  {
    id: "failsafe",
    title: "Failsafe",
    cell: (v) => (v.failsafe ? cell("FAILSAFE", "danger", v.system_status) : cell("no", "muted")),
    sortBy: (v) => (v.failsafe ? 0 : 1),
  },
  { id: "guard", title: "Guard", cell: guardCell, sortBy: (v) => guardCell(v).text },
  {
    id: "control",
    title: "Control",
    cell: (v) => (v.control === null || v.control.state === "off" ? cell("autopilot", "muted") : cell(v.control.control_mode ?? v.control.mode ?? v.control.state)),
    sortBy: (v) => v.control?.control_mode ?? v.control?.mode ?? "",
  },
  { id: "plan", title: "Plan", cell: planCell, sortBy: (v) => planCell(v).text },
  { id: "companion", title: "Companion", when: (v) => v.companion != null, cell: companionCell, sortBy: (v, now) => companionCell(v, now).text },
];

export function autopilotName(family: string): string {
  return { px4: "PX4", ardupilot: "ArduPilot" }[family] ?? family;
}

function withUnit(text: string | null, unit: string): string | null {
  return text === null ? null : `${text} ${unit}`;
}

function armedCell(v: Vehicle): Cell {
  if (v.replayed) return cell("replay", "muted");
  if (v.armed === null) return UNKNOWN;
  const near = nearTo(v);
  if (near !== null) return cell(`${v.armed ? "armed, " : ""}NEAR ${near.with}`, "danger");
  if (v.uplink?.heard === false) return cell(v.armed ? `armed, ${DEAF}` : DEAF, "danger", "It answers nothing of ours");
  if (!v.armed) return cell("no", "muted");
  return cell(v.separation === null ? "armed" : `armed, near ${v.separation.with}`, v.separation === null ? "good" : "warning");
}

function batteryCell(v: Vehicle, now_s: number): Cell {
  if (v.battery === null) return UNKNOWN;
  const { percent, volts } = v.battery;
  const parts = [withUnit(fixed(percent, 0), "%"), withUnit(fixed(volts, 1), "V")].filter((part) => part !== null);
  const text = parts.join("  ");
  const tone: Tone = percent === null || percent > LOW_BATTERY_PERCENT ? "" : percent > EMPTY_BATTERY_PERCENT ? "warning" : "danger";
  const shown = aged(v, v.battery, now_s, text === "" ? null : text, tone);
  return parts.length === 2 ? { ...shown, narrow: parts[0] ?? "" } : shown;
}

function gpsCell(v: Vehicle, now_s: number): Cell {
  if (v.gps === null) return UNKNOWN;
  const text = [v.gps.fix?.toUpperCase(), v.gps.satellites === null ? null : `${v.gps.satellites} sat`].filter(Boolean).join("  ");
  return aged(v, v.gps, now_s, text, (v.gps.fix_type ?? 3) < 3 ? "warning" : "");
}

function bestLink(v: Vehicle): { name: string; loss: number | null } | null {
  const links = Object.entries(v.links);
  const [first] = links.sort(
    ([, a], [, b]) =>
      Number(b.chosen ?? 0) - Number(a.chosen ?? 0) ||
      a.age_s - b.age_s ||
      (a.loss_ratio ?? 1) - (b.loss_ratio ?? 1),
  );
  return first === undefined ? null : { name: first[0], loss: first[1].loss_ratio };
}

function linkCell(v: Vehicle): Cell {
  const best = bestLink(v);
  if (best === null) return UNKNOWN;
  const others = Object.keys(v.links).length - 1;
  return cell(others > 0 ? `${best.name} +${others}` : best.name, "", Object.keys(v.links).join(", "));
}

function lossCell(v: Vehicle): Cell {
  const loss = bestLink(v)?.loss;
  return cell(percentText(loss), loss !== null && loss !== undefined && loss > HIGH_LOSS ? "warning" : "");
}

function heardCell(v: Vehicle, now_s: number): Cell {
  const silence = silenceOf(v, now_s);
  if (silence === null) return cell("never", "warning");
  return isHeard(v, now_s) ? cell(ageText(silence), "muted") : cell(ageText(silence), "warning", "Not heard: the other values are of then");
}

function guardCell(v: Vehicle): Cell {
  if (v.control === null || v.control.state === "off") return UNKNOWN;
  const reasons = v.control.reasons ?? [];
  if (v.control.state === "held") return cell("held", "danger", reasons.join("; "));
  if (reasons.length > 0) return cell(reasons[0] ?? "", "warning", reasons.join("; "));
  return cell("clear", "good");
}

/** The computer on the vehicle: our connection to it, else whether MAVLink of it is heard. */
function companionCell(v: Vehicle, now_s: number): Cell {
  const { companion } = v;
  if (companion == null) return UNKNOWN;
  const { name, link, error, version, age_s } = companion;
  const title = [name, version, error].filter(Boolean).join(", ");
  if (link !== null) return cell(link, link === "up" ? "good" : link === "down" ? "danger" : "muted", title);
  const age = age_s === null ? null : ageOf(v, { age_s }, now_s);
  if (age === null) return cell("not heard", "warning", title);
  return age > SILENT_S ? cell(`silent ${ageText(age)}`, "warning", title) : cell("heard", "", title);
}

function planCell(v: Vehicle): Cell {
  if (v.mission === null || v.mission.count === null || v.mission.count === 0) return UNKNOWN;
  return cell(`${v.mission.seq ?? "?"} of ${v.mission.count}`);
}

export interface Sorting {
  column: string;
  down: boolean;
}

/** Names of vehicles that match a filter: each word in name, id, group, mode, autopilot or a word of its state. The
 *  server looks into the same words of a large fleet (fleet_digest.py). */
export function matches(vehicle: Vehicle, filter: string, now_s: number): boolean {
  const words = filter.toLowerCase().split(/\s+/).filter(Boolean);
  if (words.length === 0) return true;
  const state = [
    vehicle.armed === true ? "armed" : "disarmed",
    vehicle.failsafe ? "failsafe" : "",
    isHeard(vehicle, now_s) ? "heard" : "silent",
    isHeard(vehicle, now_s) && !isProblem(vehicle) ? "" : "problem",
    vehicle.landed.replace("_", " "),
  ];
  const text = [vehicle.name, vehicle.sysid, ...vehicle.groups, vehicle.mode, vehicle.autopilot, ...state].join(" ").toLowerCase();
  return words.every((word) => text.includes(word));
}

export function sorted(vehicles: readonly Vehicle[], sorting: Sorting, now_s: number): Vehicle[] {
  const column = COLUMNS.find((one) => one.id === sorting.column) ?? COLUMNS[0];
  if (column === undefined) return [...vehicles];
  const keyed = vehicles.map((vehicle, index) => ({ vehicle, key: column.sortBy(vehicle, now_s), index }));
  keyed.sort((a, b) => compare(a.key, b.key, sorting.down) || a.vehicle.sysid - b.vehicle.sysid || a.index - b.index);
  return keyed.map(({ vehicle }) => vehicle);
}

function compare(a: number | string | null, b: number | string | null, down: boolean): number {
  if (a === null || b === null) return a === b ? 0 : a === null ? 1 : -1; // what is not known is last, either way
  const order = typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true });
  return down ? -order : order;
}

export type Grouping = "none" | "site" | "group" | "autopilot" | "mode";

/** Rows of the table: vehicles, with a heading before each group. */
export type Row = { kind: "group"; title: string; names: string[] } | { kind: "vehicle"; vehicle: Vehicle };

export function rowsOf(vehicles: readonly Vehicle[], grouping: Grouping): Row[] {
  if (grouping === "none") return vehicles.map((vehicle) => ({ kind: "vehicle", vehicle }));
  const groups = new Map<string, Vehicle[]>();
  for (const vehicle of vehicles) {
    const title = groupOf(vehicle, grouping);
    const members = groups.get(title);
    if (members === undefined) groups.set(title, [vehicle]);
    else members.push(vehicle);
  }
  return [...groups]
    .sort(([a], [b]) => a.localeCompare(b, "en", { numeric: true }))
    .flatMap(([title, members]): Row[] => [
      { kind: "group", title, names: members.map((vehicle) => vehicle.name) },
      ...members.map((vehicle): Row => ({ kind: "vehicle", vehicle })),
    ]);
}

function groupOf(vehicle: Vehicle, grouping: Grouping): string {
  if (grouping === "group") return vehicle.groups[0] ?? "no group";
  return grouping === "mode" ? (vehicle.mode ?? "mode not known") : autopilotName(vehicle.autopilot);
}
