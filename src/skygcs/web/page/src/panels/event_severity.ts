// How serious an event is, which events are shown and which need a person; and events that say one thing as one row.

import { namesText } from "../format.ts";
import type { NumberedEvent } from "../store.ts";
import type { FleetEvent } from "../types.ts";

/** `alarm`: a person has to look now; it sounds and stays until it is acknowledged. The daemon says it of each event. */
export type Severity = FleetEvent["severity"];

export const SEVERITIES: readonly Severity[] = ["alarm", "warning", "info"];

export interface EventFilter {
  severities: ReadonlySet<Severity>;
  /** Null: all vehicles, and what concerns none. */
  vehicles: ReadonlySet<string> | null;
  /** Words that all have to be in kind, vehicle or text. */
  words: string;
  /** Only what is not acknowledged. */
  open: boolean;
}

export const ALL_EVENTS: EventFilter = { severities: new Set(SEVERITIES), vehicles: null, words: "", open: false };

/** The events that pass, newest first. */
export function shownEvents(events: readonly NumberedEvent[], filter: EventFilter, acknowledged: ReadonlySet<string>): NumberedEvent[] {
  const words = filter.words.toLowerCase().split(/\s+/).filter(Boolean);
  return events.filter((event) => {
      if (!filter.severities.has(event.severity)) return false;
      if (filter.vehicles !== null && (event.vehicle === null || !filter.vehicles.has(event.vehicle))) return false;
      if (filter.open && (event.severity === "info" || acknowledged.has(keyOf(event)))) return false;
      const text = `${event.kind} ${event.vehicle ?? ""} ${event.text}`.toLowerCase();
      return words.every((word) => text.includes(word));
    })
    .reverse();
}

/** Knows an event again after a reconnect, which numbers all events anew. */
export function keyOf(event: FleetEvent): string {
  return `${event.time_unix_s}|${event.kind}|${event.vehicle ?? ""}|${event.text}`;
}

export interface EventGroup {
  /** Of a loss the loss itself; else the newest. */
  head: NumberedEvent;
  /** The others, newest first. */
  more: readonly NumberedEvent[];
  /** Vehicles that the same happened to; empty for a group that followed from its head. */
  names: readonly string[];
}

/** As in the daemon's alarms: what follows from a loss, and for how long before it was called one. */
const FOLLOWS = new Set(["separation", "uplink_lost", "control", "unattended"]);
const BEFORE_CAUSE_S = 15;
/** A loss that lasts longer explains nothing that is new. */
const CAUSE_LASTS_S = 600;
/** An order reaches a fleet over a slow radio within this. */
const TOGETHER_S = 5;
/** Fewer are rows of their own: as short, and with their own words. */
const LEAST_ALIKE = 3;

/** Groups in the order of `rows`, which are newest first. */
export function grouped(rows: readonly NumberedEvent[]): EventGroup[] {
  const causes = causesOf(rows);
  const groups: { group: EventGroup & { more: NumberedEvent[] }; likeness: string | null; oldest_s: number }[] = [];
  const byCause = new Map<NumberedEvent, NumberedEvent[]>();
  for (const [event, cause] of causes) byCause.set(cause, [...(byCause.get(cause) ?? []), event]);
  const latest = new Map<string, (typeof groups)[number]>();
  for (const event of rows) {
    if (causes.has(event)) continue;
    const followed = byCause.get(event) ?? [];
    const likeness = followed.length > 0 ? null : likenessOf(event);
    const like = likeness === null ? undefined : latest.get(likeness);
    if (like !== undefined && like.oldest_s - event.time_unix_s <= TOGETHER_S) {
      like.group.more.push(event);
      like.oldest_s = event.time_unix_s;
    } else {
      const made = { group: { head: event, more: followed, names: [] }, likeness, oldest_s: event.time_unix_s };
      groups.push(made);
      if (likeness !== null) latest.set(likeness, made);
    }
  }
  const place = new Map(rows.map((event, index) => [event, index]));
  const found = groups.flatMap(({ group, likeness }) => (likeness === null ? [group] : alike(group)));
  return found.sort((a, b) => (place.get(a.head) ?? 0) - (place.get(b.head) ?? 0));
}

/** Alike events of enough vehicles as one; else each for itself. */
function alike({ head, more }: EventGroup): EventGroup[] {
  const members = [head, ...more];
  const names = [...new Set(members.map((event) => event.vehicle ?? ""))].sort();
  if (names.length >= LEAST_ALIKE) return [{ head, more, names }];
  return members.map((event) => ({ head: event, more: [], names: [] }));
}

/** Each event that followed from a loss, with that loss. */
function causesOf(rows: readonly NumberedEvent[]): Map<NumberedEvent, NumberedEvent> {
  const causes = new Map<NumberedEvent, NumberedEvent>();
  const losses = rows.filter((event) => event.kind === "vehicle_lost" && event.data["forgotten"] !== true);
  for (const loss of losses) {
    const back = rows.filter((event) => event.kind === "vehicle_back" && event.vehicle === loss.vehicle && event.time_unix_s >= loss.time_unix_s).at(-1);
    const until_s = Math.min(back?.time_unix_s ?? Infinity, loss.time_unix_s + CAUSE_LASTS_S);
    for (const event of rows) {
      if (!FOLLOWS.has(event.kind) || causes.has(event) || event.time_unix_s > until_s || event.time_unix_s < loss.time_unix_s - BEFORE_CAUSE_S) continue;
      if (event.vehicle === loss.vehicle || event.data["with"] === loss.vehicle) causes.set(event, loss);
    }
  }
  return causes;
}

/** Equal for events that say the same of different vehicles; null: of no vehicle. */
function likenessOf({ kind, vehicle, severity, text, data }: NumberedEvent): string | null {
  if (vehicle === null) return null;
  // of these the text has figures of its own for each vehicle
  const what = kind === "mode" ? data["mode"] : ["vehicle_lost", "vehicle_back", "vehicle_discovered"].includes(kind) ? "" : text;
  return JSON.stringify([severity, kind, what]);
}

/** "10 vehicles", of a group of alike events. */
export function manyText(group: EventGroup): string {
  return `${group.names.length} vehicles`;
}

/** What the row of a group says. */
export function groupText({ head, names }: EventGroup): string {
  if (names.length === 0) return head.text;
  const who = namesText(names, 6);
  switch (head.kind) {
    case "mode": return `→ ${String(head.data["mode"])}: ${who}`;
    case "vehicle_lost": return `lost: ${who}`;
    case "vehicle_back": return `back: ${who}`;
    case "vehicle_discovered": return `discovered: ${who}`;
    default: return `${head.text}: ${who}`;
  }
}

/** What is said aloud of alarms that came together. */
export function spokenText(alarms: readonly NumberedEvent[]): string {
  const groups = grouped([...alarms].reverse());
  const first = groups.at(-1);
  if (first === undefined) return "";
  const { head, names } = first;
  const what = names.length > 0 ? `${manyText(first)}: ${head.kind.replaceAll("_", " ")}` : `${head.vehicle ?? "Station"}: ${head.text}`;
  const others = groups.length - 1;
  return others === 0 ? what : `${what}. ${others} more ${others === 1 ? "alarm" : "alarms"}`;
}
