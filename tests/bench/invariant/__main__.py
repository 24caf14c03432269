"""`make bench-invariant`: random flights in virtual time, judged by the simulators' truth. build/bench/invariant.json.

No vehicle is unattended for longer than promised (`support.truth_monitor`), and no pair of a plan comes inside its
certified margin, nor two because of an order that was accepted (`support.random_orders`). A quarter of the flights
each: control and its end, plans, orders to three vehicles, a companion and its ground.

python -m bench.invariant [--flights 1000] [--first 0] [--jobs N]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import traceback
from collections.abc import Callable, Coroutine
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from bench.results import in_virtual_time, keep
from support.random_companions import fly_by_companion
from support.random_flights import Judged, fly_randomly
from support.random_orders import fly_by_orders
from support.random_plans import fly_a_plan

KINDS: dict[str, Callable[[Path, int], Coroutine[Any, Any, Judged]]] = {
    "orders": fly_randomly,
    "plan": fly_a_plan,
    "apart": fly_by_orders,
    "companion": fly_by_companion,
}
CYCLE = ("orders", "plan", "apart", "companion")
"""The kind of a flight follows from its seed, so that one can be flown again alone."""


def fly(seed: int) -> tuple[int, str, Judged | str]:
    """One flight; a text if it could not be flown to its end."""
    kind = CYCLE[seed % len(CYCLE)]

    def flight(folder: Path) -> Coroutine[Any, Any, Judged]:
        os.environ["XDG_CACHE_HOME"] = os.environ["XDG_STATE_HOME"] = str(folder)
        return KINDS[kind](folder, seed)

    try:
        return seed, kind, in_virtual_time(flight)
    except Exception:
        return seed, kind, traceback.format_exc(limit=-6)


def wrong(kind: str, judged: Judged | str) -> list[str]:
    """What this flight broke, in words."""
    if isinstance(judged, str):
        return [judged]
    alone = [
        f"v{b.sysid} unattended for {b.lasted_s:.2f} s from {b.since:.2f} on, last fed by {b.fed_by}: {b.text}"
        for b in judged.breaches
    ]
    return alone + [f"inside the margin of the {kind}: {text}" for text in judged.inside]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    began, told, failed = time.monotonic(), dict[str, Any](), 0
    sums = dict.fromkeys((*KINDS, "looked", "attended_again", "holds"), 0)
    with ProcessPoolExecutor(options.jobs) as pool:
        for seed, kind, judged in pool.map(fly, range(options.first, options.first + options.flights)):
            sums[kind] += 1
            found = wrong(kind, judged)
            failed += bool(found)
            if not isinstance(judged, str):
                for name in ("looked", "attended_again", "holds"):
                    sums[name] += getattr(judged, name)
            if found:
                deeds = () if isinstance(judged, str) else judged.done
                told[str(seed)] = {"kind": kind, "found": found, "done": deeds}
                print(f"seed {seed} ({kind}):", *found, *deeds, sep="\n    ", flush=True)
            flown = sum(sums[name] for name in KINDS)
            keep("invariant", {"flights": flown, "failed": failed, **sums, "wrong": told})
    print(
        f"{flown} flights ({', '.join(f'{sums[name]} {name}' for name in KINDS)}) in {time.monotonic() - began:.0f} s: "
        f"{failed} broke the invariant; {sums['looked'] / 20:.0f} s of flight by setpoints were looked at, "
        f"{sums['attended_again']} times nobody fed a vehicle and {sums['holds']} events say so"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
