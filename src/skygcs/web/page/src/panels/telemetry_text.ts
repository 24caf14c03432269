// Telemetry as people read it: a key of the RPC as a label with its unit, a value in figures that mean something.

import { fixed } from "../format.ts";

const UNITS: readonly (readonly [suffix: string, unit: string])[] = [
  ["_bytes_per_s", "B/s"],
  ["_enu_mps2", "m/s²"],
  ["_mps2", "m/s²"],
  ["_enu_mps", "m/s east, north, up"],
  ["_world_mps", "m/s in the fleet's frame"],
  ["_mps", "m/s"],
  ["_radps", "rad/s"],
  ["_dps", "°/s"],
  ["_degc", "°C"],
  ["_deg", "°"],
  ["_percent", "%"],
  ["_enu_m", "m"],
  ["_amsl_m", "m above sea level"],
  ["_rel_m", "m above home"],
  ["_mah", "mAh"],
  ["_hpa", "hPa"],
  ["_gauss", "gauss"],
  ["_us", "µs"],
  ["_hz", "Hz"],
  ["_m", "m"],
  ["_s", "s"],
];

const WORDS: Readonly<Record<string, string>> = {
  volts: "voltage",
  amps: "current",
  vel: "velocity",
  alt: "altitude",
  vfr: "air data",
  rc: "remote control",
  imu: "IMU",
  gps: "GPS",
  hdop: "HDOP",
  vdop: "VDOP",
  enu_m: "place in the fleet's frame",
};

const OWN_UNITS: Readonly<Record<string, string>> = { volts: "V", amps: "A", enu_m: "m" };

/** "vel_enu_mps" is velocity in m/s: the words and the unit of a key. */
export function labelOf(key: string): { text: string; unit: string } {
  const own = OWN_UNITS[key];
  if (own !== undefined) return { text: WORDS[key] ?? key, unit: own };
  const known = UNITS.find(([suffix]) => key.endsWith(suffix) && key.length > suffix.length);
  const stem = known === undefined ? key : key.slice(0, -known[0].length);
  return { text: WORDS[stem] ?? stem.replaceAll("_", " "), unit: known?.[1] ?? "" };
}

const PLACES = 7;

/** A value in as many figures as its key is worth. */
export function fieldText(key: string, value: unknown): string {
  if (value === null || value === undefined) return "–";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value === "number") return numberText(key, value);
  if (typeof value === "string") return value === "" ? "–" : value.replaceAll("_", " ");
  if (Array.isArray(value)) return value.length === 0 ? "none" : value.map((one) => fieldText(key, one)).join(", ");
  const entries = Object.entries(value);
  return entries.length === 0 ? "none" : entries.map(([k, one]) => `${labelOf(k).text} ${fieldText(k, one)}`).join(", ");
}

function numberText(key: string, value: number): string {
  if (key === "lat_deg" || key === "lon_deg") return fixed(value, PLACES) ?? "–";
  if (Number.isInteger(value)) return String(value);
  const size = Math.abs(value);
  if (/_(s|deg|percent)$/.test(key) || key === "volts" || key === "amps") return fixed(value, key.endsWith("_s") && size < 10 ? 2 : size >= 100 ? 0 : 1) ?? "–";
  return fixed(value, size >= 100 ? 1 : size >= 1 ? 2 : 4) ?? "–";
}

export interface Group {
  name: string;
  fields: readonly (readonly [string, unknown])[];
  age_s: number | null;
}

/** Keys that have a place of their own. */
const ELSEWHERE = new Set(["status_texts", "components", "messages", "links", "name"]);

/** A vehicle's state as groups with ages, and what stands alone. A group that nothing was heard of is left out. */
export function groupsOf(state: Readonly<Record<string, unknown>>): { groups: Group[]; plain: (readonly [string, unknown])[] } {
  const groups: Group[] = [];
  const plain: (readonly [string, unknown])[] = [];
  for (const [key, value] of Object.entries(state)) {
    if (ELSEWHERE.has(key)) continue;
    if (typeof value === "object" && value !== null && !Array.isArray(value)) {
      const { age_s, ...fields } = value as { age_s?: unknown };
      groups.push({ name: key, fields: Object.entries(fields), age_s: typeof age_s === "number" ? age_s : null });
    } else if (value !== null) {
      plain.push([key, value]);
    }
  }
  return { groups, plain };
}
