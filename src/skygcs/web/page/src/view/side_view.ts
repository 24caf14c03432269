// Heights: a strip below the fleet view with the same x axis, so that each vehicle is straight below its place above.

import { lengthText, niceLengthM, toScreenX, type Camera } from "./camera.ts";
import { colourOfShape, haloText, lineAcross, lineDown, type Colours } from "./drawing.ts";
import type { Overlay } from "./overlays.ts";
import type { Palette } from "./palette.ts";
import type { Body } from "./scene.ts";
import type { Pen, Sprites } from "./sprites.ts";

/** Of a low view, as on a phone that lies on its side, a quarter. */
const SIDE_PX = 120;
const LEAST_SIDE_PX = 64;
const BASE_PX = 18;
const LEAST_TOP_M = 12;
const BODY_PX = 4.5;
const SELECTED_PX = 5.5;

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

/** Where the strip is on the canvas, and its heights. */
export interface SideScale {
  topPx: number;
  heightPx: number;
  topM: number;
  pxPerM: number;
  yOf: (z: number) => number;
}

export function sideScale(topPx: number, heightPx: number, topM: number): SideScale {
  const pxPerM = (heightPx - BASE_PX - 8) / topM;
  return { topPx, heightPx, topM, pxPerM, yOf: (z) => topPx + heightPx - BASE_PX - z * pxPerM };
}

/** The strip without vehicles. */
export function drawSideGround(pen: Pen, camera: Camera, side: SideScale, palette: Palette, overlays: Iterable<Overlay>, colours: Colours): void {
  within(pen, camera, side, () => {
    pen.fillStyle = palette.surface;
    pen.fillRect(0, side.topPx, camera.widthPx, side.heightPx);
    heightLines(pen, camera, palette, side);
    for (const overlay of overlays) drawPaths(pen, camera, palette, overlay, colours, side);
  });
}

/** The vehicles, each at its height on a line from the ground. */
export function drawSideBodies(
  pen: Pen,
  camera: Camera,
  side: SideScale,
  palette: Palette,
  bodies: readonly Body[],
  colourOf: (body: Body) => string,
  sprites: Sprites,
): void {
  within(pen, camera, side, () => {
    pen.fillStyle = palette.axis;
    for (const body of bodies) lineDown(pen, toScreenX(camera, body.x), side.yOf(0), side.yOf(body.z));
    for (const body of bodies) {
      const radiusPx = body.selected ? SELECTED_PX : BODY_PX;
      const colour = colourOf(body);
      sprites.draw(pen, `side${radiusPx}${colour}`, radiusPx + 1, toScreenX(camera, body.x), side.yOf(body.z), (on) => {
        on.fillStyle = colour;
        on.beginPath();
        on.arc(0, 0, radiusPx, 0, 7);
        on.fill();
      });
    }
  });
}

function within(pen: Pen, camera: Camera, { topPx, heightPx }: SideScale, drawing: () => void): void {
  pen.save();
  pen.beginPath();
  pen.rect(0, topPx, camera.widthPx, heightPx);
  pen.clip();
  drawing();
  pen.restore();
}

function heightLines(pen: Pen, camera: Camera, palette: Palette, { topM, pxPerM, yOf }: SideScale): void {
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

function drawPaths(pen: Pen, camera: Camera, palette: Palette, overlay: Overlay, colours: Colours, { yOf }: SideScale): void {
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
