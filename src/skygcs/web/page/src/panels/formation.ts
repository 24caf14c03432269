// Formations as the planner makes them (core/plan/formations.py), for the preview while a person drags one.

import type { Vec3 } from "../types.ts";

export const SHAPES = ["line", "column", "v", "circle", "grid"] as const;
export type FormationShape = (typeof SHAPES)[number];

const V_ANGLE_RAD = (35 * Math.PI) / 180;

/** Places of `count` vehicles about `middle`; yaw 0 looks along x, counter-clockwise. */
export function formation(shape: FormationShape, count: number, spacingM: number, middle: Vec3, yawRad: number): Vec3[] {
  if (count < 1) return [];
  const flat = places(shape, count).map(([x, y]) => [x * spacingM, y * spacingM] as const);
  const mean = [0, 1].map((k) => flat.reduce((sum, point) => sum + (point[k] ?? 0), 0) / count);
  const [cos, sin] = [Math.cos(yawRad), Math.sin(yawRad)];
  return flat.map(([px, py]) => {
    const [x, y] = [px - (mean[0] ?? 0), py - (mean[1] ?? 0)];
    return [middle[0] + cos * x - sin * y, middle[1] + sin * x + cos * y, middle[2]];
  });
}

/** Neighbours 1 apart, x ahead and y to the left. */
function places(shape: FormationShape, count: number): (readonly [number, number])[] {
  const numbers = Array.from({ length: count }, (_, i) => i);
  switch (shape) {
    case "line": return numbers.map((i) => [0, -i]);
    case "column": return numbers.map((i) => [-i, 0]);
    case "circle": {
      const radius = count === 1 ? 0 : 0.5 / Math.sin(Math.PI / count);
      return numbers.map((i) => [radius * Math.cos((2 * Math.PI * i) / count), radius * Math.sin((2 * Math.PI * i) / count)]);
    }
    case "grid": {
      const width = Math.ceil(Math.sqrt(count));
      return numbers.map((i) => [-Math.floor(i / width), -(i % width)]);
    }
    case "v":
      return numbers.map((i) => {
        const step = Math.floor((i + 1) / 2);
        const side = i % 2 === 1 ? 1 : -1;
        return i === 0 ? [0, 0] : [-step * Math.cos(V_ANGLE_RAD), side * step * Math.sin(V_ANGLE_RAD)];
      });
  }
}
