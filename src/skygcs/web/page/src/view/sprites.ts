// Small pictures of what is drawn in many places: each drawn once. In software rendering a picture of 26 pixels costs a
// tenth of the same shape as a path: measured 0.3 against 3.5 ms for 200 vehicles.


/** Noses are drawn to the nearest of so many directions: 3 degrees apart. */
export const DIRECTIONS = 120;
/** Directions of one shape lie on one sheet, so many in a row. */
const COLUMNS = 12;
/** More than there are shapes and colours; beyond, all are drawn anew. */
const MAX_SHEETS = 64;

export type Pen = CanvasRenderingContext2D | OffscreenCanvasRenderingContext2D;

/** Draws a shape about 0, 0; one that has directions, in this one. */
export type Drawing = (pen: Pen, direction: number) => void;

interface Sheet {
  picture: Picture;
  /** Of one picture on it, in pixels of the screen. */
  size: number;
}

export class Sprites {
  private readonly sheets = new Map<string, Sheet>();
  private ratio = 1;

  /** Colours or the screen changed. */
  clear(ratio: number): void {
    this.ratio = ratio;
    for (const { picture } of this.sheets.values()) discard(picture);
    this.sheets.clear();
  }

  /** Draws the shape of this key, which is within `reachPx` of its middle, with its middle at x, y. Null: it has no directions. */
  draw(pen: Pen, key: string, reachPx: number, x: number, y: number, drawing: Drawing, direction: number | null = null): void {
    let sheet = this.sheets.get(key);
    if (sheet === undefined) {
      if (this.sheets.size >= MAX_SHEETS) this.clear(this.ratio);
      const made = this.made(reachPx, drawing, direction === null ? 1 : DIRECTIONS);
      if (made === null) return;
      sheet = made;
      this.sheets.set(key, sheet);
    }
    const { picture, size } = sheet;
    const sizePx = size / this.ratio;
    // on whole pixels of the screen: between two of them it would be blurred, and slow
    const left = Math.round((x - sizePx / 2) * this.ratio) / this.ratio;
    const top = Math.round((y - sizePx / 2) * this.ratio) / this.ratio;
    const [column, row] = [(direction ?? 0) % COLUMNS, Math.floor((direction ?? 0) / COLUMNS)];
    pen.drawImage(picture, column * size, row * size, size, size, left, top, sizePx, sizePx);
  }

  private made(reachPx: number, drawing: Drawing, count: number): Sheet | null {
    const size = 2 * Math.ceil(reachPx * this.ratio);
    const canvas = pictureCanvas(size * Math.min(count, COLUMNS), size * Math.ceil(count / COLUMNS));
    if (canvas === null) return null;
    const { pen } = canvas;
    for (let i = 0; i < count; i++) {
      pen.setTransform(this.ratio, 0, 0, this.ratio, ((i % COLUMNS) + 0.5) * size, (Math.floor(i / COLUMNS) + 0.5) * size);
      pen.save();
      drawing(pen, i);
      pen.restore();
    }
    return { picture: canvas.take(), size };
  }
}

/** Which of the directions is nearest to an angle. */
export function directionOf(yawRad: number): number {
  const step = Math.round((yawRad / (2 * Math.PI)) * DIRECTIONS) % DIRECTIONS;
  return step < 0 ? step + DIRECTIONS : step;
}

/** The angle of a direction. */
export function angleOf(direction: number): number {
  return (direction / DIRECTIONS) * 2 * Math.PI;
}

/** It does not change: of a canvas that might, Chromium takes a copy each time it is drawn. */
export type Picture = ImageBitmap | HTMLCanvasElement;

export interface PictureCanvas {
  pen: Pen;
  /** What is drawn now; the canvas is empty then. */
  take: () => Picture;
}

/** Elements that are drawn on: a picture that could not be copied off is the canvas itself, and stays. */
const drawnOn = new WeakSet<Picture>();

/** Null: this browser draws nothing in two dimensions. */
export function pictureCanvas(widthPx: number, heightPx: number): PictureCanvas | null {
  return offscreen(widthPx, heightPx) ?? onElement(widthPx, heightPx);
}

/** Frees what a picture holds. A browser keeps the pixels of a canvas until it is collected; those of an empty one it frees. */
export function discard(picture: Picture): void {
  if ("close" in picture) picture.close();
  else if (!drawnOn.has(picture)) picture.width = picture.height = 0;
}

function offscreen(widthPx: number, heightPx: number): PictureCanvas | null {
  try {
    const canvas = new OffscreenCanvas(widthPx, heightPx);
    const pen = canvas.getContext("2d");
    return pen === null ? null : { pen, take: () => canvas.transferToImageBitmap() };
  } catch {
    return null; // it has no such canvas, or one without this context
  }
}

function onElement(widthPx: number, heightPx: number): PictureCanvas | null {
  const made = (): CanvasRenderingContext2D | null => {
    const canvas = document.createElement("canvas");
    canvas.width = widthPx;
    canvas.height = heightPx;
    return canvas.getContext("2d");
  };
  const pen = made();
  if (pen === null) return null;
  drawnOn.add(pen.canvas);
  const take = (): HTMLCanvasElement => {
    const copy = made();
    if (copy === null) return pen.canvas;
    copy.drawImage(pen.canvas, 0, 0);
    pen.save();
    pen.resetTransform();
    pen.clearRect(0, 0, widthPx, heightPx);
    pen.restore();
    return copy.canvas;
  };
  return { pen, take };
}

export class Paths {
  private readonly byColour = new Map<string, Path2D>();

  of(colour: string): Path2D {
    let path = this.byColour.get(colour);
    if (path === undefined) this.byColour.set(colour, (path = new Path2D()));
    return path;
  }

  fill(pen: Pen): void {
    for (const [colour, path] of this.byColour) {
      pen.fillStyle = colour;
      pen.fill(path);
    }
  }

  stroke(pen: Pen, widthPx: number, alpha: number): void {
    pen.lineWidth = widthPx;
    pen.lineJoin = "round";
    pen.globalAlpha = alpha;
    for (const [colour, path] of this.byColour) {
      pen.strokeStyle = colour;
      pen.stroke(path);
    }
    pen.globalAlpha = 1;
  }
}
