"""`make bench-web`: what the web page costs and how quick it is. All in build/bench/web.json.

python -m bench.web [--only size|view|thread|heap|orders|ticks] [--seconds N]

The figures are of a real daemon, simulated vehicles in a process of their own, a real `skygcs web`, and the system's
Chromium with software rendering; on a machine that is busy with other things they say little.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

from bench.web.air import measure_orders, measure_ticks
from bench.web.page import measure_heap, measure_size, measure_view
from bench.web.thread import measure_thread
from support.process import ROOT

OUT = ROOT / "build" / "bench"


def view(seconds: float) -> dict[str, Any]:
    return {"50": measure_view(50, seconds), "200": measure_view(200, seconds)}


def thread(seconds: float) -> dict[str, Any]:
    return {"50": measure_thread(1, 50, seconds), "1000": measure_thread(4, 250, seconds)}


def checks(part: str, told: dict[str, Any]) -> list[tuple[str, bool]]:
    """(line, whether it holds) of a part."""
    match part:
        case "size":
            return [(f"page {told['compressed_kb']:.1f} kB compressed (150)", told["compressed_kb"] <= 150)]
        case "view":
            few, many = told["50"], told["200"]
            return [
                (f"50 vehicles: first on screen after {few['first_s']:.2f} s (1)", few["first_s"] <= 1.0),
                (f"50 vehicles: {few['frames_per_s']:.1f} frames/s (55)", few["frames_per_s"] >= 55),
                (f"50 vehicles: message age p99 {few['age_p99_ms']:.1f} ms (50)", few["age_p99_ms"] <= 50),
                (f"200 vehicles: {many['frames_per_s']:.1f} frames/s (40)", many["frames_per_s"] >= 40),
            ]
        case "thread":
            few, many = told["50"], told["1000"]
            return [
                (
                    f"50 vehicles: {few['main_thread']:.1%} of a core on the main thread (12 %)",
                    few["main_thread"] <= 0.12,
                ),
                (
                    f"1,000 vehicles: {many['main_thread']:.1%} of a core on the main thread (50 %)",
                    many["main_thread"] <= 0.5,
                ),
            ]
        case "heap":
            return [(f"heap {told['growth']:+.1%} over two hours (+10 %)", told["growth"] <= 0.10)]
        case "orders":
            return [
                (f"{name}: p99 {of['p99_ms']:.1f} ms of {of['count']} (20)", of["p99_ms"] <= 20.0)
                for name, of in told.items()
                if isinstance(of, dict) and "p99_ms" in of and "without" not in name
            ]
        case _:
            return [(f"tick lateness p99 {told['ratio']:.2f} of that without pages (1.10)", told["ratio"] <= 1.10)]


def main() -> int:
    parts: dict[str, Callable[[float], dict[str, Any]]] = {
        "size": lambda _: measure_size(),
        "view": view,
        "thread": thread,
        "heap": lambda _: measure_heap(),
        "orders": measure_orders,
        "ticks": measure_ticks,
    }
    parser = argparse.ArgumentParser(description="What the web page costs.")
    parser.add_argument("--only", choices=parts)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # a time limit, too, ends all that was started
    path = OUT / "web.json"
    found: dict[str, Any] = json.loads(path.read_text()) if options.only and path.exists() else {}
    missed = 0
    for part, measure in parts.items():
        if options.only not in (None, part):
            continue
        found[part] = measure(options.seconds) | {"load": os.getloadavg()[0]}
        for line, holds in checks(part, found[part]):
            missed += not holds
            print(f"{'ok  ' if holds else 'MISS'} {line}", flush=True)
    OUT.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found, indent=1))
    print(path.relative_to(ROOT))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
