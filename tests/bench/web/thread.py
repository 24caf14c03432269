"""Load of the page's main thread while vehicles fly circles and nobody touches the page.

CPU time of the thread itself (5.7 ms a frame at a load of 6, 8.4 at 12: measure on a quiet machine), and the own times
of the page's functions from Chromium's sampling profiler. The built page has short names: `minify: false` in build.mjs
gives them in full.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from playwright.sync_api import CDPSession, Page

from bench.web.page import browser_page
from support.browser import until
from support.process import ROOT, wait_until
from support.web_station import WebStation

SAMPLE_US = 500
MOST_FUNCTIONS = 30
SETTLED_S = 3.0
"""Caches fill and the view is fitted before anything is measured."""

TICK_S = 1 / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def circling(sites: int, vehicles: int) -> Iterator[WebStation]:
    """A station of made-up vehicles, ``vehicles`` at each of ``sites``: four of five fly circles."""
    with tempfile.TemporaryDirectory(prefix="skygcs-bench-thread-") as name:
        folder = Path(name)
        path = folder / "gcs.sock"
        line = [
            sys.executable,
            "-m",
            "support.many_sites",
            str(path),
            "--sites",
            str(sites),
            "--vehicles",
            str(vehicles),
        ]
        process = subprocess.Popen(line, env=os.environ | {"PYTHONPATH": str(ROOT / "tests")})
        station = WebStation(folder, None)
        try:
            wait_until(path.exists, "the socket of the sites")
            yield station.start()
        finally:
            station.close()
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=30)


def measure_thread(sites: int, vehicles: int, seconds: float) -> dict[str, Any]:
    """The share of one processor that the main thread takes, its frames a second, and which functions take it."""
    with circling(sites, vehicles) as station, browser_page() as page:
        page.goto(station.address())
        until(page, f"globalThis.skygcs?.store?.state?.names?.length >= {sites * vehicles}")
        time.sleep(SETTLED_S)
        renderer = _renderer(page)
        frames, busy_s, begun = _frames(page), _thread_s(renderer), time.monotonic()
        time.sleep(seconds)
        took_s = time.monotonic() - begun
        busy_s, frames = _thread_s(renderer) - busy_s, _frames(page) - frames
        return {
            "vehicles": sites * vehicles,
            "main_thread": round(busy_s / took_s, 4),
            "drawn_per_s": round(frames / took_s, 1),
            "ms_a_frame": round(busy_s / max(frames, 1) * 1000, 3),
            "own_ms_per_s": profiled(page, seconds),
        }


def profiled(page: Page, seconds: float) -> dict[str, float]:
    """Own time of functions, ms a second, the dearest first; what is not the page's stands in brackets."""
    session = page.context.new_cdp_session(page)
    session.send("Profiler.enable")
    session.send("Profiler.setSamplingInterval", {"interval": SAMPLE_US})
    session.send("Profiler.start")
    time.sleep(seconds)
    profile = session.send("Profiler.stop")["profile"]
    return own_times(profile)


def own_times(profile: dict[str, Any]) -> dict[str, float]:
    names = {}
    for node in profile["nodes"]:
        call = node["callFrame"]
        file = call["url"].rpartition("/")[2]
        names[node["id"]] = f"{call['functionName'] or '(anonymous)'} {file}:{call['lineNumber'] + 1}".rstrip(":0 ")
    own: Counter[str] = Counter()
    for node_id, delta_us in zip(profile["samples"], profile["timeDeltas"], strict=True):
        own[names[node_id]] += delta_us
    span_us = max(profile["endTime"] - profile["startTime"], 1)
    return {name: round(us / span_us * 1000, 2) for name, us in own.most_common(MOST_FUNCTIONS)}


def _frames(page: Page) -> int:
    return int(page.evaluate("skygcs.view.figures.frames"))


def _renderer(page: Page) -> int:
    """The process of this page: of several it is the one that has worked most."""
    browser = page.context.browser
    assert browser is not None
    session: CDPSession = browser.new_browser_cdp_session()
    found = session.send("SystemInfo.getProcessInfo")["processInfo"]
    return int(max((one["cpuTime"], one["id"]) for one in found if one["type"] == "renderer")[1])


def _thread_s(pid: int) -> float:
    """CPU seconds of a process' main thread so far."""
    fields = Path(f"/proc/{pid}/task/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) * TICK_S
