import assert from "node:assert/strict";
import { test } from "node:test";
import { circlePieces, durationOf, pathPieces, pointsAlong, squarePoints, type Piece } from "../src/shape_pieces.ts";
import type { Vec3 } from "../src/types.ts";

const START: Vec3 = [3, -2, 8];

function near(a: number, b: number, by: number): void {
  assert.ok(Math.abs(a - b) <= by, `${a} is not ${b}`);
}

/** Value of the n-th derivative. */
function at(coefficients: readonly number[], t: number, order: number): number {
  let found = [...coefficients];
  for (let n = 0; n < order; n++) found = found.slice(1).map((c, i) => c * (i + 1));
  return found.reduceRight((sum, c) => sum * t + c, 0);
}

function motion(piece: Piece, t: number, order: number): number[] {
  return [piece.x, piece.y, piece.up].map((axis) => at(axis, t, order));
}

/** Place, velocity and acceleration go on where pieces meet, and are zero at both ends of the whole. */
function isSmooth(pieces: readonly Piece[]): void {
  for (const order of [0, 1, 2]) {
    for (const [n, piece] of pieces.entries()) {
      const next = pieces[n + 1];
      const end = motion(piece, piece.duration_s, order);
      const then = next === undefined ? end.map((value) => (order === 0 ? value : 0)) : motion(next, 0, order);
      end.forEach((value, k) => near(value, then[k] ?? NaN, 1e-6));
    }
    if (order > 0) motion(pieces[0] as Piece, 0, order).forEach((value) => near(value, 0, 1e-9));
  }
}

function most(pieces: readonly Piece[], order: number): number {
  return Math.max(...pieces.flatMap((piece) => Array.from({ length: 41 }, (_, i) => Math.hypot(...motion(piece, (piece.duration_s * i) / 40, order)))));
}

test("a square begins and ends at its corner, within the speed, and stops at each corner", () => {
  const pieces = pathPieces(squarePoints(START, 10, 2), 2);
  assert.equal(pieces.length, 8);
  isSmooth(pieces);
  near(most(pieces, 1), 2, 1e-3);
  assert.ok(most(pieces, 2) <= 1 + 1e-6);
  const ends = pieces.map((piece) => motion(piece, piece.duration_s, 0));
  assert.deepEqual(ends.slice(0, 4).map((end) => end.map((v) => Math.round(v * 1e6) / 1e6)), [[13, -2, 8], [13, 8, 8], [3, 8, 8], [3, -2, 8]]);
});

test("a short leg is bounded by the acceleration, and one of no length is left out", () => {
  const pieces = pathPieces([START, [3.5, -2, 8], [3.5, -2, 8]], 20);
  assert.equal(pieces.length, 1);
  near(most(pieces, 2), 1, 1e-2);
});

test("a circle stays on its radius, begins and ends at rest where the vehicle is, and goes round as often", () => {
  for (const [radius, speed, laps] of [[5, 2, 2], [20, 3, 1], [2, 5, 3], [50, 30, 1]] as const) {
    const pieces = circlePieces(START, radius, speed, laps);
    isSmooth(pieces);
    const points = pointsAlong(pieces, 20);
    for (const [x, y, up] of points) {
      near(Math.hypot(x - START[0] - radius, y - START[1]), radius, radius * 5e-5);
      assert.equal(up, 8);
    }
    for (const point of [points[0], points.at(-1)]) point?.forEach((value, k) => near(value, START[k] ?? NaN, 1e-6));
    let turned = 0;
    points.slice(1).forEach(([x, y], n) => {
      const before = points[n] as Vec3;
      const step = Math.atan2(y - START[1], x - START[0] - radius) - Math.atan2(before[1] - START[1], before[0] - START[0] - radius);
      turned += step - 2 * Math.PI * Math.round(step / (2 * Math.PI));
    });
    near(turned, 2 * Math.PI * laps, 1e-5);
    assert.ok(most(pieces, 1) <= speed * (1 + 1e-4));
    assert.ok(most(pieces, 2) <= Math.SQRT2 + 1e-3, `${most(pieces, 2)}`);
    assert.ok(pieces.length < 2000 && durationOf(pieces) > 0);
  }
});
