// Paths by their colours: with two hundred vehicles the number of strokes is what costs.

import type { Pen } from "./sprites.ts";

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
