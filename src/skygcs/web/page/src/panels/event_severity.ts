// How serious an event is, which events are shown, and which need a person.

import type { NumberedEvent } from "../store.ts";
import type { FleetEvent } from "../types.ts";

/** `alarm`: a person has to look now; it sounds and stays until it is acknowledged. */
export type Severity = "alarm" | "warning" | "info";

export const SEVERITIES: readonly Severity[] = ["alarm", "warning", "info"];

/** MAV_SEVERITY: up to critical. */
const CRITICAL_LEVEL = 2;
const WARNING_LEVEL = 4;

/** What an autopilot repeats on the ground until it may be armed: nothing to wake anybody. */
const BEFORE_FLIGHT = /^(PreArm|Arm:|Preflight Fail|Arming denied)/i;

/** Kinds that report a change to the worse, whatever is in them. */
const WARNINGS = new Set(["warning", "conflict", "link_down", "link_degraded", "undo", "reboot"]);

const WARNING_RESULTS = new Set(["failed", "denied", "timeout", "lost", "refused", "unsupported"]);

/** The same as the daemon's alarms have (core/alarms.py), and a severity for events that raise no alarm. `armed`: whether the
 *  event's vehicle was armed as far as the page knows; null: it does not. */
export function severityOf(event: FleetEvent, armed: boolean | null): Severity {
  const { data } = event;
  const grounded = armed === false ? "warning" : "alarm";
  switch (event.kind) {
    case "fault":
    case "takeoff": return "alarm";
    case "statustext": return textSeverity(event.text, data["level"], grounded);
    case "failsafe": return data["failsafe"] === false ? "info" : "alarm";
    case "vehicle_lost": return data["forgotten"] === true ? "warning" : grounded;
    case "unattended":
    case "uplink_lost":
    case "ground_lost": return grounded;
    case "fence": return data["outside"] === true ? grounded : "info";
    case "duplicate": return data["change"] === "duplicate_over" ? "info" : "alarm";
    case "separation": return separationSeverity(data);
    case "system_status": return isBad(data["system_status"]) || isBad(data["status"]) ? "alarm" : "info";
    case "plan": return planSeverity(data["state"]);
    case "control": return data["state"] === "held" ? "alarm" : "info";
    case "command":
      if (data["order"] === "stop" && data["ok"] === false && data["result"] !== "cancelled") return "alarm";
      return isFailed(data) ? "warning" : "info";
    case "recorder":
      if (data["recording"] === false) return "alarm";
      // it is recording again, and has lost something or nothing
      return data["error"] !== undefined || Number(data["lost"] ?? 0) > 0 ? "warning" : "info";
    case "warning":
      // the operator watchdog: nobody touched anything, and vehicles are brought down
      return data["action"] !== undefined && data["vehicles"] !== undefined ? "alarm" : "warning";
    default: return WARNINGS.has(event.kind) ? "warning" : "info";
  }
}

function textSeverity(text: string, level: unknown, grounded: Severity): Severity {
  if (typeof level !== "number" || level > WARNING_LEVEL) return "info";
  return level <= CRITICAL_LEVEL && !BEFORE_FLIGHT.test(text) ? grounded : "warning";
}

function separationSeverity(data: FleetEvent["data"]): Severity {
  if (data["order"] === "hold") return "alarm";
  if (data["watched"] === false) return "warning";
  switch (data["level"]) {
    case "action":
    case "warning": return "alarm";
    case "notice": return "warning";
    default: return "info";
  }
}

function planSeverity(state: unknown): Severity {
  return state === "stopped" || state === "aborting" || state === "aborted" ? "alarm" : "info";
}

function isBad(status: unknown): boolean {
  return status === "critical" || status === "emergency" || status === "flight_termination";
}

function isFailed(data: FleetEvent["data"]): boolean {
  const outcome = data["outcome"] as { ok?: unknown; result?: unknown } | undefined;
  const ok = data["ok"] ?? outcome?.ok;
  const result = data["result"] ?? outcome?.result;
  return ok === false || (typeof result === "string" && WARNING_RESULTS.has(result));
}

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

export interface JudgedEvent extends NumberedEvent {
  severity: Severity;
}

/** The events that pass, newest first. */
export function shownEvents(events: readonly JudgedEvent[], filter: EventFilter, acknowledged: ReadonlySet<string>): JudgedEvent[] {
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
