// Parameters in the browser: search, what a type can hold, edits that wait to be sent, and what is known of each vehicle's.

import { Changes } from "../hooks.ts";
import type { ParamDescription, ParamEntry } from "../rpc_types.ts";

export interface ValueRange {
  least: number;
  most: number;
  whole: boolean;
}

const FLOAT_MOST = 3.4028234663852886e38;

const BITS: Readonly<Record<string, readonly [bits: number, signed: boolean]>> = {
  UINT8: [8, false],
  INT8: [8, true],
  UINT16: [16, false],
  INT16: [16, true],
  UINT32: [32, false],
  INT32: [32, true],
};

/** Why the daemon refuses a value unless somebody insists; null: it is within its range. As the daemon judges it: a value
 * with a meaning of its own is never outside, nor is the 0 of an ArduPilot, where it is "off". */
export function outsideText(value: number, known: ParamDescription | undefined, autopilot: string): string | null {
  if (known === undefined || meaningText(value, known) !== null || (autopilot === "ardupilot" && value === 0)) return null;
  const low = known.least !== null && value < Math.min(known.least, Math.fround(known.least));
  const high = known.greatest !== null && value > Math.max(known.greatest, Math.fround(known.greatest));
  return low || high ? `outside its range of ${known.range}` : null;
}

/** The meaning of a listed value; null: it has none of its own. */
export function meaningText(value: number, known: ParamDescription): string | null {
  const found = Object.entries(known.values).find(([key]) => sameValue(Number(key), value));
  return found === undefined ? null : found[1];
}

/** One line about a parameter: what it is, its range, and whether a change needs a reboot. */
export function aboutText(known: ParamDescription | undefined): string {
  if (known === undefined) return "";
  const parts = [known.description, known.range, known.reboot ? "takes effect after a reboot" : ""];
  return parts.filter((part) => part !== "").join("; ");
}

/** What the type can hold. */
export function rangeOf(type: string): ValueRange {
  const known = BITS[type];
  if (known === undefined) return { least: -FLOAT_MOST, most: FLOAT_MOST, whole: false };
  const [bits, signed] = known;
  return signed ? { least: -(2 ** (bits - 1)), most: 2 ** (bits - 1) - 1, whole: true } : { least: 0, most: 2 ** bits - 1, whole: true };
}

/** "a whole number from -128 to 127", "a number". */
export function rangeText(type: string): string {
  const range = rangeOf(type);
  return range.whole ? `a whole number from ${range.least} to ${range.most}` : "a number";
}

export type Edit = { ok: true; value: number } | { ok: false; problem: string };

const NUMBER = /^[+-]?(\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?$/i;
const HEX = /^0x[0-9a-f]+$/i;

/** What a person typed as a value of this type. */
export function parseValue(text: string, type: string): Edit {
  const trimmed = text.trim().replace("−", "-");
  if (!NUMBER.test(trimmed) && !HEX.test(trimmed)) return { ok: false, problem: `is not ${rangeText(type)}` };
  const value = Number(trimmed);
  const range = rangeOf(type);
  if (range.whole && !Number.isInteger(value)) return { ok: false, problem: `is not ${rangeText(type)}` };
  if (!(value >= range.least && value <= range.most)) return { ok: false, problem: `is not ${rangeText(type)}` };
  return { ok: true, value };
}

/** True if a 32-bit float holds both as the same value. */
export function sameValue(one: number | null, other: number | null): boolean {
  if (one === null || other === null) return one === other;
  return one === other || Math.fround(one) === Math.fround(other);
}

/** As short as the float allows: 0.1 instead of 0.10000000149. */
export function valueText(value: number | null): string {
  if (value === null) return "not a number";
  if (Number.isInteger(value)) return String(value);
  for (let digits = 1; digits <= 9; digits++) {
    const text = value.toPrecision(digits);
    if (Math.fround(Number(text)) === Math.fround(value)) return String(Number(text));
  }
  return String(value);
}

/** Words that are all in the name; a word with * or ? is a pattern for the whole name. */
export function matches(name: string, search: string): boolean {
  return search.toUpperCase().split(/\s+/).filter(Boolean)
    .every((word) => (/[*?]/.test(word) ? pattern(word).test(name) : name.toUpperCase().includes(word)));
}

function pattern(word: string): RegExp {
  const escaped = word.replace(/[.+^${}()|[\]\\]/g, "\\$&").replace(/\*/g, ".*").replace(/\?/g, ".");
  return new RegExp(`^${escaped}$`, "i");
}

/** "MPC" of MPC_XY_P: what is before the first underscore. */
export function groupOf(name: string): string {
  const cut = name.indexOf("_");
  return cut > 0 ? name.slice(0, cut) : name;
}

export interface ParamBook {
  params: readonly ParamEntry[];
  /** By name; empty until it came, and for a firmware without any. */
  metadata: Readonly<Record<string, ParamDescription>>;
  /** Where the metadata come from. */
  source: string;
  edits: ReadonlyMap<string, number>;
  /** Set from this page: marked. */
  setHere: ReadonlySet<string>;
  sysid: number;
  compid: number;
  autopilot: string;
  /** Its list is on its way. */
  reading: boolean;
  /** Why the last list did not come. */
  failure: string | null;
}

const EMPTY_BOOK: ParamBook = { params: [], metadata: {}, source: "", edits: new Map(), setHere: new Set(), sysid: 1, compid: 1, autopilot: "generic", reading: false, failure: null };

/** Vehicles whose parameters are kept: some 300 kB each. */
export const MAX_BOOKS = 20;

export class ParamBooks extends Changes {
  private readonly byName = new Map<string, ParamBook>();

  of(name: string): ParamBook {
    return this.byName.get(name) ?? EMPTY_BOOK;
  }

  /** Keeps the changed book, and forgets the one that was changed longest ago. */
  change(name: string, change: (book: ParamBook) => ParamBook): void {
    const book = change(this.of(name));
    this.byName.delete(name);
    this.byName.set(name, book);
    const [oldest] = this.byName.keys();
    if (this.byName.size > MAX_BOOKS && oldest !== undefined) this.byName.delete(oldest);
    this.changed();
  }
}

/** One for the page. */
export const paramBooks = new ParamBooks();
