"""`make bench-formation`: what the separation filter promises, and how well ten fly behind a leader.

All in build/bench/formation.json. python -m bench.formation [--encounters N] [--jobs N]
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from typing import Any

from bench.results import in_virtual_time, keep
from support.formation_encounters import Outcome, encounter
from support.led_formation import led_formation

SECONDS = 60.0
SHARE = 20


def _fly(seeds: list[int]) -> list[Outcome]:
    return [encounter(seed, seconds=SECONDS) for seed in seeds]


def encounters(count: int, jobs: int, told: dict[str, Any]) -> list[str]:
    """The faults of so many encounters."""
    shares = [list(range(begin, min(begin + SHARE, count))) for begin in range(0, count, SHARE)]
    outcomes: list[Outcome] = []
    with ProcessPoolExecutor(jobs) as pool:
        for share in pool.map(_fly, shares):
            outcomes += share
            told["encounters"] = summary(outcomes)
            keep("formation", told)
    for name, value in told["encounters"].items():
        print(f"{name:>34}  {value}", flush=True)
    lost = [o for o in outcomes if o.references_m < 0.0 or o.vehicles_m < 0.0]
    return [f"seed {o.seed}: {o.references_m:.3f} m of references, {o.vehicles_m:.2f} m of vehicles" for o in lost]


def summary(outcomes: list[Outcome]) -> dict[str, Any]:
    """Figures of encounters; distances over the promised ones."""
    with_strangers = [o for o in outcomes if o.strangers]
    vehicles = sum(o.vehicles for o in outcomes)
    return {
        "encounters": len(outcomes),
        "vehicles": vehicles,
        "least of references (m)": round(min(o.references_m for o in outcomes), 3),
        "least of vehicles (m)": round(min(o.vehicles_m for o in outcomes), 2),
        "farthest off a reference (m)": round(max(o.off_m for o in outcomes), 2),
        "arrived vehicles (%)": round(100 * sum(o.arrived for o in outcomes) / vehicles, 2),
        "encounters where all arrived (%)": _share(o.arrived_s is not None for o in outcomes),
        "encounters with strangers": len(with_strangers),
        "of these nearer than footprints": sum(o.strangers_m < 0.0 for o in with_strangers),
    }


def _share(found: Iterable[bool]) -> float:
    values = list(found)
    return round(100 * sum(values) / len(values), 2)


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.formation")
    parser.add_argument("--encounters", type=int, default=10_000)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    told: dict[str, Any] = {}
    led = in_virtual_time(led_formation)
    told["led"] = asdict(led)
    print(
        f"10 behind a leader at {led.speed_mps:.1f} m/s: {led.rms_m:.2f} m RMS from their places, least distance "
        f"{led.least_m:.2f} m of {led.footprints_m:.2f} m",
        flush=True,
    )
    faults = [] if led.least_m > led.footprints_m else ["the formation behind a leader lost a distance"]
    if not math.isfinite(led.rms_m):
        faults.append("the formation behind a leader stopped")
    faults += encounters(given.encounters, given.jobs, told)
    told["faults"] = faults
    keep("formation", told)
    print("\n".join(faults[:20]) or "no fault")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
