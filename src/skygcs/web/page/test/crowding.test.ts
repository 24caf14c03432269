import assert from "node:assert/strict";
import { test } from "node:test";
import { ringAt, spacingPx } from "../src/view/crowding.ts";

const FULL = { radiusPx: 15, widthPx: 2 };

/** `n` times `n` vehicles, so many metres apart. */
function square(n: number, apartM: number): { x: number; y: number }[] {
  return Array.from({ length: n * n }, (_, i) => ({ x: (i % n) * apartM, y: Math.floor(i / n) * apartM }));
}

test("far enough apart, few or none: rings have their full size", () => {
  for (const bodies of [[], [{ x: 3, y: 4 }], square(20, 40)]) assert.deepEqual(ringAt(FULL, spacingPx(bodies, 1), 0.6), FULL);
});

test("the spacing of a dense fleet is found, at each scale and anywhere", () => {
  for (const [apartM, pxPerM] of [[20, 1], [20, 0.5], [2, 4], [1, 5]] as const) {
    const fleet = square(100, apartM).map(({ x, y }) => ({ x: x - 777, y: y + 12345 }));
    const found = spacingPx(fleet, pxPerM) / (apartM * pxPerM);
    assert.ok(found > 0.85 && found < 1.15, `${apartM} m at ${pxPerM}: ${found}`);
  }
});

test("a pair beside a fleet that is far apart changes little", () => {
  const fleet = [...square(10, 50), { x: 1, y: 1 }];
  assert.ok(ringAt(FULL, spacingPx(fleet, 1), 0.6).radiusPx > 14);
});

test("rings grow smaller with the spacing, to a least size that still shows", () => {
  const radii = [40, 28, 24, 12, 2].map((apartM) => ringAt(FULL, spacingPx(square(20, apartM), 1), 0.6).radiusPx);
  assert.deepEqual(radii, [...radii].sort((a, b) => b - a));
  assert.equal(radii.at(-1), 9);
  assert.ok(ringAt(FULL, 1, 0.1).widthPx >= 1);
});
