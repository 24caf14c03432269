"""`make bench-plans`: how fast plans are certified (CPU seconds), whether any certificate is wrong, and how far
apart vehicles stay that fly plans.

A table on stdout, all in build/bench/plans.json.

python -m bench.plans [--first N] [--instances N] [--jobs N]
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from statistics import median
from typing import Any

from bench.plans import flights, goto_flights, tick_lateness
from bench.plans.random_plans import LIMITS, RULE, Judged, _between, judge
from bench.plans.refusals import grid
from bench.results import OUT, in_virtual_time, keep
from skygcs.core.plan.fleet_plan import TimedPlan
from skygcs.core.trajectory import Piece, Trajectory
from skygcs.ext.plans.certificates.certify import certify
from skygcs.ext.plans.certificates.plan_search import Task, make_plan
from support.dry_runs import Judged as DryRuns
from support.dry_runs import judge as judge_dry_runs

DRY_DAEMONS = 180
"""Eight plans each: a thousand are flown, and some hundred refused ones are carried on from."""

SEEDS = range(5)


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.plans", description=__doc__.splitlines()[0])
    parser.add_argument("--instances", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="the seed of the first instance")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--no-ticks", action="store_true", help="leave out the daemon in real time")
    options = parser.parse_args()
    began = time.monotonic()
    answer: dict[str, Any] = {"missed": []}

    def note(part: str, found: Any, missed: list[str]) -> None:
        """What there is so far: flights and 10,000 instances take an hour, and may be ended before."""
        answer[part] = found
        answer["missed"] += missed
        answer["seconds"] = round(time.monotonic() - began, 1)
        keep("plans", answer)

    speeds = [_labelled(50), _exchangeable(100), _pieces(50, 20), _pieces(50, 100), _pieces(100, 20), _swap(50)]
    for row in speeds:
        limit = "" if row["most_s"] is None else f"  (at most {row['most_s']:g} s)"
        print(f"{row['what']:58} {row['median_s']:7.3f} s, slowest {row['slowest_s']:.3f} s{limit}  {row['note']}")
    note("speed", speeds, [r["what"] for r in speeds if r["most_s"] is not None and r["median_s"] > r["most_s"]])
    with ProcessPoolExecutor(options.jobs) as pool:
        for judged in _growing(pool.map(judge, range(options.first, options.instances))):
            instances = {"first": options.first, **_summary(judged)}
            wrong = ["random plans"] if instances["violations"] or instances["loose"] else []
            note("instances", instances, wrong if "random plans" not in answer["missed"] else [])
        print(json.dumps(answer.get("instances"), indent=2), flush=True)
        slow = [row for share in pool.map(goto_flights.flown, goto_flights.cases()) for row in share]
        flown = [row for share in pool.map(flights.flights, flights.SHARES) for row in share]
        dry = DryRuns()
        for one in pool.map(dry_runs, range(DRY_DAEMONS)):
            dry += one
    print(f"dry runs: {dry.passed} passed, {dry.flown} flown to their ends, {dry.refused} refused, {dry.led_on} led on")
    note("dry_runs", asdict(dry), dry.faults)
    for row in slow:
        print(goto_flights.text(row))
    note("goto", slow, [f"by {r['by']}: {r['flight']} of {r['vehicles']}" for r in slow if not r["met"]])
    for row in flown:
        print(flights.text(row))
    note("flights", flown, [f"flight: {row['flight']}" for row in flown if not row["met"]])
    ticks = None if options.no_ticks else tick_lateness.measured()
    print(json.dumps(ticks, indent=2))
    note("control_ticks", ticks, [])
    print(f"{answer['seconds']:.0f} s; {len(answer['missed'])} missed; all of it in {OUT / 'plans.json'}")
    return 1 if answer["missed"] else 0


def dry_runs(seed: int) -> DryRuns:
    """Random plans of one daemon, in virtual time."""
    return in_virtual_time(lambda folder: judge_dry_runs(seed, folder))


def _timed(what: str, most_s: float | None, runs: list[Any], note: str = "") -> dict[str, Any]:
    times, notes = [], []
    for run in runs:
        began = time.process_time()  # the machine may be busy with other things
        notes.append(run())
        times.append(time.process_time() - began)
    return {
        "what": what,
        "most_s": most_s,
        "median_s": round(median(times), 4),
        "slowest_s": round(max(times), 4),
        "note": note or ", ".join(sorted(set(notes))),
    }


def _searching(count: int, exchangeable: bool, seed: int) -> Callable[[], str]:
    starts = grid(count)
    names = [f"v{i}" for i in range(count)]
    rng = random.Random(seed)
    goals = list(starts)
    if exchangeable:  # another formation beside the first: its own places would be an answer without a plan
        goals = [(60.0 + 1.2 * x, y + 8.0 * math.sin(x), z) for x, y, z in starts]
    rng.shuffle(goals)
    return _run(Task(dict(zip(names, starts, strict=True)), dict(zip(names, goals, strict=True)), exchangeable))


def _run(task: Task) -> Callable[[], str]:
    def run() -> str:
        found = make_plan(task, RULE, LIMITS)
        assert found.plan is not None, found.reasons()
        return found.attempts[-1].what

    return run


def _labelled(count: int) -> dict[str, Any]:
    runs = [_searching(count, False, seed) for seed in SEEDS]
    return _timed(f"{count} labelled on a 5 m grid, random permutation", 2.0, runs)


def _exchangeable(count: int) -> dict[str, Any]:
    runs = [_searching(count, True, seed) for seed in SEEDS]
    return _timed(f"{count} exchangeable, grid to another formation", 0.5, runs)


def _pieces(count: int, pieces: int) -> dict[str, Any]:
    runs = []
    for seed in SEEDS:
        rng = random.Random(seed)
        plan = TimedPlan({f"v{i}": _flown(rng, place, pieces) for i, place in enumerate(grid(count, 8.0))})
        runs.append(lambda plan=plan: f"certified: {certify(plan, RULE).certified}")
    limit = 0.5 if (count, pieces) == (50, 20) else None
    return _timed(f"certificate of {count} x {pieces} pieces of degree 7", limit, runs)


def _flown(rng: random.Random, place: tuple[float, float, float], pieces: int) -> Trajectory:
    """Around a place, at most some 2 m from it."""
    state = [[value, 0.0, 0.0, 0.0] for value in place]
    found = []
    for number in range(pieces):
        duration = rng.uniform(2.0, 6.0)
        axes = []
        for axis in range(3):
            slow = 0.0 if number == pieces - 1 else rng.uniform(-0.4, 0.4)
            goal = [place[axis] + rng.uniform(-1.2, 1.2), slow, 0.0, 0.0]
            axes.append(_between(state[axis], goal, duration))
            state[axis] = goal
        found.append(Piece(duration, *axes))
    return Trajectory(found)


def _swap(count: int) -> dict[str, Any]:
    """As "Swap50" of Hönig et al.: two groups on opposite sides exchange sides, each to its own goal."""
    half = count // 2
    left = [(-20.0 - 5.0 * (i % 5), 5.0 * (i // 5), 10.0) for i in range(half)]
    right = [(-x, y, z) for x, y, z in left]
    names = [f"v{i}" for i in range(count)]
    runs = []
    for seed in SEEDS:
        rng = random.Random(seed)
        to_left, to_right = rng.sample(left, half), rng.sample(right, half)
        starts, goals = dict(zip(names, left + right, strict=True)), dict(zip(names, to_right + to_left, strict=True))
        runs.append(_run(Task(starts, goals)))
    return _timed(f"free-space swap of {count}, labelled", None, runs)


def _growing(judged: Iterable[Judged], by: int = 50) -> Iterator[list[Judged]]:
    """All so far, each time so many more have come, and all."""
    found: list[Judged] = []
    for one in judged:
        found.append(one)
        if len(found) % by == 0:
            yield found
    if len(found) % by:
        yield found


def _summary(judged: list[Judged]) -> dict[str, Any]:
    tight = [abs(j.reported_m - j.checked_m) / j.checked_m for j in judged if j.checked_m > 0.1]
    return {
        "instances": len(judged),
        "certified": sum(j.certified for j in judged),
        "refused": sum(not j.certified for j in judged),
        "violations": sum(j.violation for j in judged),
        "loose": sum(j.loose for j in judged),
        "largest_difference_percent": round(100 * max(tight, default=0.0), 4),
        "least_certified_m": round(min((j.checked_m for j in judged if j.certified), default=0.0), 4),
    }


if __name__ == "__main__":
    sys.exit(main())
