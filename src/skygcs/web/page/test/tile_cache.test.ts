import assert from "node:assert/strict";
import { test } from "node:test";
import { KEPT_PX, MOST_EMPTY, REFUSED_RETRY_MS, RETRY_MS, retryAfterMs, TileCache } from "../src/view/tile_cache.ts";

function pictures() {
  let open = 0;
  const picture = (width: number) => {
    open += width * width;
    return { width, height: width, close: () => { open -= width * width; } };
  };
  return { picture, openPx: () => open };
}

test("only a tile that is not there is never asked for again", () => {
  assert.equal(retryAfterMs(204, null), Infinity);
  assert.equal(retryAfterMs(503, "1"), 1000);
  assert.equal(retryAfterMs(503, null), RETRY_MS);
  assert.equal(retryAfterMs(503, "1e9"), REFUSED_RETRY_MS);
  assert.equal(retryAfterMs(422, null), REFUSED_RETRY_MS);
  assert.equal(retryAfterMs(403, "1"), RETRY_MS);
});

test("the budget counts the pixels of each picture, whatever the first one has", () => {
  const { picture, openPx } = pictures();
  const cache = new TileCache<ReturnType<typeof picture>>();
  cache.keep("small", { picture: picture(16), retryMs: 0 }, new Set(), 0);
  for (let n = 0; n < 100; n++) cache.keep(`t${n}`, { picture: picture(1024), retryMs: 0 }, new Set(["t0"]), 0);
  assert.equal(cache.keptPx, openPx());
  assert.ok(openPx() <= KEPT_PX && openPx() > KEPT_PX - 2 * 1024 ** 2);
  assert.equal(cache.get("small"), undefined);
  assert.ok(cache.get("t0")?.picture != null && cache.get("t1") === undefined && cache.get("t99")?.picture != null);
  cache.clear();
  assert.equal(openPx(), 0);
});

test("more wanted than there is room for is not asked for over and over", () => {
  const { picture, openPx } = pictures();
  const cache = new TileCache<ReturnType<typeof picture>>();
  const wanted = new Set(Array.from({ length: 40 }, (_, n) => `t${n}`));
  for (const name of wanted) cache.keep(name, { picture: picture(1024), retryMs: 0 }, wanted, 500);
  assert.ok(openPx() <= KEPT_PX);
  assert.deepEqual(cache.get("t0"), { picture: null, retryMs: 500 + RETRY_MS });
});

test("what was drawn last stays longest, and empty tiles take no memory without end", () => {
  const { picture } = pictures();
  const cache = new TileCache<ReturnType<typeof picture>>();
  for (let n = 0; n < 20; n++) cache.keep(`t${n}`, { picture: picture(1024), retryMs: 0 }, new Set(), 0);
  cache.touch("t0");
  for (let n = 20; n < 30; n++) cache.keep(`t${n}`, { picture: picture(1024), retryMs: 0 }, new Set(), 0);
  assert.ok(cache.get("t0")?.picture != null && cache.get("t1") === undefined);
  for (let n = 0; n < 2 * MOST_EMPTY; n++) cache.keep(`e${n}`, { picture: null, retryMs: Infinity }, new Set(["e0"]), 0);
  assert.ok(cache.get("e0") !== undefined && cache.get("e1") === undefined && cache.get(`e${2 * MOST_EMPTY - 1}`) !== undefined);
  assert.ok(cache.get("t0")?.picture != null);
});
