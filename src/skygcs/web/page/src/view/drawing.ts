// Drawing on the canvas. Everything of one colour is one path.

import type { Camera } from "./camera.ts";
import { lengthText, niceLengthM, toScreenX, toScreenY, toWorld } from "./camera.ts";
import { ringAt, spacingPx, type Ring } from "./crowding.ts";
import { arrowText, type Arrow } from "./edge_arrows.ts";
import type { Frame } from "./frame.ts";
import { leaderOf, type Box, type Placement } from "./labels.ts";
import { MAX_POINTS, type Overlay, type Shape } from "./overlays.ts";
import type { Palette } from "./palette.ts";
import { angleOf, directionOf, type Drawing, Paths, type Pen, type Sprites } from "./sprites.ts";
import type { Body, Meeting } from "./scene.ts";
import { TRAIL_JUMP_M, type Trail, type Trails } from "../trails.ts";

const GRID_PX = 96;
/** The scale bar is as long at most. */
const SCALE_PX = 140;
const GLYPH_PX = 9;
const GLYPH_REACH_PX = 7;
/** How far the pictures of a vehicle and of a home reach from their middles. */
const BODY_PX = 14;
const HOME_PX = 8;
/** Around a vehicle; a dot's are half as large. */
const SELECTED: Ring = { radiusPx: 15, widthPx: 2 };
const TROUBLE: Ring = { radiusPx: 19, widthPx: 2.5 };
const LOST_DASH = [6, 4];
/** How far the sign beside a vehicle in trouble reaches from its middle, and where that is: on the ring, upper right. */
const SIGN_PX = 8;
const SIGN_AT = Math.SQRT1_2;
/** So small may the ring of many selected vehicles become: a little of it still shows beside the vehicle. */
const LEAST_RING = 0.6;

export function drawGrid(pen: Pen, camera: Camera, palette: Palette): void {
  const major = niceLengthM(camera.pxPerM, GRID_PX * 2);
  const minor = niceLengthM(camera.pxPerM, GRID_PX / 2);
  gridLines(pen, camera, minor, palette.gridMinor);
  gridLines(pen, camera, major, palette.gridMajor);
  pen.fillStyle = palette.axis;
  lineDown(pen, toScreenX(camera, 0), 0, camera.heightPx);
  lineAcross(pen, camera, toScreenY(camera, 0));
}

function gridLines(pen: Pen, camera: Camera, step: number, colour: string): void {
  const { x: left, y: top } = toWorld(camera, 0, 0);
  const { x: right, y: bottom } = toWorld(camera, camera.widthPx, camera.heightPx);
  pen.fillStyle = colour;
  for (let i = Math.ceil(left / step); i * step <= right; i++) lineDown(pen, toScreenX(camera, i * step), 0, camera.heightPx);
  for (let i = Math.ceil(bottom / step); i * step <= top; i++) lineAcross(pen, camera, toScreenY(camera, i * step));
}

/** Thin upright and level lines are filled: a stroke of them is smoothed over all of the canvas, which costs a millisecond. */
export function lineDown(pen: Pen, xPx: number, fromPx: number, toPx: number): void {
  pen.fillRect(Math.round(xPx), fromPx, 1, toPx - fromPx);
}

export function lineAcross(pen: Pen, camera: Camera, yPx: number): void {
  pen.fillRect(0, Math.round(yPx), camera.widthPx, 1);
}

/** Where `drawScale` draws: no label is put there. */
export function scaleBoxes(camera: Camera): Box[] {
  const { heightPx } = camera;
  const widthPx = niceLengthM(camera.pxPerM, SCALE_PX) * camera.pxPerM;
  return [
    { left: 0, top: heightPx - 42, right: 24 + widthPx, bottom: heightPx - 14 },
    { left: 4, top: heightPx - 114, right: 64, bottom: heightPx - 46 },
  ];
}

/** Where `drawAttribution` draws, about: a letter is some 6 pixels wide. */
export function attributionBox(camera: Camera, text: string): Box[] {
  const { widthPx, heightPx } = camera;
  return text === "" ? [] : [{ left: widthPx - 16 - 6 * text.length, top: heightPx - 22, right: widthPx, bottom: heightPx }];
}

/** Strokes the path. */
function strokeAs(pen: Pen, colour: string, widthPx: number): void {
  pen.strokeStyle = colour;
  pen.lineWidth = widthPx;
  pen.stroke();
}

/** Fills the path. */
function fillAs(pen: Pen, colour: string): void {
  pen.fillStyle = colour;
  pen.fill();
}

/** Begins a path: a circle. */
function circle(pen: Pen, x: number, y: number, radius: number): void {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
}

/** How the next texts are written, and which of their corners their places are. */
function lettering(pen: Pen, font: string, align: CanvasTextAlign, baseline: CanvasTextBaseline): void {
  pen.font = font;
  pen.textAlign = align;
  pen.textBaseline = baseline;
}

/** Begins a path through these points. */
function trace(pen: Pen, points: readonly (readonly [number, number])[]): void {
  pen.beginPath();
  for (const [x, y] of points) pen.lineTo(x, y);
}

/** Scale bar, north, and where the axes point, on the lower left; above the side view if there is one. */
export function drawScale(pen: Pen, camera: Camera, palette: Palette, frame: Frame | null): void {
  const length = niceLengthM(camera.pxPerM, SCALE_PX);
  const widthPx = length * camera.pxPerM;
  const x = 20;
  const y = camera.heightPx - 20;
  pen.lineWidth = 2;
  pen.strokeStyle = palette.text;
  pen.lineCap = "butt";
  trace(pen, [[x, y - 5], [x, y], [x + widthPx, y], [x + widthPx, y - 5]]);
  pen.stroke();
  lettering(pen, `12px ${palette.font}`, "left", "bottom");
  haloText(pen, lengthText(length), x + 4, y - 5, palette.text, palette.ground);
  drawNorth(pen, 34, camera.heightPx - 78, palette, frame);
}

/** Lines from vehicles to labels that have no room beside them. */
export function drawLeaders(pen: Pen, camera: Camera, palette: Palette, led: readonly { body: Body; at: Placement; widthPx: number }[]): void {
  if (led.length === 0) return;
  pen.beginPath();
  for (const { body, at, widthPx } of led) {
    const { from, to } = leaderOf(at, widthPx, reachOf(body));
    const [x, y] = [toScreenX(camera, body.x), toScreenY(camera, body.y)];
    pen.moveTo(x + from[0], y + from[1]);
    pen.lineTo(x + to[0], y + to[1]);
  }
  strokeAs(pen, palette.muted, 1);
}

/** Whom the map is from, on the lower right. */
export function drawAttribution(pen: Pen, camera: Camera, palette: Palette, text: string): void {
  if (text === "") return;
  lettering(pen, `11px ${palette.font}`, "right", "bottom");
  haloText(pen, text, camera.widthPx - 8, camera.heightPx - 5, palette.text, palette.ground);
}

function drawNorth(pen: Pen, x: number, y: number, palette: Palette, frame: Frame | null): void {
  // the frame's x axis is to the right: north is turned from up by what the axis is turned from east
  const turn = (((frame?.x_heading_deg ?? 90) - 90) * Math.PI) / 180;
  pen.save();
  pen.translate(x, y);
  pen.rotate(-turn);
  for (const [side, colour] of [[6, palette.text], [-6, palette.muted]] as const) {
    trace(pen, [[0, -18], [side, 4], [0, 0]]);
    pen.closePath();
    fillAs(pen, colour);
  }
  pen.restore();
  lettering(pen, `600 11px ${palette.font}`, "center", "middle");
  haloText(pen, "N", x - Math.sin(turn) * 26, y - Math.cos(turn) * 26, palette.text, palette.ground);
}

export function haloText(pen: Pen, text: string, x: number, y: number, colour: string, halo: string): void {
  pen.lineWidth = 3;
  pen.lineJoin = "round";
  pen.strokeStyle = halo;
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}

const TRAIL_PX = 1.5;
const TRAIL_ALPHA = 0.75;

/** All trails on a layer of their own. The older half is fainter. */
export function drawTrails(pen: Pen, camera: Camera, trails: Trails, colours: Colours, lost: string): void {
  const [old, recent] = [new Paths(), new Paths()];
  for (const [name, trail] of trails.byName) {
    const colour = colours.get(name) ?? lost;
    tracePoints(camera, trail, { old: old.of(colour), recent: recent.of(colour) });
    trail.drawn = trail.added;
  }
  old.stroke(pen, TRAIL_PX, 0.3);
  recent.stroke(pen, TRAIL_PX, TRAIL_ALPHA);
}

/** Adds what has come since to the layer that `drawTrails` has drawn. */
export function extendTrails(pen: Pen, camera: Camera, trails: Trails, colours: Colours, lost: string): void {
  const paths = new Paths();
  for (const [name, trail] of trails.byName) {
    if (trail.drawn === trail.added) continue;
    const path = paths.of(colours.get(name) ?? lost);
    if (trail.drawnEnd !== null) path.moveTo(toScreenX(camera, trail.drawnEnd[0]), toScreenY(camera, trail.drawnEnd[1]));
    trail.each((x, y, _z, joined) => {
      if (joined) path.lineTo(toScreenX(camera, x), toScreenY(camera, y));
      else path.moveTo(toScreenX(camera, x), toScreenY(camera, y));
      trail.drawnEnd = [x, y];
    }, trail.added - trail.drawn);
    trail.drawn = trail.added;
  }
  paths.stroke(pen, TRAIL_PX, TRAIL_ALPHA);
}

function tracePoints(camera: Camera, trail: Trail, paths: { old: Path2D; recent: Path2D }): void {
  const half = trail.length / 2;
  let index = 0;
  let lastX = 0;
  let lastY = 0;
  trail.each((x, y, _z, joined) => {
    const [px, py] = [toScreenX(camera, x), toScreenY(camera, y)];
    const path = index < half ? paths.old : paths.recent;
    const turned = index - 1 < half && index >= half;
    index += 1;
    if (!joined) {
      path.moveTo(px, py);
    } else {
      if (turned) path.moveTo(lastX, lastY);
      else if (index < trail.length && Math.abs(px - lastX) + Math.abs(py - lastY) < 3) return;
      path.lineTo(px, py);
    }
    lastX = px;
    lastY = py;
    trail.drawnEnd = [x, y];
  });
}

/** The colours of vehicles by their names. */
export type Colours = ReadonlyMap<string, string>;

export function colourOfShape(shape: Shape, palette: Palette, colours: Colours): string {
  const own = shape.kind === "circle" || shape.vehicle === undefined ? undefined : colours.get(shape.vehicle);
  return own ?? palette.inks[shape.ink];
}

export function drawOverlays(pen: Pen, camera: Camera, palette: Palette, overlays: Iterable<Overlay>, colours: Colours): void {
  let left = MAX_POINTS;
  for (const overlay of overlays) {
    for (const shape of overlay.shapes) {
      left -= shape.kind === "path" ? shape.points.length : 1;
      if (left < 0) return;
      drawShape(pen, camera, palette, shape, colourOfShape(shape, palette, colours));
    }
  }
}

function drawShape(pen: Pen, camera: Camera, palette: Palette, shape: Shape, colour: string): void {
  if (shape.kind === "mark") {
    drawMark(pen, toScreenX(camera, shape.at[0]), toScreenY(camera, shape.at[1]), colour, palette, shape);
    return;
  }
  pen.strokeStyle = colour;
  pen.lineWidth = shape.kind === "path" ? (shape.widthPx ?? 2) : 2;
  pen.lineJoin = "round";
  pen.setLineDash(shape.dashed === true ? [7, 5] : []);
  pen.beginPath();
  if (shape.kind === "circle") {
    pen.arc(toScreenX(camera, shape.centre[0]), toScreenY(camera, shape.centre[1]), shape.radiusM * camera.pxPerM, 0, 7);
  } else {
    for (const point of shape.points) pen.lineTo(toScreenX(camera, point[0]), toScreenY(camera, point[1]));
    if (shape.closed === true) pen.closePath();
  }
  if (shape.filled === true) {
    pen.globalAlpha = 0.08;
    fillAs(pen, colour);
    pen.globalAlpha = 1;
  }
  pen.stroke();
  pen.setLineDash([]);
}

function drawMark(pen: Pen, x: number, y: number, colour: string, palette: Palette, mark: Extract<Shape, { kind: "mark" }>): void {
  const r = mark.emphasised === true ? 8 : 6;
  pen.lineWidth = 2;
  pen.strokeStyle = colour;
  pen.fillStyle = colour;
  pen.beginPath();
  switch (mark.symbol) {
    case "start":
      pen.rect(x - r + 1, y - r + 1, 2 * r - 2, 2 * r - 2);
      pen.stroke();
      break;
    case "goal":
      pen.arc(x, y, r, 0, 7);
      pen.moveTo(x + 2, y);
      pen.arc(x, y, 2, 0, 7);
      pen.stroke();
      break;
    case "waypoint":
    case "handle":
      pen.arc(x, y, mark.symbol === "handle" ? r + 1 : r - 1, 0, 7);
      fillAs(pen, mark.symbol === "handle" ? palette.surface : colour);
      pen.stroke();
      break;
    case "home":
      homePath(pen, x, y, r);
      pen.stroke();
      break;
    case "cross":
      pen.moveTo(x - r, y - r);
      pen.lineTo(x + r, y + r);
      pen.moveTo(x - r, y + r);
      pen.lineTo(x + r, y - r);
      pen.stroke();
      break;
    case "ghost":
      dart(pen, x, y, mark.yawRad ?? Math.PI / 2, GLYPH_PX);
      pen.stroke();
      break;
  }
  if (mark.text !== undefined && mark.text !== "") {
    lettering(pen, `600 11px ${palette.font}`, "left", "middle");
    haloText(pen, mark.text, x + r + 5, y, colour, palette.ground);
  }
}

function homePath(pen: Pen, x: number, y: number, r: number): void {
  pen.moveTo(x - r - 1, y);
  pen.lineTo(x, y - r);
  pen.lineTo(x + r + 1, y);
  pen.moveTo(x - r + 2, y - 1);
  pen.lineTo(x - r + 2, y + r);
  pen.lineTo(x + r - 2, y + r);
  pen.lineTo(x + r - 2, y - 1);
}

/** Homes of all vehicles, those at one place once. */
export function drawHomes(pen: Pen, camera: Camera, palette: Palette, homes: Iterable<readonly [number, number]>, sprites: Sprites): void {
  const seen = new Set<number>();
  for (const [x, y] of homes) {
    const [px, py] = [toScreenX(camera, x), toScreenY(camera, y)];
    if (px < -HOME_PX || py < -HOME_PX || px > camera.widthPx + HOME_PX || py > camera.heightPx + HOME_PX) continue;
    const key = Math.round(px / 14) * 100_003 + Math.round(py / 14);
    if (seen.has(key)) continue;
    seen.add(key);
    sprites.draw(pen, "home", HOME_PX, px, py, (on) => {
      on.strokeStyle = palette.muted;
      on.lineWidth = 1.25;
      on.globalAlpha = 0.7;
      on.beginPath();
      homePath(on, 0, 0, 4);
      on.stroke();
    });
  }
}

/** The origin of the frame: a small cross of its two axes. */
export function drawOrigin(pen: Pen, camera: Camera, palette: Palette): void {
  const [x, y] = [toScreenX(camera, 0), toScreenY(camera, 0)];
  circle(pen, x, y, 4);
  strokeAs(pen, palette.muted, 1.5);
}

/** From the end of each trail to where its vehicle is now: the trails' layer is some tenths of a second old. */
export function drawTrailEnds(pen: Pen, camera: Camera, trails: Trails, bodies: readonly Body[], colourOf: (body: Body) => string): void {
  const paths = new Paths();
  for (const body of bodies) {
    const from = trails.byName.get(body.name)?.drawnEnd;
    if (from === undefined || from === null || !body.heard) continue;
    if (Math.hypot(body.x - from[0], body.y - from[1]) > TRAIL_JUMP_M) continue;
    const path = paths.of(colourOf(body));
    path.moveTo(toScreenX(camera, from[0]), toScreenY(camera, from[1]));
    path.lineTo(toScreenX(camera, body.x), toScreenY(camera, body.y));
  }
  paths.stroke(pen, TRAIL_PX, TRAIL_ALPHA);
}

/** From each vehicle to where it is sent. */
export function drawGoals(pen: Pen, camera: Camera, bodies: readonly Body[], colourOf: (body: Body) => string): void {
  pen.setLineDash([2, 4]);
  pen.lineWidth = 1.5;
  for (const body of bodies) {
    if (body.goal === null || !body.heard) continue;
    pen.strokeStyle = colourOf(body);
    const [x, y] = [toScreenX(camera, body.goal[0]), toScreenY(camera, body.goal[1])];
    pen.beginPath();
    pen.moveTo(toScreenX(camera, body.x), toScreenY(camera, body.y));
    pen.lineTo(x, y);
    pen.moveTo(x + 5, y);
    pen.arc(x, y, 5, 0, 7);
    pen.stroke();
  }
  pen.setLineDash([]);
}

export function drawMeetings(pen: Pen, camera: Camera, palette: Palette, meetings: readonly Meeting[]): void {
  for (const { a, b, separation, x, y } of meetings) {
    const colour = separation.level === "notice" ? palette.warning : palette.danger;
    const [mx, my] = [toScreenX(camera, x), toScreenY(camera, y)];
    pen.strokeStyle = colour;
    pen.lineWidth = separation.level === "notice" ? 1.5 : 2.5;
    pen.setLineDash([5, 4]);
    pen.beginPath();
    pen.moveTo(toScreenX(camera, a.x), toScreenY(camera, a.y));
    pen.lineTo(mx, my);
    pen.lineTo(toScreenX(camera, b.x), toScreenY(camera, b.y));
    pen.stroke();
    pen.setLineDash([]);
    if (separation.closest_m === undefined || separation.closest_in_s === undefined) continue;
    const radius = Math.max(((separation.margin_m ?? 0) / 2) * camera.pxPerM, 9);
    circle(pen, mx, my, radius);
    pen.stroke();
    lettering(pen, `600 12px ${palette.font}`, "center", "bottom");
    const text = `${separation.closest_m.toFixed(1)} m in ${separation.closest_in_s.toFixed(0)} s`;
    haloText(pen, text, mx, my - radius - 4, colour, palette.ground);
  }
}

/** Where vehicles are that are off the screen. */
export function drawArrows(pen: Pen, camera: Camera, palette: Palette, arrows: readonly Arrow[], colourOf: (name: string) => string): void {
  pen.font = `600 11px ${palette.font}`;
  pen.textBaseline = "middle";
  for (const arrow of arrows) {
    const { xPx, yPx, angleRad } = arrow;
    const colour = colourOf(arrow.names[0] ?? "");
    pen.beginPath();
    dart(pen, xPx, yPx, -angleRad, GLYPH_PX);
    strokeAs(pen, palette.ground, 3);
    fillAs(pen, colour);
    // towards the middle, where there is room
    const right = xPx > camera.widthPx / 2;
    pen.textAlign = right ? "right" : "left";
    haloText(pen, arrowText(arrow), xPx + (right ? -15 : 15), yPx, palette.text, palette.ground);
  }
}

/** How far a vehicle's marks reach from its middle. */
export function reachOf({ trouble }: Body): number {
  return trouble === null ? GLYPH_REACH_PX : TROUBLE.radiusPx;
}

/** Arrowheads that point where the nose points; filled if armed. Those whose nose is not known are round. */
export function drawBodies(
  pen: Pen,
  camera: Camera,
  palette: Palette,
  bodies: readonly Body[],
  colourOf: (body: Body) => string,
  sprites: Sprites,
): void {
  selectionRings(pen, camera, palette, bodies);
  for (const filled of [true, false]) {
    for (const body of bodies) {
      if ((body.armed && body.heard) !== filled) continue;
      const colour = colourOf(body);
      const direction = body.yawRad === null ? null : directionOf(body.yawRad);
      const key = `${filled ? "f" : "h"}${direction === null ? "" : "d"}${colour}`;
      const drawing: Drawing = (on, one) => drawBody(on, palette, direction === null ? null : angleOf(one), colour, filled);
      sprites.draw(pen, key, BODY_PX, toScreenX(camera, body.x), toScreenY(camera, body.y), drawing, direction);
    }
  }
  troubleRings(pen, camera, palette, bodies);
  troubleSigns(pen, camera, palette, bodies, sprites);
}

/** Many vehicles, from afar: dots, smaller of what is on the ground. */
export function drawDots(pen: Pen, camera: Camera, palette: Palette, bodies: readonly Body[], colourOf: (body: Body) => string): void {
  selectionRings(pen, camera, palette, bodies, 0.5);
  const paths = new Paths();
  for (const body of bodies) {
    const half = body.armed && body.heard ? 3 : 2;
    paths.of(colourOf(body)).rect(Math.round(toScreenX(camera, body.x)) - half, Math.round(toScreenY(camera, body.y)) - half, 2 * half, 2 * half);
  }
  paths.fill(pen);
  troubleRings(pen, camera, palette, bodies, 0.5);
}

function drawBody(pen: Pen, palette: Palette, yawRad: number | null, colour: string, filled: boolean): void {
  pen.lineJoin = "round";
  pen.beginPath();
  if (yawRad === null) pen.arc(0, 0, 6, 0, 7);
  else dart(pen, 0, 0, yawRad, GLYPH_PX);
  pen.fillStyle = filled ? colour : palette.ground;
  pen.strokeStyle = filled ? palette.ground : colour;
  pen.lineWidth = filled ? 2.5 : 1.75;
  if (filled) pen.stroke(); // beneath: it only parts the vehicle from what is behind it
  pen.fill();
  if (!filled) pen.stroke();
}

/** Beneath the vehicles, and the smaller the closer together they are: the rings of a dense fleet would hide it. */
function selectionRings(pen: Pen, camera: Camera, palette: Palette, bodies: readonly Body[], scale = 1): void {
  const selected = bodies.filter((body) => body.selected);
  const ring = ringAt(SELECTED, spacingPx(selected, camera.pxPerM) / scale, LEAST_RING);
  circles(pen, camera, selected, ring.radiusPx * scale, ring.widthPx, palette.selection);
}

/** Above the vehicles, and of full size however many there are: they need a person. Dashed where a vehicle was lost in
 *  the air: it is not known to be there. */
function troubleRings(pen: Pen, camera: Camera, palette: Palette, bodies: readonly Body[], scale = 1): void {
  const inDanger = bodies.filter(({ trouble }) => trouble?.severity === "danger");
  const radius = TROUBLE.radiusPx * scale;
  circles(pen, camera, inDanger.filter(({ lostInAir }) => !lostInAir), radius, TROUBLE.widthPx, palette.danger);
  pen.setLineDash(LOST_DASH);
  circles(pen, camera, inDanger.filter(({ lostInAir }) => lostInAir), radius, TROUBLE.widthPx, palette.danger);
  pen.setLineDash([]);
}

/** A sign of its own shape on the ring of each vehicle in trouble: a triangle, or a cross where it was lost in the air. Of
 *  one that is silent on the ground the triangle stands alone. */
function troubleSigns(pen: Pen, camera: Camera, palette: Palette, bodies: readonly Body[], sprites: Sprites): void {
  for (const { trouble, lostInAir, x, y } of bodies) {
    if (trouble === null) continue;
    const colour = trouble.severity === "danger" ? palette.danger : palette.warning;
    const atX = toScreenX(camera, x) + TROUBLE.radiusPx * SIGN_AT;
    const atY = toScreenY(camera, y) - TROUBLE.radiusPx * SIGN_AT;
    const sign = lostInAir ? crossSign : triangleSign;
    sprites.draw(pen, `${sign.name}${colour}`, SIGN_PX, atX, atY, (on) => sign(on, palette.ground, colour));
  }
}

/** A disc with a cross on it, about 0, 0. */
function crossSign(pen: Pen, ground: string, colour: string): void {
  circle(pen, 0, 0, 6.5);
  fillAs(pen, colour);
  pen.strokeStyle = ground;
  pen.lineWidth = 2;
  trace(pen, [[-2.5, -2.5], [2.5, 2.5]]);
  pen.moveTo(2.5, -2.5);
  pen.lineTo(-2.5, 2.5);
  pen.stroke();
}

/** A triangle with an exclamation mark on it, about 0, 0. */
function triangleSign(pen: Pen, ground: string, colour: string): void {
  pen.fillStyle = colour;
  trace(pen, [[0, -7], [7.5, 6], [-7.5, 6]]);
  pen.closePath();
  pen.fill();
  pen.strokeStyle = ground;
  pen.lineWidth = 1.75;
  trace(pen, [[0, -3], [0, 2]]);
  pen.moveTo(0, 3.25);
  pen.lineTo(0, 5);
  pen.stroke();
}

function circles(pen: Pen, camera: Camera, bodies: readonly Body[], radius: number, width: number, colour: string): void {
  if (bodies.length === 0) return;
  pen.beginPath();
  for (const body of bodies) {
    const [x, y] = [toScreenX(camera, body.x), toScreenY(camera, body.y)];
    pen.moveTo(x + radius, y);
    pen.arc(x, y, radius, 0, 7);
  }
  strokeAs(pen, colour, width);
}

function dart(path: Path2D | Pen, x: number, y: number, yawRad: number, size: number): void {
  const c = Math.cos(yawRad);
  const s = -Math.sin(yawRad); // the screen's y runs down
  const point = (along: number, across: number): [number, number] => [x + along * c - across * s, y + along * s + across * c];
  path.moveTo(...point(size * 1.25, 0));
  path.lineTo(...point(-size * 0.8, size * 0.8));
  path.lineTo(...point(-size * 0.4, 0));
  path.lineTo(...point(-size * 0.8, -size * 0.8));
  path.closePath();
}
