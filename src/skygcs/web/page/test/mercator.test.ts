import assert from "node:assert/strict";
import { test } from "node:test";
import { toScreenX, toScreenY, type Camera } from "../src/view/camera.ts";
import { frameAt, fromGeodetic } from "../src/view/frame.ts";
import { geodeticOf, MAX_SEEN, mercatorOf, projectionOf, tilesSeen, tileTransform, zoomFor } from "../src/view/mercator.ts";

/** Origin, heading of x, place in the frame, and the tile of zoom 17 that it is on, as pyproj 3.7 computes it: topocentric to
 *  EPSG:4979, on the ellipsoid, to EPSG:3857. */
const ORACLE: readonly (readonly [number, number, number, number, number, number, number])[] = [
  [43.7806, -79.4653, 90, 0, 0, 36603.567218, 47771.206584],
  [43.7806, -79.4653, 90, 100, 0, 36604.019496, 47771.206587],
  [43.7806, -79.4653, 90, 0, 100, 36603.567218, 47770.752714],
  [43.7806, -79.4653, 90, -700, 900, 36600.400846, 47767.121676],
  [43.7806, -79.4653, 90, 5000, -3000, 36626.170936, 47784.828048],
  [43.7806, -79.4653, 37, 0, 0, 36603.567218, 47771.206584],
  [43.7806, -79.4653, 37, 100, 0, 36603.839409, 47770.844109],
  [43.7806, -79.4653, 37, 0, 100, 36603.206009, 47770.933441],
  [43.7806, -79.4653, 37, -700, 900, 36598.411072, 47771.286051],
  [43.7806, -79.4653, 37, 5000, -3000, 36628.020774, 47761.285527],
  [-33.9, 18.4, 250, 0, 0, 72235.235556, 78668.975111],
  [-33.9, 18.4, 250, 100, 0, 72234.865654, 78669.110367],
  [-33.9, 18.4, 250, 0, 100, 72235.37019, 78669.34673],
  [-33.9, 18.4, 250, -700, 900, 72239.036796, 78671.372749],
  [-33.9, 18.4, 250, 5000, -3000, 72212.704181, 78664.582902],
];
const ZOOM = 17;

function near(a: number, b: number, by: number): void {
  assert.ok(Math.abs(a - b) <= by, `${a} is not ${b}`);
}

const camera = (x: number, y: number, pxPerM: number): Camera => ({ x, y, pxPerM, widthPx: 1600, heightPx: 900 });
const frameOf = (lat_deg: number, lon_deg: number, x_heading_deg: number) => frameAt({ lat_deg, lon_deg, alt_amsl_m: 0, x_heading_deg });

/** The oracle's tile place on the canvas, by the tile's transform. */
function drawnAt(frame: ReturnType<typeof frameOf>, cam: Camera, column: number, row: number): [number, number] {
  const [x, y] = [Math.floor(column), Math.floor(row)];
  const [a, b, c, d, e, f] = tileTransform(projectionOf(frame, cam), { zoom: ZOOM, x, y });
  const [u, v] = [column - x, row - y];
  return [a * u + c * v + e, b * u + d * v + f];
}

test("a place of a turned frame is drawn on the tile that pyproj says, to a fifth of a pixel", () => {
  for (const [lat, lon, heading, x, y, column, row] of ORACLE) {
    // a view as wide as the places are far: what is farther off is not on the screen
    const cam = camera(x * 0.9, y * 0.9, 800 / Math.max(Math.hypot(x, y), 100));
    const [px, py] = drawnAt(frameOf(lat, lon, heading), cam, column, row);
    near(px, toScreenX(cam, x), 0.2);
    near(py, toScreenY(cam, y), 0.2);
  }
});

test("half a screen from the middle a tile is less than a pixel off, at each scale", () => {
  const frame = frameOf(43.7806, -79.4653, 37);
  for (const pxPerM of [0.08, 0.5, 8, 100]) {
    const cam = camera(0, 0, pxPerM);
    for (const [east, north] of [[800, 0], [0, 450], [-500, 300]] as const) {
      const [lat, lon] = [43.7806 + north / pxPerM / 111_200, -79.4653 + east / pxPerM / 80_300];
      const [x, y] = fromGeodetic(frame, lat, lon);
      const [column, row] = mercatorOf(lat, lon).map((part) => part * 2 ** ZOOM) as [number, number];
      const [px, py] = drawnAt(frame, cam, column, row);
      near(px, toScreenX(cam, x), 1);
      near(py, toScreenY(cam, y), 1);
    }
  }
});

test("the world's square and back", () => {
  assert.deepEqual(mercatorOf(0, 0), [0.5, 0.5]);
  near(mercatorOf(85.0511287798066, -180)[1], 0, 1e-9); // the upper edge of EPSG:3857
  const [lat, lon] = geodeticOf(...mercatorOf(-33.9, 151.2));
  near(lat, -33.9, 1e-9);
  near(lon, 151.2, 1e-9);
});

test("the tiles of a view cover it, the middle one first, and each is about as large as its picture", () => {
  for (const heading of [90, 37, 180]) {
    const cam = camera(40, -60, 3);
    const projection = projectionOf(frameOf(43.7806, -79.4653, heading), cam);
    const zoom = zoomFor(projection, 256, 0, 22);
    const size = Math.hypot(...projection.along) / 2 ** zoom;
    assert.ok(size > 256 / Math.SQRT2 && size < 256 * Math.SQRT2, `${size}`);
    const tiles = tilesSeen(projection, zoom, 1600, 900, null);
    assert.ok(tiles.length > 10 && tiles.length < 120, `${tiles.length}`);
    const covered = (px: number, py: number): boolean =>
      tiles.some((tile) => {
        const [a, b, c, d, e, f] = tileTransform(projection, tile);
        const det = a * d - b * c;
        const [u, v] = [((px - e) * d - (py - f) * c) / det, ((py - f) * a - (px - e) * b) / det];
        return u >= 0 && v >= 0 && u <= 1 && v <= 1;
      });
    for (const [px, py] of [[0, 0], [1600, 0], [0, 900], [1600, 900], [800, 450], [1, 899]] as const) assert.ok(covered(px, py), `${heading}: ${px}, ${py}`);
    const [first] = tiles;
    assert.ok(first && Math.abs(first.x + 0.5 - projection.x * 2 ** zoom) <= 0.5 && Math.abs(first.y + 0.5 - projection.y * 2 ** zoom) <= 0.5);
  }
});

test("what a file has not is not asked for: zooms, an area, and too many tiles at once", () => {
  const projection = projectionOf(frameOf(43.7806, -79.4653, 90), camera(0, 0, 0.05));
  assert.equal(zoomFor(projection, 256, 17, 19), 17);
  assert.equal(zoomFor(projectionOf(frameOf(43.7806, -79.4653, 90), camera(0, 0, 300)), 256, 0, 19), 19);
  assert.deepEqual(tilesSeen(projection, 17, 1600, 900, null), []);
  const few = tilesSeen(projection, 17, 1600, 900, [-79.47, 43.775, -79.46, 43.785]);
  assert.ok(few.length > 0 && few.length < 40 && few.length <= MAX_SEEN);
  assert.deepEqual(tilesSeen(projection, 17, 1600, 900, [10, 50, 11, 51]), []);
});
