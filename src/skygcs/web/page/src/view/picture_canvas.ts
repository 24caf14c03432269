// A canvas that nobody sees, on which small pictures are drawn and taken off. A browser whose OffscreenCanvas draws nothing in two
// dimensions gets an element instead.

import type { Pen } from "./sprites.ts";

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
