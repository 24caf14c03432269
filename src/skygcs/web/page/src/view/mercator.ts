// Tiles of Web Mercator (EPSG:3857) on the fleet view: which are seen, and where each is drawn. Pure.
// The world is a square of side 1, x from the west (180 degrees), y from the north. Across a view it is joined to the fleet's
// frame by one linear map about the middle: 8 m off at 10 km at 45 degrees, which is less than a pixel at that scale.

import { toScreenX, toScreenY, type Camera } from "./camera.ts";
import { fromGeodetic, toGeodetic, type Frame } from "./frame.ts";

const RAD = Math.PI / 180;
/** Half the step over which the map is made linear: 40 m at the equator. */
const STEP = 5e-7;
/** More tiles than that are not drawn at once: the file has no zoom that is coarse enough. */
export const MAX_SEEN = 200;

/** A tile's place; x may be beyond the world's edge, which is one with the other edge. */
export interface Tile {
  zoom: number;
  x: number;
  y: number;
}

/** Places of the square to pixels of the canvas. */
export interface Projection {
  /** The place in the middle of the view, and where it is on the canvas. */
  x: number;
  y: number;
  xPx: number;
  yPx: number;
  /** Pixels for a step along x and y of the square. */
  along: readonly [number, number];
  down: readonly [number, number];
}

export function mercatorOf(lat_deg: number, lon_deg: number): [number, number] {
  const sin = Math.sin(lat_deg * RAD);
  return [lon_deg / 360 + 0.5, 0.5 - Math.atanh(sin) / (2 * Math.PI)];
}

export function geodeticOf(x: number, y: number): [number, number] {
  return [Math.asin(Math.tanh((0.5 - y) * 2 * Math.PI)) / RAD, (x - 0.5) * 360];
}

export function projectionOf(frame: Frame, camera: Camera): Projection {
  const { lat_deg, lon_deg } = toGeodetic(frame, camera.x, camera.y);
  const [x, y] = mercatorOf(lat_deg, lon_deg);
  const at = (u: number, v: number): [number, number] => {
    const [lat, lon] = geodeticOf(u, v);
    const [east, north] = fromGeodetic(frame, lat, lon);
    return [toScreenX(camera, east), toScreenY(camera, north)];
  };
  const slope = (a: [number, number], b: [number, number]): [number, number] => [(b[0] - a[0]) / (2 * STEP), (b[1] - a[1]) / (2 * STEP)];
  const [xPx, yPx] = at(x, y);
  return { x, y, xPx, yPx, along: slope(at(x - STEP, y), at(x + STEP, y)), down: slope(at(x, y - STEP), at(x, y + STEP)) };
}

/** The zoom whose tiles are shown about as large as they are. */
export function zoomFor({ along }: Projection, tilePx: number, least: number, most: number): number {
  const wanted = Math.round(Math.log2(Math.hypot(...along) / tilePx));
  return Math.min(Math.max(wanted, least), most);
}

/** The tiles of a zoom that the canvas may show, the middle first; none where they would be too many. `bounds_deg`: west,
 *  south, east, north of what there is. */
export function tilesSeen(p: Projection, zoom: number, widthPx: number, heightPx: number, bounds_deg: readonly number[] | null): Tile[] {
  const corners = [[0, 0], [widthPx, 0], [0, heightPx], [widthPx, heightPx]].map(([px = 0, py = 0]) => placeAt(p, px, py));
  const count = 2 ** zoom;
  let [left, right] = extremes(corners.map(([x]) => x * count));
  let [top, bottom] = extremes(corners.map(([, y]) => y * count));
  if (bounds_deg !== null) {
    const [west = -180, south = -90, east = 180, north = 90] = bounds_deg;
    const [westX, northY] = mercatorOf(Math.min(north, 89), west);
    const [eastX, southY] = mercatorOf(Math.max(south, -89), east);
    [left, right] = [Math.max(left, westX * count), Math.min(right, eastX * count)];
    [top, bottom] = [Math.max(top, northY * count), Math.min(bottom, southY * count)];
  }
  const [x0, x1] = [Math.floor(left), Math.ceil(right)];
  const [y0, y1] = [Math.max(Math.floor(top), 0), Math.min(Math.ceil(bottom), count)];
  if (x1 <= x0 || y1 <= y0 || (x1 - x0) * (y1 - y0) > MAX_SEEN) return [];
  const tiles = Array.from({ length: (x1 - x0) * (y1 - y0) }, (_, i) => ({ zoom, x: x0 + (i % (x1 - x0)), y: y0 + Math.floor(i / (x1 - x0)) }));
  const off = ({ x, y }: Tile): number => Math.hypot(x + 0.5 - p.x * count, y + 0.5 - p.y * count);
  return tiles.sort((a, b) => off(a) - off(b));
}

/** Six numbers of a canvas transform: a square of side 1, y down, to the tile's place on the canvas. */
export function tileTransform({ x, y, xPx, yPx, along, down }: Projection, tile: Tile): [number, number, number, number, number, number] {
  const size = 2 ** -tile.zoom;
  const [u, v] = [tile.x * size - x, tile.y * size - y];
  return [along[0] * size, along[1] * size, down[0] * size, down[1] * size, xPx + along[0] * u + down[0] * v, yPx + along[1] * u + down[1] * v];
}

/** The place of the square under a point of the canvas. */
function placeAt({ x, y, xPx, yPx, along, down }: Projection, px: number, py: number): [number, number] {
  const [dx, dy] = [px - xPx, py - yPx];
  const det = along[0] * down[1] - along[1] * down[0];
  return [x + (dx * down[1] - dy * down[0]) / det, y + (dy * along[0] - dx * along[1]) / det];
}

function extremes(numbers: readonly number[]): [number, number] {
  return [Math.min(...numbers), Math.max(...numbers)];
}
