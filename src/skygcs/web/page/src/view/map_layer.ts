// What lies beneath the fleet view: tiles of a file on the ground station, and an image that two points pin.

import type { Hello, TileFile } from "../types.ts";
import { toScreenX, toScreenY, type Camera } from "./camera.ts";
import { placeImage, type Frame } from "./frame.ts";
import { projectionOf, tilesSeen, tileTransform, zoomFor, type Tile } from "./mercator.ts";
import type { Palette } from "./palette.ts";
import type { Pen } from "./sprites.ts";
import { RETRY_MS, retryAfterMs, TileCache, type Kept } from "./tile_cache.ts";

/** Requests at once; a browser has six connections to one server, and the page needs one besides. */
const ASKED_AT_ONCE = 5;
/** Zooms above, of which a part stands in for a tile that has not come. */
const STAND_INS = 5;
/** Tiles overlap by so much of a pixel: no seam shows where the frame is turned. */
const OVERLAP_PX = 0.5;
/** How much of the ground's colour is over the tiles, so that what is drawn on them is read. */
const VEIL = { dark: 0.5, daylight: 0.3 };

export class MapLayer {
  private image: { bitmap: HTMLImageElement; pins: NonNullable<Hello["map"]>["points"]; url: string } | null = null;
  private file: TileFile | null = null;
  private readonly kept = new TileCache<ImageBitmap>();
  private wanted: readonly Tile[] = [];
  private asking = 0;

  /** `loaded` is called when there is more to draw. */
  constructor(private readonly loaded: () => void) {}

  /** Shows what the server has. */
  show(hello: Pick<Hello, "map" | "tiles"> | null): void {
    const map = hello?.map ?? null;
    if (map !== null && this.image?.url !== map.url) {
      const bitmap = new Image();
      bitmap.onload = this.loaded;
      bitmap.src = map.url;
      this.image = { bitmap, pins: map.points, url: map.url };
    }
    if (hello !== null && hello.tiles?.url !== this.file?.url) {
      this.file = hello.tiles ?? null;
      this.clear();
    }
  }

  draw(pen: Pen, camera: Camera, frame: Frame, ratio: number, palette: Palette): void {
    if (this.file !== null) this.drawTiles(pen, camera, frame, ratio, palette, this.file);
    this.drawImage(pen, camera, frame, ratio);
  }

  /** Whom the tiles are from, for the corner of the view. */
  get attribution(): string {
    return this.file?.attribution ?? "";
  }

  private clear(): void {
    this.kept.clear();
    this.wanted = [];
  }

  private drawTiles(pen: Pen, camera: Camera, frame: Frame, ratio: number, palette: Palette, file: TileFile): void {
    const projection = projectionOf(frame, camera);
    const zoom = zoomFor(projection, file.tile_px, file.min_zoom, file.max_zoom);
    const seen = tilesSeen(projection, zoom, camera.widthPx, camera.heightPx, file.bounds_deg);
    pen.save();
    // those that stand in are larger: beneath the others
    for (const whole of [false, true]) {
      for (const tile of seen) {
        const part = this.pictureOf(tile, file.min_zoom);
        if (part === null || (part.size === 1) !== whole) continue;
        const { picture, left, top, size } = part;
        const [a, b, c, d, e, f] = tileTransform(projection, tile);
        pen.setTransform(a * ratio, b * ratio, c * ratio, d * ratio, e * ratio, f * ratio);
        const over = 1 + OVERLAP_PX / Math.hypot(a, b);
        const { width, height } = picture;
        pen.drawImage(picture, left * width, top * height, size * width, size * height, 0, 0, over, over);
      }
    }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.globalAlpha = VEIL[document.documentElement.dataset["theme"] === "daylight" ? "daylight" : "dark"];
    pen.fillStyle = palette.ground;
    if (seen.length > 0) pen.fillRect(0, 0, camera.widthPx, camera.heightPx);
    pen.restore();
    this.wanted = seen;
    this.ask();
  }

  /** The tile itself, or the part of one above it that stands in for it. */
  private pictureOf({ zoom, x, y }: Tile, minZoom: number): { picture: ImageBitmap; left: number; top: number; size: number } | null {
    for (let up = 0; up <= Math.min(STAND_INS, zoom - minZoom); up++) {
      const cut = 2 ** up;
      const name = nameOf({ zoom: zoom - up, x: Math.floor(x / cut), y: Math.floor(y / cut) });
      const kept = this.kept.get(name);
      if (kept?.picture == null) continue;
      this.kept.touch(name);
      return { picture: kept.picture, left: mod(x, cut) / cut, top: mod(y, cut) / cut, size: 1 / cut };
    }
    return null;
  }

  /** Asks for what is seen and not there, the middle first. */
  private ask(): void {
    const nowMs = performance.now();
    for (const tile of this.wanted) {
      if (this.asking >= ASKED_AT_ONCE) return;
      const name = nameOf(tile);
      const kept = this.kept.get(name);
      if (kept !== undefined && (kept.picture !== null || nowMs < kept.retryMs)) continue;
      this.keep(name, { picture: null, retryMs: Infinity });
      this.asking += 1;
      void this.fetch(name);
    }
  }

  private async fetch(name: string): Promise<void> {
    const { file } = this;
    const found: Kept<ImageBitmap> = { picture: null, retryMs: Infinity };
    try {
      const answer = await fetch(`${file?.url ?? ""}/${name}`);
      if (answer.status === 200) found.picture = await createImageBitmap(await answer.blob());
      else found.retryMs = performance.now() + retryAfterMs(answer.status, answer.headers.get("Retry-After"));
    } catch {
      found.retryMs = performance.now() + RETRY_MS;
    }
    this.asking -= 1;
    if (this.file === file) this.keep(name, found);
    else found.picture?.close();
    this.loaded();
  }

  private keep(name: string, found: Kept<ImageBitmap>): void {
    this.kept.keep(name, found, new Set(this.wanted.map(nameOf)), performance.now());
  }

  private drawImage(pen: Pen, camera: Camera, frame: Frame, ratio: number): void {
    if (this.image?.bitmap.complete !== true || this.image.bitmap.naturalWidth === 0) return;
    const at = placeImage(frame, this.image.pins);
    if (at === null) return;
    const k = camera.pxPerM * ratio;
    pen.save();
    pen.setTransform(at.a * k, -at.b * k, at.c * k, -at.d * k, toScreenX(camera, at.e) * ratio, toScreenY(camera, at.f) * ratio);
    pen.globalAlpha = 0.85;
    pen.drawImage(this.image.bitmap, 0, 0);
    pen.restore();
  }
}

/** The end of its address; beyond the world's edge the world begins anew. */
function nameOf({ zoom, x, y }: Tile): string {
  return `${zoom}/${mod(x, 2 ** zoom)}/${y}`;
}

function mod(a: number, b: number): number {
  return ((a % b) + b) % b;
}
