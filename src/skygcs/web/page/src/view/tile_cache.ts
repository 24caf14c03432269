// The pictures of tiles that are kept, within a budget of pixels, and when a tile that did not come is asked for again. Pure.

/** Decoded pixels that are kept: 96 MB. */
export const KEPT_PX = 24_000_000;
/** Tiles of which there is no picture. */
export const MOST_EMPTY = 4_000;
/** A tile that did not come, and one that the server does not draw, are asked for again after that. */
export const RETRY_MS = 10_000;
export const REFUSED_RETRY_MS = 60_000;

export interface Picture {
  readonly width: number;
  readonly height: number;
  close: () => void;
}

export interface Kept<P extends Picture> {
  /** Null: it is on its way, there is none, or it could not be had. */
  picture: P | null;
  /** When it may be asked for again. */
  retryMs: number;
}

/** After how long a tile that came as no picture may be asked for again; Infinity: there is none. */
export function retryAfterMs(status: number, retryAfter: string | null): number {
  if (status === 204) return Infinity;
  if (status === 422) return REFUSED_RETRY_MS;
  const seconds = Number(retryAfter ?? "");
  return status === 503 && seconds > 0 ? Math.min(seconds * 1000, REFUSED_RETRY_MS) : RETRY_MS;
}

export class TileCache<P extends Picture> {
  private readonly kept = new Map<string, Kept<P>>();
  private px = 0;

  /** Decoded pixels of all pictures. */
  get keptPx(): number {
    return this.px;
  }

  values(): Iterable<Kept<P>> {
    return this.kept.values();
  }

  get(name: string): Kept<P> | undefined {
    return this.kept.get(name);
  }

  /** What was just drawn is the newest: those before go first. */
  touch(name: string): void {
    const found = this.kept.get(name);
    if (found === undefined) return;
    this.kept.delete(name);
    this.kept.set(name, found);
  }

  /** Keeps a tile, and lets the oldest go beyond the budget: first those that are not wanted. A wanted one that finds no
   *  room is asked for again later, and not at once. */
  keep(name: string, found: Kept<P>, wanted: ReadonlySet<string>, nowMs: number): void {
    this.drop(name);
    this.kept.set(name, found);
    this.px += pxOf(found.picture);
    for (const old of [...this.kept.keys()]) {
      if (this.px <= KEPT_PX) break;
      if (!wanted.has(old) && this.kept.get(old)?.picture !== null) this.drop(old);
    }
    for (const old of [...this.kept.keys()]) {
      if (this.px <= KEPT_PX) break;
      if (this.kept.get(old)?.picture == null) continue;
      this.drop(old);
      this.kept.set(old, { picture: null, retryMs: nowMs + RETRY_MS });
    }
    for (const [old, { picture }] of this.kept) {
      if (this.kept.size <= MOST_EMPTY) break;
      if (picture === null && !wanted.has(old)) this.kept.delete(old);
    }
  }

  clear(): void {
    for (const name of [...this.kept.keys()]) this.drop(name);
  }

  private drop(name: string): void {
    const found = this.kept.get(name);
    if (found === undefined) return;
    this.kept.delete(name);
    this.px -= pxOf(found.picture);
    found.picture?.close();
  }
}

function pxOf(picture: Picture | null): number {
  return picture === null ? 0 : picture.width * picture.height;
}
