// A plan as it is drawn: where each vehicle is at a time, from piecewise polynomials with ascending coefficients.

import type { Vec3 } from "../types.ts";

/** [duration_s, x, y, up]: coefficients in the seconds since the piece began. */
export type Piece = readonly [number, readonly number[], readonly number[], readonly number[]];

/** `paths` of web.plan.check. */
export interface PlanPaths {
  exact: boolean;
  duration_s: number;
  phases: readonly string[];
  vehicles: Readonly<Record<string, readonly Piece[]>>;
}

/** One vehicle's path. Before its begin and after its end the vehicle stands. */
export class PlanPath {
  private readonly begins_s: number[] = [];
  readonly duration_s: number;

  constructor(readonly pieces: readonly Piece[]) {
    let at = 0;
    for (const piece of pieces) {
      this.begins_s.push(at);
      at += piece[0];
    }
    this.duration_s = at;
  }

  at(t_s: number): Vec3 {
    const { piece, since_s } = this.pieceAt(t_s);
    if (piece === undefined) return [0, 0, 0];
    return [polynomial(piece[1], since_s), polynomial(piece[2], since_s), polynomial(piece[3], since_s)];
  }

  /** Metres per second; 0 before the begin and after the end. */
  speedAt(t_s: number): number {
    if (t_s < 0 || t_s > this.duration_s) return 0;
    const { piece, since_s } = this.pieceAt(t_s);
    if (piece === undefined) return 0;
    return Math.hypot(derivative(piece[1], since_s), derivative(piece[2], since_s), derivative(piece[3], since_s));
  }

  /** Points of the path for a picture: the ends of all pieces, and between them more where a piece is curved. */
  points(most: number): Vec3[] {
    const found: Vec3[] = [];
    const each = Math.max(1, Math.floor(most / Math.max(1, this.pieces.length)));
    this.pieces.forEach(([duration_s, ...axes]) => {
      const parts = axes.every((axis) => axis.length <= 2) ? 1 : each;
      for (let k = 0; k < parts; k++) {
        const t = (duration_s * k) / parts;
        found.push([polynomial(axes[0], t), polynomial(axes[1], t), polynomial(axes[2], t)]);
      }
    });
    if (this.pieces.length > 0) found.push(this.at(this.duration_s));
    return thinned(found, most);
  }

  private pieceAt(t_s: number): { piece: Piece | undefined; since_s: number } {
    let low = 0;
    let high = this.pieces.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if ((this.begins_s[middle] ?? 0) <= t_s) low = middle;
      else high = middle - 1;
    }
    const piece = this.pieces[low];
    const since_s = t_s - (this.begins_s[low] ?? 0);
    return { piece, since_s: Math.min(Math.max(since_s, 0), piece?.[0] ?? 0) };
  }
}

/** All vehicles of a plan on one clock. */
export class PlanTimeline {
  readonly duration_s: number;
  readonly paths: ReadonlyMap<string, PlanPath>;

  constructor(paths: PlanPaths) {
    this.duration_s = paths.duration_s;
    this.paths = new Map(Object.entries(paths.vehicles).map(([name, pieces]) => [name, new PlanPath(pieces)]));
  }

  at(t_s: number): Map<string, Vec3> {
    return new Map([...this.paths].map(([name, path]) => [name, path.at(t_s)]));
  }

  /** The pair that is closest at this time; a vertical distance counts 1/`downwashRatio` of it. */
  closestAt(t_s: number, downwashRatio: number): { pair: readonly [string, string]; distance_m: number } | null {
    const places = [...this.at(t_s)];
    let best: { pair: readonly [string, string]; distance_m: number } | null = null;
    places.forEach(([one, a], i) => {
      for (const [other, b] of places.slice(i + 1)) {
        const distance_m = Math.hypot(a[0] - b[0], a[1] - b[1], (a[2] - b[2]) / downwashRatio);
        if (best === null || distance_m < best.distance_m) best = { pair: [one, other], distance_m };
      }
    });
    return best;
  }
}

function polynomial(coefficients: readonly number[] | undefined, t: number): number {
  let value = 0;
  for (let k = (coefficients?.length ?? 0) - 1; k >= 0; k--) value = value * t + (coefficients?.[k] ?? 0);
  return value;
}

function derivative(coefficients: readonly number[], t: number): number {
  let value = 0;
  for (let k = coefficients.length - 1; k >= 1; k--) value = value * t + k * (coefficients[k] ?? 0);
  return value;
}

function thinned(points: Vec3[], most: number): Vec3[] {
  if (points.length <= most) return points;
  const step = (points.length - 1) / (most - 1);
  return Array.from({ length: most }, (_, i) => points[Math.round(i * step)] ?? [0, 0, 0]);
}
