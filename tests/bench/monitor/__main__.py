"""`make bench-monitor`: how the monitor keeps vehicles apart, and what it costs. All in build/bench/monitor.json.

python -m bench.monitor [--only encounters|formation|cost|lateness] [--encounters N] [--jobs N]
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from bench.monitor.cost import cost_rows
from bench.monitor.formation import fly_formation
from bench.monitor.lateness import lateness_rows
from bench.results import in_virtual_time, keep
from support.encounters import Judged, judge, rows

LEAST_AHEAD_S = 5.0
SHARE = 10
"""Encounters flown with one daemon."""


def _judge(seeds: list[int]) -> list[Judged]:
    return in_virtual_time(lambda folder: judge(seeds, folder))


def encounters(count: int, jobs: int, told: dict[str, Any]) -> list[str]:
    shares = [list(range(begin, min(begin + SHARE, count))) for begin in range(0, count, SHARE)]
    judged: list[Judged] = []
    with ProcessPoolExecutor(jobs) as pool:
        for share in pool.map(_judge, shares):
            judged += share
            told["encounters"] = [one.as_dict() for one in judged]
            keep("monitor", told)  # 200 take an hour on a busy machine, and may be ended before
    for row in rows(judged):
        print(row, flush=True)
    missed = [f"seed {o.encounter.seed}: a hold would have prevented it" for o in judged if o.preventable]
    late = [o for o in judged if o.warned_ahead_s < LEAST_AHEAD_S]
    return missed + [
        f"seed {o.encounter.seed} ({o.encounter.kind}): warned {o.warned_ahead_s:.1f} s ahead" for o in late
    ]


def formation(told: dict[str, Any]) -> list[str]:
    told["formation"] = flown = in_virtual_time(lambda folder: fly_formation(folder, minutes=30.0))
    print(
        f"formation of {flown['vehicles']}, {flown['minutes']:g} min, {flown['spacing_m']:.2f} m apart (ages: "
        f"{flown['age_p95_s']:.2f} s p95): {len(flown['events'])} reports"
    )
    return [f"formation: {text}" for text in flown["events"]]


def cost(told: dict[str, Any]) -> list[str]:
    told["cost"] = []
    for row in cost_rows():
        told["cost"].append(row)
        print(
            f"{row['vehicles']:>3} vehicles, {row['layout']:<9} {row['conflicts']:>5} conflicts: "
            f"{row['took_ms']:.1f} ms an evaluation, longest turn {row['longest_turn_ms']:.2f} ms, "
            f"{row['share_percent']:.1f} % of a core"
        )
    return []


def lateness(told: dict[str, Any]) -> list[str]:
    told["lateness"] = []
    for row in lateness_rows():
        told["lateness"].append(row)
        print(
            f"{row['vehicles']:>3} vehicles, {row['layout']:<9} ticks late: p99 {row['p99_without_ms']:.2f} ms, "
            f"{row['p99_with_ms']:.2f} ms with the monitor ({row['ratio']:.2f}); at most "
            f"{row['most_without_ms']:.1f} and {row['most_with_ms']:.1f} ms"
        )
    return []


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.monitor", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", choices=("encounters", "formation", "cost", "lateness"))
    parser.add_argument("--encounters", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    began = time.monotonic()
    told: dict[str, Any] = {}
    missed: list[str] = []
    parts = {
        "cost": cost,
        "lateness": lateness,
        "encounters": lambda told: encounters(options.encounters, options.jobs, told),
        "formation": formation,
    }
    for name, part in parts.items():
        if options.only in (None, name):
            missed += part(told)
    told |= {"missed": missed, "seconds": round(time.monotonic() - began, 1)}
    print(f"\n{told['seconds']:.0f} s; all of it in {keep('monitor', told)}")
    for what in missed:
        print(f"MISSED: {what}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
