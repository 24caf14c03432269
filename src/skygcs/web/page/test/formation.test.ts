import assert from "node:assert/strict";
import { test } from "node:test";
import { formation, type FormationShape } from "../src/panels/formation.ts";

/** From core/plan/formations.py: spacing 4 m about (10, -5, 12), turned by 30 degrees. */
const PLANNED: readonly { shape: string; count: number; places: readonly (readonly number[])[] }[] = [
  {"shape": "line", "count": 2, "places": [[9.0, -3.267949, 12.0], [11.0, -6.732051, 12.0]]},
  {"shape": "line", "count": 5, "places": [[6.0, 1.928203, 12.0], [8.0, -1.535898, 12.0], [10.0, -5.0, 12.0], [12.0, -8.464102, 12.0], [14.0, -11.928203, 12.0]]},
  {"shape": "column", "count": 2, "places": [[11.732051, -4.0, 12.0], [8.267949, -6.0, 12.0]]},
  {"shape": "column", "count": 5, "places": [[16.928203, -1.0, 12.0], [13.464102, -3.0, 12.0], [10.0, -5.0, 12.0], [6.535898, -7.0, 12.0], [3.071797, -9.0, 12.0]]},
  {"shape": "v", "count": 2, "places": [[11.992389, -5.174311, 12.0], [8.007611, -4.825689, 12.0]]},
  {"shape": "v", "count": 5, "places": [[13.405151, -3.034035, 12.0], [9.420372, -2.685412, 12.0], [11.714678, -6.659266, 12.0], [5.435594, -2.336789, 12.0], [10.024205, -10.284497, 12.0]]},
  {"shape": "circle", "count": 2, "places": [[11.732051, -4.0, 12.0], [8.267949, -6.0, 12.0]]},
  {"shape": "circle", "count": 5, "places": [[12.946741, -3.298698, 12.0], [9.292559, -1.671752, 12.0], [6.616037, -4.644331, 12.0], [8.616037, -8.108433, 12.0], [12.528627, -7.276786, 12.0]]},
  {"shape": "grid", "count": 2, "places": [[9.0, -3.267949, 12.0], [11.0, -6.732051, 12.0]]},
  {"shape": "grid", "count": 5, "places": [[9.785641, -1.428719, 12.0], [11.785641, -4.89282, 12.0], [13.785641, -8.356922, 12.0], [6.321539, -3.428719, 12.0], [8.321539, -6.89282, 12.0]]}
];

for (const { shape, count, places } of PLANNED) {
  test(`${shape} of ${count} as the planner makes it`, () => {
    const found = formation(shape as FormationShape, count, 4, [10, -5, 12], Math.PI / 6);
    assert.equal(found.length, count);
    found.forEach((place, i) =>
      place.forEach((value, k) => assert.ok(Math.abs(value - (places[i]?.[k] ?? NaN)) < 1e-5, `${i} ${k}: ${value}`)),
    );
  });
}

test("one vehicle is in the middle, and none is no formation", () => {
  assert.deepEqual(formation("circle", 1, 4, [1, 2, 3], 1), [[1, 2, 3]]);
  assert.deepEqual(formation("v", 0, 4, [1, 2, 3], 1), []);
});
