// When what lies beneath the vehicles is painted: ground, map, grid, overlays, trails, scale. They are on a canvas of their own, which
// changes some times a second; the vehicles, above it, in each frame.

import { sameCamera, type Camera } from "./camera.ts";

/** So often it is painted anew while the view rests: homes move, trails grow. */
export const BACKDROP_EVERY_MS = 1000;

export class Backdrop {
  private paintedMs = -Infinity;
  private camera: Camera | null = null;

  /** What is on it changed, or it could not be painted: the next frame paints it. */
  stale(): void {
    this.paintedMs = -Infinity;
  }

  get isStale(): boolean {
    return this.paintedMs === -Infinity;
  }

  /** True: it has to be painted now, and counts as painted from here on. */
  due(camera: Camera, nowMs: number): boolean {
    const kept = this.camera !== null && sameCamera(this.camera, camera) && nowMs - this.paintedMs <= BACKDROP_EVERY_MS;
    if (!kept) [this.camera, this.paintedMs] = [camera, nowMs];
    return !kept;
  }
}
