"""The page in the browser: size, first vehicle, frames, age of messages, memory."""

from __future__ import annotations

import contextlib
import gzip
import itertools
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from playwright.sync_api import Page, sync_playwright

from bench.results import percentile
from bench.web.field import field
from skygcs.web.built_page import STATIC
from support.web_station import chromium, chromium_options

NOT_COUNTED = {"licenses.txt"}
"""Read by people who ask for it, not loaded with the page."""

RECORDER = """
(() => {
  const Native = WebSocket;
  globalThis.bench = {batches: [], sockets: [], first: null, muted: false, taken: 0};
  globalThis.WebSocket = class extends Native {
    constructor(...rest) {
      super(...rest);
      bench.sockets.push(this);
      this.addEventListener("message", (event) => {
        // the server's own states would be of another time than those that are fed; answers are let through
        if (bench.muted && event.isTrusted && !event.data.includes('"id":')) event.stopImmediatePropagation();
      });
      this.addEventListener("message", (event) => {
        if (!event.data.startsWith('{"jsonrpc":"2.0","method":"web.state"')) return;
        const began = Number(/"began_s":([0-9.]+)/.exec(event.data.slice(0, 200))[1]);
        const empty = event.data.includes('"vehicles":[]');
        // after the page's own handlers
        setTimeout(() => {
          if (!empty && bench.batches.length < 100000) {
            bench.batches.push([began, performance.timeOrigin + performance.now()]);
          }
        }, 0);
      });
    }
  };
  const look = () => {
    const known = globalThis.skygcs?.store?.state?.vehicles;
    if (known && known.size > 0) requestAnimationFrame(() => { bench.first = performance.now(); });
    else requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})();
"""

FRAMES = """
(seconds) => new Promise((resolve) => {
  const times = [];
  const view = document.querySelector(".canvasbox canvas[role=img]");
  const box = view.getBoundingClientRect();
  let n = 0;
  const step = (now) => {
    times.push(now);
    // the view is turned by hand all the time: every frame is drawn anew
    n += 1;
    const x = box.left + box.width / 2, y = box.top + box.height / 2;
    const turn = {deltaY: n % 40 < 20 ? 8 : -8, clientX: x, clientY: y, bubbles: true, cancelable: true};
    view.dispatchEvent(new WheelEvent("wheel", turn));
    if (now - times[0] < seconds * 1000) requestAnimationFrame(step);
    else resolve(times);
  };
  requestAnimationFrame(step);
})
"""


@contextlib.contextmanager
def browser_page() -> Iterator[Page]:
    path = chromium()
    if path is None:
        raise SystemExit("make bench-web needs Chromium: install the package chromium of this system")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path, args=[*chromium_options(), "--enable-precise-memory-info"]
        )
        page = browser.new_context(viewport={"width": 1600, "height": 900}).new_page()
        share_priority()
        page.set_default_timeout(120_000)
        yield page
        browser.close()


def share_priority() -> None:
    """Give the browser's processes the priority of this session. The browser makes a session of its own, and Linux
    shares the processors among sessions: with the daemon's at a higher priority the page got what it left, which is no
    property of the page."""
    own = Path("/proc/self/autogroup")
    if not own.exists() or (nice := own.read_text().split()[-1]) == "0":
        return
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    for pid in parents:
        above = pid
        while above in parents and above != os.getpid():
            above = parents[above]
        if above == os.getpid():
            with contextlib.suppress(OSError):
                Path(f"/proc/{pid}/autogroup").write_text(nice)


def measure_size() -> dict[str, Any]:
    """The page as it is sent: gzip where that helps."""
    sizes = {}
    for path in sorted(p for p in STATIC.rglob("*") if p.is_file() and p.name not in NOT_COUNTED):
        body = path.read_bytes()
        sizes[path.name] = min(len(body), len(gzip.compress(body, 9, mtime=0)))
    return {"files": sizes, "compressed_kb": sum(sizes.values()) / 1000}


def measure_view(vehicles: int, seconds: float) -> dict[str, Any]:
    """First vehicle, frames a second while the view moves, age of messages at 10 Hz."""
    with field(vehicles) as station, browser_page() as page:
        page.add_init_script(RECORDER)
        page.goto(station.address())  # once: the browser itself and the daemon's subscription are warm
        _wait(page, "globalThis.bench.first !== null")
        page.goto("about:blank")
        time.sleep(1.0)
        page.goto(f"{station.base}/")
        _wait(page, "globalThis.bench.first !== null")
        first_s = float(page.evaluate("bench.first")) / 1000
        _wait(page, f"skygcs.store.state.vehicles.size >= {vehicles}")
        page.evaluate("bench.batches.length = 0")
        times = page.evaluate(FRAMES, seconds)
        batches = page.evaluate("bench.batches")
        offset_s = time.time() - time.monotonic()
        ages_ms = [at_ms - (began_s + offset_s) * 1000 for began_s, at_ms in batches]
        gaps_ms = [after - before for before, after in itertools.pairwise(times)]
        return {
            "vehicles": vehicles,
            "first_s": round(first_s, 3),
            "frames_per_s": round((len(times) - 1) / (times[-1] - times[0]) * 1000, 2),
            "frame_gap_p99_ms": round(percentile(gaps_ms, 0.99), 1),
            "batches_per_s": round(len(batches) / (times[-1] - times[0]) * 1000, 2),
            "age_p50_ms": round(percentile(ages_ms, 0.5), 1),
            "age_p99_ms": round(percentile(ages_ms, 0.99), 1),
        }


HOURS, BATCHES_PER_S, HEAP_VEHICLES = 2.0, 2, 50

FEED = """
async ({states, from, to, rate}) => {
  const socket = bench.sockets.at(-1);
  const give = (method, params) =>
    socket.dispatchEvent(new MessageEvent("message", {data: JSON.stringify({jsonrpc: "2.0", method, params})}));
  for (let n = from; n < to; n += 1) {
    const t = n / rate;
    const vehicles = states.map((state, i) => ({
      ...state, armed: true,
      position: {...state.position, age_s: 0.1,
        enu_m: [40 * Math.sin(t / 20 + i), 40 * Math.cos(t / 17 + i), 10 + 5 * Math.sin(t / 9)]},
    }));
    const now_s = bench.base_s + t;
    const params = {seq: bench.seq + 1 + n, full: n === 0, now_s, heard_s: now_s, began_s: now_s, vehicles, gone: []};
    give("web.state", params);
    if (n % 20 === 0) {
      const event = {time_unix_s: now_s, kind: "mode", vehicle: "v1", sysid: 1, text: "mode " + n, data: {}};
      give("event", {event});
    }
    if (n % 10 === 0) await new Promise((resolve) => setTimeout(resolve, 0));
  }
}
"""


MUTED = """
() => {
  bench.muted = true;
  bench.seq = 1000000;
  bench.base_s = skygcs.store.state.clock.now_s;
  bench.batches = [];
  skygcs.store.onAction((action) => { if (action.type === "batch") bench.taken += 1; });
}
"""

TAKEN = """
() => {
  const trails = [...skygcs.store.trails.byName.values()];
  let flown = 0, last = null;
  trails[0].each((x, y) => { if (last) flown += Math.hypot(x - last[0], y - last[1]); last = [x, y]; });
  return [bench.taken, flown, trails.reduce((sum, trail) => sum + trail.length, 0)];
}
"""
LEAST_FLOWN_M = 200.0
"""Of the trail of one vehicle: its 500 points are half a metre apart at least."""


def measure_heap() -> dict[str, Any]:
    """Two hours of flight of 50 vehicles, fed to the page as quickly as it takes them; the heap after the first tenth
    and at the end, each after a collection. The panel of a vehicle with its histories is open."""
    with field(HEAP_VEHICLES) as station, browser_page() as page:
        page.add_init_script(RECORDER)
        page.goto(station.address())
        _wait(page, f"globalThis.skygcs?.store?.state?.vehicles?.size >= {HEAP_VEHICLES}")
        states = page.evaluate("[...skygcs.store.state.vehicles.values()]")
        page.locator("tr.row").first.click()
        page.get_by_role("tab", name="Vehicle").click()
        page.get_by_role("tab", name="History").click()
        page.evaluate(MUTED)
        total = int(HOURS * 3600 * BATCHES_PER_S)
        session = page.context.new_cdp_session(page)
        heap = []
        for begin, end in ((0, total // 10), (total // 10, total // 2), (total // 2, total)):
            page.evaluate(FEED, {"states": states, "from": begin, "to": end, "rate": BATCHES_PER_S})
            page.evaluate("() => { bench.batches = [] }")
            for _ in range(3):
                session.send("HeapProfiler.collectGarbage")
            heap.append(float(session.send("Runtime.getHeapUsage")["usedSize"]))
        taken, flown_m, kept = page.evaluate(TAKEN)
        if taken != total or flown_m < LEAST_FLOWN_M:
            raise AssertionError(f"the page took {taken} of {total} batches; a trail of {flown_m:.0f} m")
        return {
            "trail_points": kept,
            "hours": HOURS,
            "vehicles": HEAP_VEHICLES,
            "batches": total,
            "heap_mb": [round(size / 1e6, 2) for size in heap],
            "growth": round(heap[-1] / heap[0] - 1, 4),
        }


def _wait(page: Page, expression: str) -> None:
    """Not wait_for_function, which needs eval in the page."""
    deadline = time.monotonic() + 120
    while not page.evaluate(f"() => Boolean({expression})"):
        if time.monotonic() > deadline:
            raise AssertionError(f"never: {expression}")
        time.sleep(0.02)
