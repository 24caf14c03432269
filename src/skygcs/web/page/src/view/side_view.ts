// Heights: a strip below the fleet view with the same x axis, so that each vehicle is straight below its place above.

import { lengthText, niceLengthM, toScreenX, type Camera } from "./camera.ts";
import { colourOfShape, haloText, lineAcross, lineDown, type Colours } from "./drawing.ts";
import type { Overlay } from "./overlays.ts";
import type { Palette } from "./palette.ts";
import { Paths } from "./paths.ts";
import type { Body } from "./scene.ts";
import type { Pen } from "./sprites.ts";

/** Of a low view, as on a phone that lies on its side, a quarter. */
const SIDE_PX = 120;
const LEAST_SIDE_PX = 64;
const BASE_PX = 18;
const LEAST_TOP_M = 12;

/** How high the strip is in a view of this height. */
export function sidePxOf(heightPx: number): number {
  return Math.max(Math.min(SIDE_PX, Math.round(heightPx / 4)), LEAST_SIDE_PX);
}

/** Of each overlay, which does not change: a plan has thousands of points. */
const tops = new WeakMap<Overlay, number>();

function topOfOverlay(overlay: Overlay): number {
  let top = tops.get(overlay);
  if (top === undefined) {
    top = 0;
    for (const shape of overlay.shapes) {
      if (shape.kind === "path") for (const [, , z] of shape.points) top = Math.max(top, z);
      else if (shape.kind === "mark") top = Math.max(top, shape.at[2]);
    }
    tops.set(overlay, top);
  }
  return top;
}

/** Height of the strip's upper edge: above everything, also what is planned and where vehicles are sent, in steps, so that
 *  it does not breathe with each climb. */
export function topOf(bodies: readonly Pick<Body, "z" | "goal">[], overlays: Iterable<Overlay>, before: number): number {
  let highest = bodies.reduce((most, body) => Math.max(most, body.z, body.goal?.[2] ?? 0), 0);
  for (const overlay of overlays) highest = Math.max(highest, topOfOverlay(overlay));
  const wanted = Math.max(highest * 1.2, LEAST_TOP_M);
  if (wanted <= before && wanted > before * 0.5) return before;
  return Math.ceil(wanted / 5) * 5;
}

export function drawSide(
  pen: Pen,
  camera: Camera,
  topPx: number,
  sidePx: number,
  topM: number,
  palette: Palette,
  bodies: readonly Body[],
  colourOf: (body: Body) => string,
  overlays: Iterable<Overlay>,
  colours: Colours,
): void {
  const pxPerM = (sidePx - BASE_PX - 8) / topM;
  const groundPx = topPx + sidePx - BASE_PX;
  const yOf = (z: number): number => groundPx - z * pxPerM;
  pen.save();
  pen.beginPath();
  pen.rect(0, topPx, camera.widthPx, sidePx);
  pen.clip();
  pen.fillStyle = palette.surface;
  pen.fillRect(0, topPx, camera.widthPx, sidePx);
  heightLines(pen, camera, palette, topM, pxPerM, yOf);
  for (const overlay of overlays) drawPaths(pen, camera, palette, overlay, colours, yOf);
  drawStems(pen, camera, palette, bodies, yOf);
  const paths = new Paths();
  for (const body of bodies) {
    const path = paths.of(colourOf(body));
    const x = toScreenX(camera, body.x);
    const y = yOf(body.z);
    path.moveTo(x + 4.5, y);
    path.arc(x, y, body.selected ? 5.5 : 4.5, 0, 7);
  }
  paths.fill(pen);
  pen.restore();
}

function heightLines(
  pen: Pen,
  camera: Camera,
  palette: Palette,
  topM: number,
  pxPerM: number,
  yOf: (z: number) => number,
): void {
  const step = niceLengthM(pxPerM, 44);
  pen.fillStyle = palette.gridMajor;
  for (let z = step; z <= topM; z += step) lineAcross(pen, camera, yOf(z));
  pen.fillStyle = palette.muted;
  lineAcross(pen, camera, yOf(0));
  pen.font = `11px ${palette.font}`;
  pen.textAlign = "left";
  pen.textBaseline = "bottom";
  for (let z = 0; z <= topM; z += step) {
    if (z > 0 && (topM - z) * pxPerM < 8) continue; // it would be cut off
    haloText(pen, z === 0 ? "0 m above the origin" : lengthText(z), 8, yOf(z) - 1, palette.muted, palette.surface);
  }
}

function drawStems(pen: Pen, camera: Camera, palette: Palette, bodies: readonly Body[], yOf: (z: number) => number): void {
  pen.fillStyle = palette.axis;
  for (const body of bodies) lineDown(pen, toScreenX(camera, body.x), yOf(0), yOf(body.z));
}

function drawPaths(pen: Pen, camera: Camera, palette: Palette, overlay: Overlay, colours: Colours, yOf: (z: number) => number): void {
  for (const shape of overlay.shapes) {
    if (shape.kind !== "path" || shape.ink === "fence") continue;
    pen.strokeStyle = colourOfShape(shape, palette, colours);
    pen.lineWidth = 1.5;
    pen.setLineDash(shape.dashed === true ? [5, 4] : []);
    pen.beginPath();
    for (const [x, , z] of shape.points) pen.lineTo(toScreenX(camera, x), yOf(z));
    pen.stroke();
  }
  pen.setLineDash([]);
}
