"""Random plans, judged by the certificate and by the independent checker."""

from __future__ import annotations

import math
import random
from typing import Any, NamedTuple

from bench.plans import checker
from skygcs.core.plan.fleet_plan import FlightSpace, PhasedPlan, TimedPlan
from skygcs.core.plan.margins import MarginRule
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory
from skygcs.ext.plans.certificates.certify import certify
from skygcs.ext.plans.certificates.plan_search import Task, make_plan

RATIO = 2.0
MARGIN_M = 2.5
RULE = MarginRule(fixed_m=MARGIN_M, downwash_ratio=RATIO)
LIMITS = MotionLimits()
KINDS = ("polynomials", "search")

LOOSE_M = 1e-3
"""Distances of less than a tenth of a metre are compared absolutely."""


class Judged(NamedTuple):
    """One instance."""

    kind: str
    certified: bool
    reported_m: float
    checked_m: float
    violation: bool
    """Certified, and the checker found less than the margin; or refused although the checker found enough."""
    loose: bool
    """The reported distance differs from the checked one by more than 1 %."""


def judge(seed: int) -> Judged:
    """The instance of this seed: polynomials and searches take turns."""
    rng = random.Random(seed)
    return _polynomials(rng) if seed % 2 == 0 else _search(rng)


def _polynomials(rng: random.Random) -> Judged:
    count = rng.randint(2, 5)
    room = rng.choice((6.0, 12.0, 25.0))
    plan = TimedPlan({f"v{i}": _curve(rng, room) for i in range(count)})
    found = certify(plan, RULE)
    checked = checker.least_distance(dict(plan.trajectories), RATIO)
    assert found.closest is not None and checked is not None
    margin = found.closest.margin_m
    return _verdict("polynomials", found.certified, found.closest.distance_m, checked.distance_m, margin)


def _search(rng: random.Random) -> Judged:
    count = rng.randint(2, 9)
    starts, goals = _places(rng, count), _places(rng, count)
    names = [f"v{i}" for i in range(count)]
    standing = {"still": starts.pop()} if count > 3 and rng.random() < 0.3 else {}
    goals = goals[: len(starts)]
    space = FlightSpace(ceiling_m=rng.choice((None, 18.0, 30.0)), standing=standing)
    task = Task(
        dict(zip(names, starts, strict=False)), dict(zip(names, goals, strict=False)), exchangeable=rng.random() < 0.5
    )
    found = make_plan(task, RULE, LIMITS, space)
    if found.plan is None or found.certificate is None or found.certificate.closest is None:
        return Judged("search", False, 0.0, 0.0, False, False)
    reported = found.certificate.closest.distance_m
    if isinstance(found.plan, PhasedPlan):
        least = [
            checker.least_distance_of_legs({**legs, **{n: (p, p) for n, p in standing.items()}}, RATIO)
            for _, legs in found.plan.legs()
        ]
        checked = min(pair.distance_m for pair in least if pair is not None)
    else:
        pair = checker.least_distance(dict(found.plan.trajectories), RATIO, standing)
        assert pair is not None
        checked = pair.distance_m
    return _verdict("search", True, reported, checked, MARGIN_M)


def _verdict(kind: str, certified: bool, reported: float, checked: float, margin: float) -> Judged:
    """The checker's distance is at most `checker.PRECISION` above the true one, never below it."""
    wrong = checked < margin if certified else checked >= margin * (1.0 + 2.0 * checker.PRECISION)
    loose = abs(reported - checked) > max(0.01 * checked, LOOSE_M)
    return Judged(kind, certified, reported, checked, wrong, loose)


def _places(rng: random.Random, count: int) -> list[Any]:
    """At least 3 m apart, at heights of 8 to 12 m."""
    found: list[tuple[float, float, float]] = []
    while len(found) < count:
        place = (rng.uniform(0, 25), rng.uniform(0, 25), rng.uniform(8, 12))
        if all(math.dist((*place[:2], place[2] / RATIO), (*p[:2], p[2] / RATIO)) > 3.0 for p in found):
            found.append(place)
    return found


def _curve(rng: random.Random, room: float) -> Trajectory:
    """Pieces of degree 3, 5 or 7 from point to point; velocities and accelerations agree where they meet."""
    order = rng.choice((2, 3, 4))
    state = [[rng.uniform(-room, room) * (0.3 if axis == 2 else 1.0), 0.0, 0.0, 0.0] for axis in range(3)]
    pieces = []
    for _ in range(rng.randint(1, 4)):
        duration = rng.uniform(1.0, 6.0)
        axes = []
        for axis in range(3):
            goal = [rng.uniform(-room, room) * (0.3 if axis == 2 else 1.0), rng.gauss(0, 1), rng.gauss(0, 0.5), 0.0]
            axes.append(_between(state[axis][:order], goal[:order], duration))
            state[axis] = goal
        pieces.append(Piece(duration, *axes))
    return Trajectory(pieces)


def _between(begin: list[float], end: list[float], duration: float) -> tuple[float, ...]:
    """The polynomial with these derivatives at both ends: Hermite, by elimination."""
    import numpy as np

    n = len(begin)
    matrix, right = np.zeros((2 * n, 2 * n)), np.array([*begin, *end])
    for d in range(n):
        matrix[d, d] = math.factorial(d)
        for k in range(d, 2 * n):
            matrix[n + d, k] = math.factorial(k) / math.factorial(k - d) * duration ** (k - d)
    return tuple(float(c) for c in np.linalg.solve(matrix, right))
