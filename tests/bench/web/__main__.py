"""`make bench-web`: what the web page costs and how quick it is. All in build/bench/web.json.

python -m bench.web [--only size|view|thread|heap|orders|ticks] [--seconds N]

The figures are of a real daemon, simulated vehicles in a process of their own, a real `skygcs web`, and the system's
Chromium with software rendering; on a machine that is busy with other things they say little.
"""

from __future__ import annotations

import sys

from bench.results import Checks, Found, run_parts
from bench.web.air import measure_orders, measure_ticks
from bench.web.page import measure_heap, measure_size, measure_view
from bench.web.thread import measure_thread


def view(seconds: float) -> Found:
    return {"50": measure_view(50, seconds), "200": measure_view(200, seconds)}


def thread(seconds: float) -> Found:
    return {"50": measure_thread(1, 50, seconds), "1000": measure_thread(4, 250, seconds)}


def check_view(found: Found) -> Checks:
    few, many = found["50"], found["200"]
    return [
        (f"50 vehicles: first on screen after {few['first_s']:.2f} s (1)", few["first_s"] <= 1.0),
        (f"50 vehicles: {few['frames_per_s']:.1f} frames/s (55)", few["frames_per_s"] >= 55),
        (f"50 vehicles: message age p99 {few['age_p99_ms']:.1f} ms (50)", few["age_p99_ms"] <= 50),
        (f"200 vehicles: {many['frames_per_s']:.1f} frames/s (40)", many["frames_per_s"] >= 40),
    ]


def check_thread(found: Found) -> Checks:
    return [
        (f"{name} vehicles: {share:.1%} of a core on the main thread ({most:.0%})", share <= most)
        for name, most in (("50", 0.12), ("1000", 0.5))
        for share in [found[name]["main_thread"]]
    ]


def check_orders(found: Found) -> Checks:
    return [
        (f"{name}: p99 {of['p99_ms']:.1f} ms of {of['count']} (20)", of["p99_ms"] <= 20.0)
        for name, of in found.items()
        if isinstance(of, dict) and "p99_ms" in of and "without" not in name
    ]


PARTS = {
    "size": (
        lambda _: measure_size(),
        lambda f: [(f"page {f['compressed_kb']:.1f} kB compressed (150)", f["compressed_kb"] <= 150)],
    ),
    "view": (view, check_view),
    "thread": (thread, check_thread),
    "heap": (
        lambda _: measure_heap(),
        lambda f: [(f"heap {f['growth']:+.1%} over two hours (+10 %)", f["growth"] <= 0.10)],
    ),
    "orders": (lambda _: measure_orders(), check_orders),
    "ticks": (
        lambda _: measure_ticks(),
        lambda f: [(f"tick lateness p99 {f['ratio']:.2f} of that without pages (1.10)", f["ratio"] <= 1.10)],
    ),
}


if __name__ == "__main__":
    sys.exit(run_parts("web", PARTS, 10.0))
