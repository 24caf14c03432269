// Names and numbers beside vehicles: each drawn once into a small picture of its own, and placed where it covers no other.

import type { Palette } from "./palette.ts";
import { discard, type Pen, type Picture, pictureCanvas, type PictureCanvas } from "./sprites.ts";

const WIDTH_PX = 132;
const HEIGHT_PX = 32;
const LINE_PX = 14;
const PAD_PX = 3;
const MAX_SPRITES = 400;
/** The numbers of a label change at most so often: nobody reads faster, and text is what costs. */
const REWRITE_MS = 250;
/** And at most so many in one frame: two hundred at once would be a pause that is seen. */
const REWRITES_A_FRAME = 20;

interface Sprite {
  picture: Picture;
  key: string;
  writtenMs: number;
  widthPx: number;
  /** Of the first line alone. */
  nameWidthPx: number;
}

/** Of the second line: danger is said in words, and in red besides. */
export type LabelTone = "plain" | "dim" | "danger";

export class LabelSprites {
  private readonly sprites = new Map<string, Sprite>();
  private canvas: PictureCanvas | null = null;
  private ratio = 1;
  private rewritesLeft = 0;

  beginFrame(): void {
    this.rewritesLeft = REWRITES_A_FRAME;
  }

  /** Colours, fonts or the screen changed. */
  clear(ratio: number): void {
    this.ratio = ratio;
    this.canvas = pictureCanvas(Math.ceil(WIDTH_PX * ratio), Math.ceil(HEIGHT_PX * ratio));
    this.sprites.clear(); // not closed: those of the frame that is being drawn are still needed
  }

  /** The picture of a label and its width. */
  get(id: string, first: string, second: string, tone: LabelTone, palette: Palette, nowMs: number): Sprite | null {
    const key = `${first}|${second}|${tone}`;
    let sprite = this.sprites.get(id);
    if (sprite !== undefined) {
      const rests = sprite.key === key || nowMs - sprite.writtenMs < REWRITE_MS || this.rewritesLeft <= 0;
      if (rests) return sprite;
    }
    this.rewritesLeft -= 1;
    if (sprite === undefined && this.sprites.size >= MAX_SPRITES) this.clear(this.ratio);
    if (this.canvas === null) return null;
    if (sprite !== undefined) discard(sprite.picture);
    sprite = { ...this.written(this.canvas, first, second, tone, palette), key, writtenMs: nowMs };
    this.sprites.set(id, sprite);
    return sprite;
  }

  private written({ pen, take }: PictureCanvas, first: string, second: string, tone: LabelTone, palette: Palette): Omit<Sprite, "key" | "writtenMs"> {
    pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    const strong = `600 12px ${palette.font}`;
    const plain = `11px ${palette.font}`;
    pen.textBaseline = "top";
    pen.font = plain;
    const under = pen.measureText(second).width;
    pen.font = strong;
    const name = shortened(pen, first, WIDTH_PX - 2 * PAD_PX);
    const over = pen.measureText(name).width;
    const widthPx = Math.min(Math.max(over, under) + 2 * PAD_PX, WIDTH_PX);
    // a ground of its own: lines of the view run beneath it, not through it
    pen.fillStyle = palette.ground;
    pen.globalAlpha = 0.72;
    pen.fillRect(0, 1, widthPx, (second === "" ? LINE_PX : 2 * LINE_PX) + 2);
    pen.globalAlpha = 1;
    pen.fillStyle = tone === "dim" ? palette.lost : palette.text;
    pen.fillText(name, PAD_PX, 3);
    pen.font = plain;
    pen.fillStyle = { plain: palette.muted, dim: palette.lost, danger: palette.danger }[tone];
    pen.fillText(second, PAD_PX, 3 + LINE_PX, WIDTH_PX - 2 * PAD_PX);
    return { picture: take(), widthPx, nameWidthPx: over + 2 * PAD_PX };
  }
}

export const LABEL_HEIGHT_PX = HEIGHT_PX;
export const LABEL_WIDTH_PX = WIDTH_PX;

function shortened(pen: Pen, text: string, mostPx: number): string {
  if (pen.measureText(text).width <= mostPx) return text;
  let cut = text;
  while (cut.length > 1 && pen.measureText(`${cut}…`).width > mostPx) cut = cut.slice(0, -1);
  return `${cut}…`;
}

/** What of a label is drawn, and where: the upper left corner, relative to its vehicle. */
export interface Placement {
  dx: number;
  dy: number;
  full: boolean;
  /** It is so far off that a line joins it to its vehicle. */
  led: boolean;
}

/** A rectangle of the canvas. */
export interface Box {
  left: number;
  top: number;
  right: number;
  bottom: number;
}

export interface LabelRequest {
  id: string;
  xPx: number;
  yPx: number;
  widthPx: number;
  nameWidthPx: number;
  /** How far the vehicle's own marks reach from its middle: no label covers them. */
  reachPx: number;
  /** Its second line is shown in a crowd, too. */
  urgent: boolean;
}

const CELL_PX = 64;
/** Between a vehicle's marks and its label. */
const GAP_PX = 8;
/** In a crowd, with so many others within that distance, labels are names alone. One that has its second line keeps it until
 *  there is another one more, so that it does not come and go. */
const CROWD_PX = 90;
const CROWD = 4;
const NAME_HEIGHT_PX = LINE_PX + 3;
/** Where a name goes whose vehicle has no room beside it: rings of so many directions. */
const RINGS_PX = [34, 56, 80];
const RING_PLACES = 12;

/** Labels in the order of their importance: each gets the first place that is free, the one it had before; some get none.
 * `covered`: where buttons and marks of the view are. */
export function placeLabels(
  requests: readonly LabelRequest[],
  before: ReadonlyMap<string, Placement>,
  viewWidthPx: number,
  viewHeightPx: number,
  covered: readonly Box[] = [],
): Map<string, Placement> {
  const cells = new Map<number, Box[]>();
  const placed = new Map<string, Placement>();
  const crowd = crowdOf(requests);
  for (const box of covered) take(cells, box);
  for (const { xPx, yPx, reachPx } of requests) take(cells, { left: xPx - reachPx, top: yPx - reachPx, right: xPx + reachPx, bottom: yPx + reachPx });
  for (const request of requests) {
    const had = before.get(request.id);
    const names = !request.urgent && crowd(request) >= CROWD + (had?.full === true ? 1 : 0);
    for (const side of inTurn(had, request)) {
      if (side.full && names) continue;
      const box = boxOf(request, side);
      const inside = box.left >= 2 && box.top >= 2 && box.right <= viewWidthPx - 2 && box.bottom <= viewHeightPx - 2;
      if (!inside || !isFree(cells, box)) continue;
      take(cells, box);
      placed.set(request.id, side);
      break;
    }
  }
  return placed;
}

/** How wide a label is that is drawn whole, or its name alone. */
export function widthOf(label: { widthPx: number; nameWidthPx: number }, full: boolean): number {
  return full ? label.widthPx : label.nameWidthPx;
}

/** Counts the others near a vehicle. */
function crowdOf(requests: readonly LabelRequest[]): (request: LabelRequest) => number {
  const byCell = new Map<string, LabelRequest[]>();
  const keyOf = (i: number, j: number): string => `${i},${j}`;
  const cellOf = (px: number): number => Math.floor(px / CROWD_PX);
  for (const request of requests) {
    const key = keyOf(cellOf(request.xPx), cellOf(request.yPx));
    const list = byCell.get(key);
    if (list === undefined) byCell.set(key, [request]);
    else list.push(request);
  }
  return ({ xPx, yPx }) => {
    let count = -1; // itself
    for (let i = cellOf(xPx) - 1; i <= cellOf(xPx) + 1; i++) {
      for (let j = cellOf(yPx) - 1; j <= cellOf(yPx) + 1; j++) {
        for (const other of byCell.get(keyOf(i, j)) ?? []) if (Math.hypot(other.xPx - xPx, other.yPx - yPx) < CROWD_PX) count += 1;
      }
    }
    return count;
  };
}

/** Beside the vehicle whole, beside it as a name, farther off; of each kind the place it had before comes first. */
function* inTurn(had: Placement | undefined, request: LabelRequest): Generator<Placement> {
  if (had?.full === true) yield had;
  yield* sidesOf(request, true);
  if (had?.full === false && !had.led) yield had;
  yield* sidesOf(request, false);
  if (had?.led === true) yield had;
  yield* ringsOf(request);
}

function* ringsOf(request: LabelRequest): Generator<Placement> {
  const widthPx = request.nameWidthPx;
  for (const ringPx of RINGS_PX) {
    for (let n = 0; n < RING_PLACES; n++) {
      const angle = (n / RING_PLACES) * 2 * Math.PI - Math.PI / 4; // the upper right first
      const [x, y] = [Math.cos(angle), Math.sin(angle)];
      const farPx = request.reachPx + ringPx;
      yield { dx: x * (farPx + widthPx / 2) - widthPx / 2, dy: y * farPx - NAME_HEIGHT_PX / 2, full: false, led: true };
    }
  }
}

/** From a vehicle's middle to the nearest point of its label, relative to the vehicle; without what its marks cover. */
export function leaderOf({ dx, dy }: Placement, widthPx: number, reachPx: number): { from: [number, number]; to: [number, number] } {
  const clamped = (low: number, size: number): number => Math.min(Math.max(0, low), low + size);
  const to: [number, number] = [clamped(dx, widthPx), clamped(dy, NAME_HEIGHT_PX)];
  const share = reachPx / Math.max(Math.hypot(...to), 1);
  return { from: [to[0] * share, to[1] * share], to };
}

function sidesOf(request: LabelRequest, full: boolean): Placement[] {
  const gapPx = request.reachPx + GAP_PX;
  const widthPx = widthOf(request, full);
  const height = full ? HEIGHT_PX : NAME_HEIGHT_PX;
  const near = { full, led: false };
  return [
    { dx: gapPx, dy: -height / 2, ...near },
    { dx: -gapPx - widthPx, dy: -height / 2, ...near },
    { dx: -widthPx / 2, dy: gapPx, ...near },
    { dx: -widthPx / 2, dy: -gapPx - height, ...near },
  ];
}

function boxOf(request: LabelRequest, side: Placement): Box {
  const left = request.xPx + side.dx;
  const top = request.yPx + side.dy;
  return { left, top, right: left + widthOf(request, side.full), bottom: top + (side.full ? HEIGHT_PX : NAME_HEIGHT_PX) };
}

function cellsOf(box: Box): number[] {
  const found: number[] = [];
  for (let i = Math.floor(box.left / CELL_PX); i <= Math.floor(box.right / CELL_PX); i++) {
    for (let j = Math.floor(box.top / CELL_PX); j <= Math.floor(box.bottom / CELL_PX); j++) found.push(i * 100_003 + j);
  }
  return found;
}

function isFree(cells: ReadonlyMap<number, Box[]>, box: Box): boolean {
  return cellsOf(box).every((cell) =>
    (cells.get(cell) ?? []).every(
      (other) => other.right <= box.left || other.left >= box.right || other.bottom <= box.top || other.top >= box.bottom,
    ),
  );
}

function take(cells: Map<number, Box[]>, box: Box): void {
  for (const cell of cellsOf(box)) {
    const list = cells.get(cell);
    if (list === undefined) cells.set(cell, [box]);
    else list.push(box);
  }
}
