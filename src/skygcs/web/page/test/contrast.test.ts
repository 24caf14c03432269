import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

const CSS = readFileSync("src/styles/theme.css", "utf8");

function themes(): Map<string, Map<string, string>> {
  const found = new Map<string, Map<string, string>>();
  for (const [, selector = "", body = ""] of CSS.matchAll(/([^{}]+)\{([^{}]*)\}/g)) {
    const name = /data-theme="(\w+)"/.exec(selector)?.[1];
    assert.ok(name);
    found.set(name, new Map([...body.matchAll(/--([\w-]+):\s*(#[0-9a-f]{6});/g)].map(([, key = "", value = ""]) => [key, value])));
  }
  return found;
}

/** WCAG 2.2: relative luminance and contrast. */
function luminance(colour: string): number {
  const part = (i: number): number => {
    const c = parseInt(colour.slice(i, i + 2), 16) / 255;
    return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  };
  return 0.2126 * part(1) + 0.7152 * part(3) + 0.0722 * part(5);
}

function contrast(a: string, b: string): number {
  const [x, y] = [luminance(a), luminance(b)];
  return (Math.max(x, y) + 0.05) / (Math.min(x, y) + 0.05);
}

/** Text on each of the grounds it stands on: 4.5 : 1. */
const TEXT: readonly (readonly [string, readonly string[]])[] = [
  ["text", ["ground", "surface", "raised", "hover", "selected-row", "danger-row", "warning-row"]],
  ["text-muted", ["ground", "surface", "raised", "hover", "selected-row", "danger-row", "warning-row"]],
  ["lost", ["ground", "surface", "raised", "selected-row", "danger-row", "warning-row"]],
  ["accent", ["ground", "surface", "raised"]],
  ["good", ["ground", "surface", "raised", "selected-row", "danger-row", "warning-row"]],
  ["warning", ["ground", "surface", "raised", "selected-row", "danger-row", "warning-row"]],
  ["danger", ["ground", "surface", "raised", "selected-row", "danger-row", "warning-row"]],
  ["on-accent", ["accent"]],
  ["on-danger", ["danger-fill", "danger-fill-press"]],
  ["ground", ["text"]],
];

/** Marks, edges of fields, and lines on the view: 3 : 1. */
const MARKS: readonly (readonly [string, readonly string[]])[] = [
  ["edge-strong", ["surface", "ground"]],
  ["selection", ["ground"]],
  ...["plan", "flown", "fence", "goal"].map((ink) => [`ink-${ink}`, ["ground", "surface"]] as const),
  ...Array.from({ length: 8 }, (_, i) => [`vehicle-${i + 1}`, ["ground", "surface"]] as const),
];

test("there are both themes, with the same colours", () => {
  const [dark, daylight] = [themes().get("dark"), themes().get("daylight")];
  assert.ok(dark && daylight);
  assert.deepEqual([...dark.keys()], [...daylight.keys()]);
});

for (const [name, colours] of themes()) {
  for (const [pairs, least] of [[TEXT, 4.5], [MARKS, 3]] as const) {
    for (const [front, backs] of pairs) {
      for (const back of backs) {
        test(`${name}: ${front} on ${back} has ${least} : 1`, () => {
          const [a, b] = [colours.get(front), colours.get(back)];
          assert.ok(a !== undefined && b !== undefined);
          const is = contrast(a, b);
          assert.ok(is >= least, `${is.toFixed(2)} : 1`);
        });
      }
    }
  }
}
