"""What an evaluation of the monitor costs: CPU time of the pure core, with a fresh position of every vehicle."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Iterator
from typing import Any

from skygcs.core.monitor.monitor import Monitor
from skygcs.runtime.separation_monitor import LONGEST_PERIOD_S, PERIOD_S, SHARE
from support.watched_fleet import WatchedVehicle

ROUNDS = 20
FLEETS = (10, 100, 250)
LAYOUTS = ("grid", "crossing", "one place")


def cost_rows() -> Iterator[dict[str, Any]]:
    """Of fleets on a grid of 10 m that hover, that fly through each other, and that all claim one place."""
    for vehicles in FLEETS:
        for layout in LAYOUTS:
            yield _measure(vehicles, layout)


def _measure(count: int, layout: str) -> dict[str, Any]:
    fleet = [WatchedVehicle(i + 1) for i in range(count)]
    gc.collect()
    gc.freeze()  # as a daemon does when it has started: modules and dialects are no part of a later collection
    monitor = Monitor(acting=False)
    took, longest = [], 0.0
    for n in range(ROUNDS):
        now = 100.0 + n * PERIOD_S
        for i, vehicle in enumerate(fleet):
            vehicle.heartbeat(now)
            at, velocity = _motion(i, layout, n * PERIOD_S)
            vehicle.position(now, at, velocity)
        turns = []
        """What lies between two yields: the evaluation may be interrupted there."""
        begun = time.thread_time()
        for _ in monitor.evaluate([v.member for v in fleet], now + 0.05):
            turns.append(time.thread_time() - begun)
            begun = time.thread_time()
        turns.append(time.thread_time() - begun)
        took.append(sum(turns))
        longest = max(longest, max(turns))
        monitor.events.clear()
    took_s = statistics.median(took)
    period_s = min(max(PERIOD_S, took_s / SHARE), LONGEST_PERIOD_S)
    return {
        "vehicles": count,
        "layout": layout,
        "conflicts": len(monitor.pairs),
        "took_ms": round(1000 * took_s, 2),
        "longest_turn_ms": round(1000 * longest, 3),
        "period_s": round(period_s, 2),
        "share_percent": round(100 * took_s / period_s, 1),
    }


def _motion(i: int, layout: str, at_s: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    east, north = 10.0 * (i % 16), 10.0 * (i // 16)
    if layout == "grid":
        return (east, north, 20.0), (0.0, 0.0, 0.0)
    if layout == "one place":
        return (0.01 * i, 0.0, 20.0), (0.0, 0.0, 0.0)
    speed = 5.0 if i % 2 else -5.0
    return (east + speed * at_s, north, 20.0), (speed, 0.0, 0.0)
