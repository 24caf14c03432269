// Parameters in the browser: search, what a type can hold, and edits that wait to be sent.

export interface ParamEntry {
  name: string;
  /** Null: the vehicle reports no finite number. */
  value: number | null;
  type: string;
}

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

/** What the type can hold. Autopilots send no ranges of their own over the parameter protocol. */
export function rangeOf(type: string): ValueRange {
  const known = BITS[type];
  if (known === undefined) return { least: -FLOAT_MOST, most: FLOAT_MOST, whole: false };
  const [bits, signed] = known;
  return signed
    ? { least: -(2 ** (bits - 1)), most: 2 ** (bits - 1) - 1, whole: true }
    : { least: 0, most: 2 ** bits - 1, whole: true };
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
  return search
    .toUpperCase()
    .split(/\s+/)
    .filter(Boolean)
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
