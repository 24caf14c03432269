// Where the view looks: metres of the fleet's frame to pixels of the canvas, x to the right, y up. Pure.

export interface Camera {
  /** Metres in the middle of the view. */
  readonly x: number;
  readonly y: number;
  readonly pxPerM: number;
  readonly widthPx: number;
  readonly heightPx: number;
}

export interface Bounds {
  left: number;
  right: number;
  bottom: number;
  top: number;
}

/** 20 km across a screen, and a vehicle that fills it. */
export const LEAST_PX_PER_M = 0.02;
export const MOST_PX_PER_M = 400;

export function toScreenX(camera: Camera, x: number): number {
  return camera.widthPx / 2 + (x - camera.x) * camera.pxPerM;
}

export function toScreenY(camera: Camera, y: number): number {
  return camera.heightPx / 2 - (y - camera.y) * camera.pxPerM;
}

export function toWorld(camera: Camera, xPx: number, yPx: number): { x: number; y: number } {
  return { x: camera.x + (xPx - camera.widthPx / 2) / camera.pxPerM, y: camera.y - (yPx - camera.heightPx / 2) / camera.pxPerM };
}

export function panned(camera: Camera, dxPx: number, dyPx: number): Camera {
  return { ...camera, x: camera.x - dxPx / camera.pxPerM, y: camera.y + dyPx / camera.pxPerM };
}

/** Zoomed by a factor; the place under the pointer stays there. */
export function zoomedAt(camera: Camera, factor: number, xPx: number, yPx: number): Camera {
  const pxPerM = clamp(camera.pxPerM * factor, LEAST_PX_PER_M, MOST_PX_PER_M);
  const before = toWorld(camera, xPx, yPx);
  const after = toWorld({ ...camera, pxPerM }, xPx, yPx);
  return { ...camera, pxPerM, x: camera.x + before.x - after.x, y: camera.y + before.y - after.y };
}

/** All of the bounds with a margin, at the top `topPx`; a single vehicle gets some metres around it, not the closest zoom. */
export function fitted(camera: Camera, bounds: Bounds, topPx = 0, marginPx = 64, leastM = 30): Camera {
  const width = Math.max(bounds.right - bounds.left, leastM);
  const height = Math.max(bounds.top - bounds.bottom, leastM);
  const roomX = Math.max(camera.widthPx - 2 * marginPx, camera.widthPx / 2);
  const overPx = Math.max(topPx - marginPx, 0);
  const roomY = Math.max(camera.heightPx - 2 * marginPx - overPx, camera.heightPx / 2);
  const pxPerM = clamp(Math.min(roomX / width, roomY / height), LEAST_PX_PER_M, MOST_PX_PER_M);
  return { ...camera, x: (bounds.left + bounds.right) / 2, y: (bounds.bottom + bounds.top + overPx / pxPerM) / 2, pxPerM };
}

export function extended(bounds: Bounds | null, x: number, y: number, byM = 0): Bounds {
  if (bounds === null) return { left: x - byM, right: x + byM, bottom: y - byM, top: y + byM };
  return {
    left: Math.min(bounds.left, x - byM),
    right: Math.max(bounds.right, x + byM),
    bottom: Math.min(bounds.bottom, y - byM),
    top: Math.max(bounds.top, y + byM),
  };
}

/** The largest of 1, 2, 5, 10, 20, … metres that is at most so many pixels wide. */
export function niceLengthM(pxPerM: number, mostPx: number): number {
  const most = mostPx / pxPerM;
  const power = 10 ** Math.floor(Math.log10(most));
  return most >= 5 * power ? 5 * power : most >= 2 * power ? 2 * power : power;
}

export function lengthText(m: number): string {
  return m >= 1000 ? `${+(m / 1000).toFixed(1)} km` : m >= 1 ? `${+m.toFixed(1)} m` : `${+(m * 100).toFixed(0)} cm`;
}

function clamp(value: number, least: number, most: number): number {
  return Math.min(Math.max(value, least), most);
}

export function sameCamera(a: Camera, b: Camera): boolean {
  return a.x === b.x && a.y === b.y && a.pxPerM === b.pxPerM && a.widthPx === b.widthPx && a.heightPx === b.heightPx;
}
