// Where vehicles have flown: a ring of points each, bounded, in metres of the fleet's frame.

import type { StateBatch } from "./types.ts";

/** Points kept of one vehicle: at least 250 m of flight, minutes at walking speed. */
export const TRAIL_POINTS = 500;
/** Nearer points add nothing that could be seen. */
export const TRAIL_STEP_M = 0.5;
/** What is farther away in one update was not flown: a jump of the estimate, a new origin, a gap. */
export const TRAIL_JUMP_M = 60;
const MAX_TRAILS = 300;

/** x, y, up, and whether a line leads here from the point before. */
const WIDTH = 4;

export class Trail {
  private readonly points = new Float64Array(TRAIL_POINTS * WIDTH);
  private begin = 0;
  /** Points added since it began, and how many of them the view has drawn. */
  added = 0;
  drawn = 0;
  /** The last point that the view has drawn. */
  drawnEnd: readonly [number, number] | null = null;
  length = 0;

  /** Adds a point if it is far enough from the last one; true if it was added. */
  add(x: number, y: number, z: number): boolean {
    let joined = 0;
    if (this.length > 0) {
      const last = this.index(this.length - 1);
      const distance = Math.hypot(x - this.at(last), y - this.at(last + 1), z - this.at(last + 2));
      if (distance < TRAIL_STEP_M) return false;
      joined = distance > TRAIL_JUMP_M ? 0 : 1;
    }
    if (this.length === TRAIL_POINTS) {
      this.begin = (this.begin + 1) % TRAIL_POINTS;
      this.length -= 1;
    }
    this.points.set([x, y, z, joined], this.index(this.length));
    this.length += 1;
    this.added += 1;
    return true;
  }

  /** Calls `point` for each, oldest first; or only for the newest ``count``. */
  each(point: (x: number, y: number, z: number, joined: boolean) => void, count = this.length): void {
    for (let i = Math.max(this.length - count, 0); i < this.length; i++) {
      const k = this.index(i);
      point(this.at(k), this.at(k + 1), this.at(k + 2), i > 0 && this.at(k + 3) === 1);
    }
  }

  private index(i: number): number {
    return ((this.begin + i) % TRAIL_POINTS) * WIDTH;
  }

  private at(k: number): number {
    return this.points[k] ?? 0;
  }
}

export class Trails {
  readonly byName = new Map<string, Trail>();
  private originGeneration: number | null = null;

  /** Takes a batch of states. A new origin begins all trails anew: their metres were counted from another place. */
  take(batch: StateBatch): void {
    if (batch.full) this.clear();
    for (const name of batch.gone) this.byName.delete(name);
    for (const { name, position, armed } of batch.vehicles) {
      const enu = position?.enu_m;
      if (enu === null || enu === undefined) continue;
      const generation = position?.origin_generation ?? this.originGeneration; // a vehicle of another site has none
      if (position !== null && generation !== this.originGeneration) {
        this.clear();
        this.originGeneration = generation;
      }
      let trail = this.byName.get(name);
      if (trail === undefined) {
        if (armed !== true || this.byName.size >= MAX_TRAILS) continue;
        trail = new Trail();
        this.byName.set(name, trail);
      }
      trail.add(enu[0], enu[1], enu[2]);
    }
  }

  clear(): void {
    this.byName.clear();
  }
}
