// The columns of the fleet table, what a cell says, how it is sorted and when it warns; its rows, by site too. Pure.

import { aged, cell, type Cell, type Tone, UNKNOWN, withUnit } from "./cells.ts";
import { ageText, fixed, percentText } from "./format.ts";
import { siteOf } from "./levels.ts";
import { isFlown } from "./setpoint_orders.ts";
import { ageOf, isHeard, silenceOf, SILENT_S, type State, type Vehicle } from "./store.ts";
import { EMPTY_BATTERY_PERCENT, isInAir, isLostInAir, isProblem, LOW_BATTERY_PERCENT, troubleRank } from "./trouble.ts";
import type { SiteCounts } from "./types.ts";
import { statusOf, statusRank, type Surroundings } from "./vehicle_status.ts";

export interface Column {
  id: string;
  title: string;
  /** Numbers stand on the right. */
  numeric?: boolean;
  /** Shown on a phone. */
  narrow?: boolean;
  /** Shown only while a vehicle of the fleet has it. */
  when?: (vehicle: Vehicle) => boolean;
  /** Shown only to people who choose it. */
  byChoice?: boolean;
  /** It says what is so now, not what the vehicle said last: not grey when it is not heard. */
  ofNow?: boolean;
  cell: (vehicle: Vehicle, now_s: number, around: Surroundings) => Cell;
  /** What it is sorted by; null last. */
  sortBy: (vehicle: Vehicle, now_s: number, around: Surroundings) => number | string | null;
}

const HIGH_LOSS = 0.05;
export const COLUMNS: readonly Column[] = [
  { id: "name", title: "Name", narrow: true, cell: (v) => ({ ...cell(v.name), under: v.mode ?? "" }), sortBy: (v) => v.name },
  { id: "id", title: "Id", numeric: true, cell: (v) => cell(String(v.sysid), v.duplicate_sysid ? "danger" : "muted"), sortBy: (v) => v.sysid },
  {
    id: "autopilot",
    title: "Autopilot",
    cell: (v) => cell([autopilotName(v.autopilot), v.firmware].filter(Boolean).join(" "), "", v.type.toLowerCase()),
    sortBy: (v) => `${v.autopilot} ${v.firmware ?? ""}`,
  },
  { id: "mode", title: "Mode", cell: (v) => cell(v.mode), sortBy: (v) => v.mode },
  { id: "status", title: "Status", narrow: true, ofNow: true, cell: (v, now, around) => onPhone(statusOf(v, now, around), v), sortBy: statusRank },
  { id: "armed", title: "Armed", cell: armedCell, sortBy: (v) => (v.armed === true ? 0 : 1) },
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
  { id: "age", title: "Heard", numeric: true, narrow: true, ofNow: true, cell: heardCell, sortBy: (v, now) => silenceOf(v, now) },
  { id: "loss", title: "Loss", numeric: true, cell: lossCell, sortBy: (v) => bestLink(v)?.loss ?? null },
  { id: "x", title: "x", numeric: true, byChoice: true, cell: (v, now) => placeCell(v, 0, now), sortBy: (v) => v.position?.enu_m?.[0] ?? null },
  { id: "y", title: "y", numeric: true, byChoice: true, cell: (v, now) => placeCell(v, 1, now), sortBy: (v) => v.position?.enu_m?.[1] ?? null },
  { id: "up", title: "Up", numeric: true, byChoice: true, cell: (v, now) => placeCell(v, 2, now), sortBy: (v) => v.position?.enu_m?.[2] ?? null },
  {
    id: "attitude",
    title: "Roll pitch yaw",
    numeric: true,
    byChoice: true,
    cell: (v, now) => aged(v, v.attitude, now, attitudeText(v)),
    sortBy: (v) => v.attitude?.yaw_deg ?? null,
  },
  {
    id: "speed",
    title: "Speed",
    numeric: true,
    byChoice: true,
    cell: (v, now) => aged(v, v.position, now, withUnit(fixed(speedOf(v), 1), "m/s")),
    sortBy: speedOf,
  },
  { id: "target", title: "Target", numeric: true, byChoice: true, cell: (v) => cell(targetText(v)), sortBy: targetText },
  { id: "error", title: "Error", numeric: true, byChoice: true, cell: (v) => cell(withUnit(fixed(errorOf(v), 2), "m")), sortBy: errorOf },
  { id: "companion", title: "Companion", when: (v) => v.companion != null, cell: companionCell, sortBy: (v, now) => companionCell(v, now).text },
];

/** On a phone the column of armed vehicles is a second line of this one. */
function onPhone(status: Cell, v: Vehicle): Cell {
  const armed = v.armed === null ? "" : v.armed ? "armed" : "not armed";
  return status.text === UNKNOWN.text ? { ...status, narrow: armed } : { ...status, under: armed };
}

export function autopilotName(family: string): string {
  return { px4: "PX4", ardupilot: "ArduPilot" }[family] ?? family;
}

function armedCell(v: Vehicle): Cell {
  if (v.armed === null) return UNKNOWN;
  return v.armed ? cell("armed", "good") : cell("no", "muted");
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
  const text = [v.gps.fix.toUpperCase(), v.gps.satellites === null ? null : `${v.gps.satellites} sat`].filter(Boolean).join("  ");
  return aged(v, v.gps, now_s, text, v.gps.fix_type < 3 ? "warning" : "");
}

function bestLink(v: Vehicle): { name: string; loss: number | null } | null {
  const links = Object.entries(v.links);
  const [first] = links.sort(
    ([, a], [, b]) => Number(b.chosen ?? 0) - Number(a.chosen ?? 0) || a.age_s - b.age_s || (a.loss_ratio ?? 1) - (b.loss_ratio ?? 1),
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

/** The computer on the vehicle: our connection to it, else whether MAVLink of it is heard. */
function companionCell(v: Vehicle, now_s: number): Cell {
  const { companion } = v;
  if (companion == null) return UNKNOWN;
  const { name, link, error, version, age_s } = companion;
  const title = [name, version, error].filter(Boolean).join(", ");
  if (link !== null) return cell(link, link === "up" ? "good" : link === "down" ? "danger" : "muted", title);
  const age = age_s === null ? null : ageOf(v, { age_s }, now_s);
  if (age === null) return cell("not heard", "warning", title);
  return age > SILENT_S ? cell(`not heard ${ageText(age)}`, "warning", title) : cell("heard", "", title);
}

function attitudeText(v: Vehicle): string | null {
  if (v.attitude === null) return null;
  return [v.attitude.roll_deg, v.attitude.pitch_deg, v.attitude.yaw_deg].map((angle) => `${fixed(angle, 0) ?? "?"}°`).join(" ");
}

/** Metres from the fleet's origin along one axis. */
function placeCell(v: Vehicle, axis: 0 | 1 | 2, now_s: number): Cell {
  return aged(v, v.position, now_s, withUnit(fixed(v.position?.enu_m?.[axis], 1), "m"));
}

function speedOf(v: Vehicle): number | null {
  const velocity = v.position?.vel_enu_mps;
  return velocity == null ? null : Math.hypot(...velocity);
}

/** Where skygcs' own control steers to: x, y and up; an axis that follows a velocity has none. */
function targetText(v: Vehicle): string | null {
  const target = isFlown(v) ? v.control?.reference?.pos_enu_m : null;
  return target == null ? null : target.map((axis) => fixed(axis, 1) ?? "–").join("  ");
}

function errorOf(v: Vehicle): number | null {
  return isFlown(v) ? (v.control?.error_m ?? null) : null;
}

export interface Sorting {
  column: string;
  down: boolean;
}

/** True if each word of the filter is part of a name, id, group, mode or autopilot, or begins a word of the vehicle's state:
 *  "armed" is no part of "disarmed". The server looks into the same words of a large fleet (fleet_digest.py). */
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
  const text = [vehicle.name, vehicle.sysid, ...vehicle.groups, vehicle.mode, vehicle.autopilot].join(" ").toLowerCase();
  const states = state.join(" ").split(" ");
  return words.every((word) => text.includes(word) || states.some((one) => one.startsWith(word)));
}

/** ``problemsFirst``: those in trouble stand above all others, the worst first, however the rest is sorted. */
export function sorted(vehicles: readonly Vehicle[], sorting: Sorting, now_s: number, around: Surroundings, problemsFirst = false): Vehicle[] {
  const column = COLUMNS.find((one) => one.id === sorting.column) ?? COLUMNS[0];
  if (column === undefined) return [...vehicles];
  const keyed = vehicles.map((vehicle, index) => ({
    vehicle,
    trouble: problemsFirst ? troubleRank(vehicle, now_s) : Infinity,
    key: column.sortBy(vehicle, now_s, around),
    index,
  }));
  keyed.sort((a, b) => (a.trouble === b.trouble ? 0 : a.trouble - b.trouble) || compare(a.key, b.key, sorting.down) || a.vehicle.sysid - b.vehicle.sysid || a.index - b.index);
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
  return [...groups].sort(([a], [b]) => a.localeCompare(b, "en", { numeric: true })).flatMap(([title, members]): Row[] => [
      { kind: "group", title, names: members.map((vehicle) => vehicle.name) },
      ...members.map((vehicle): Row => ({ kind: "vehicle", vehicle })),
    ]);
}

function groupOf(vehicle: Vehicle, grouping: Grouping): string {
  if (grouping === "group") return vehicle.groups[0] ?? "no group";
  return grouping === "mode" ? (vehicle.mode ?? "mode not known") : autopilotName(vehicle.autopilot);
}

export type SiteRow = { kind: "site"; counts: SiteCounts; names: string[]; unfolded: boolean };

/** ``found``: the vehicles that the filter leaves, sorted; while it filters, every site is unfolded. */
export function siteRows(state: State, found: readonly Vehicle[], now_s: number): (Row | SiteRow)[] {
  const filtered = state.search.trim() !== "";
  const members = new Map<string, Vehicle[]>(state.sites.map((site) => [site, []]));
  for (const vehicle of found) members.get(siteOf(vehicle.name))?.push(vehicle);
  return countsOf(state, now_s).flatMap((counts): (Row | SiteRow)[] => {
    const inside = members.get(counts.site) ?? [];
    if (filtered && inside.length === 0) return [];
    const unfolded = filtered || state.unfolded.has(counts.site);
    const names = filtered ? inside.map(({ name }) => name) : state.names.filter((name) => siteOf(name) === counts.site);
    const rows = unfolded ? inside.map((vehicle): Row => ({ kind: "vehicle", vehicle })) : [];
    return [{ kind: "site", counts, names, unfolded }, ...rows];
  });
}

/** Those that the server sent of a large fleet, otherwise counted here. */
function countsOf(state: State, now_s: number): readonly SiteCounts[] {
  if (state.counts !== null) return state.counts;
  const all = [...state.vehicles.values()];
  return state.sites.map((site) => {
    const here = all.filter(({ name }) => siteOf(name) === site);
    const heard = here.filter((vehicle) => isHeard(vehicle, now_s));
    const counted = here.filter((vehicle) => isHeard(vehicle, now_s) || isLostInAir(vehicle, now_s));
    return {
      site,
      vehicles: here.length,
      heard: heard.length,
      armed: counted.filter(({ armed }) => armed === true).length,
      in_air: counted.filter(isInAir).length,
      problems: here.length - heard.length + heard.filter(isProblem).length,
      oldest_age_s: Math.max(...here.map((vehicle) => silenceOf(vehicle, now_s) ?? Infinity)),
    };
  });
}

export interface FleetFigures {
  vehicles: number;
  armed: number;
  inAir: number;
  failsafe: number;
  silent: number;
  /** Of the silent ones, those that were in the air when they were last heard: they may still be. */
  silentInAir: number;
}

/** What is said of the whole fleet in one line. One that was lost in the air still counts as armed and in the air; one that
 *  is not heard on the ground counts as neither. */
export function fleetFigures(vehicles: readonly Vehicle[], now_s: number): FleetFigures {
  const heard = vehicles.filter((vehicle) => isHeard(vehicle, now_s));
  const lost = vehicles.filter((vehicle) => isLostInAir(vehicle, now_s));
  const counted = [...heard, ...lost];
  return {
    vehicles: vehicles.length,
    armed: counted.filter(({ armed }) => armed === true).length,
    inAir: counted.filter(isInAir).length,
    failsafe: heard.filter(({ failsafe }) => failsafe).length,
    silent: vehicles.length - heard.length,
    silentInAir: lost.length,
  };
}
