"""The certificate of a plan: separation of all pairs, distance from standing vehicles, fence, ceiling, floor and boxes.

Nothing is sampled: timed plans by Bernstein forms (`closest_approach`), phased plans by the exact distance of straight
corridors (`segment_distance`), walls by convex hulls (`space_check`). In a phased plan a vehicle may be anywhere on its
leg at any time, so nothing about its timing enters. Without barriers (``barriers=False``) it may be on any of its legs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skygcs.core.plan.fleet_plan import FlightSpace, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.margins import MarginRule, Motion
from skygcs.core.plan.segment_distance import SLACK_M, scaled, segment_segment
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory, joints, require_continuous, require_within
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.trajectory.timing import hover
from skygcs.errors import RefusedError, TrajectoryError
from skygcs.ext.plans.certificates.bernstein_arrays import UNIT, gathered, halved, squared_norm
from skygcs.ext.plans.certificates.certificate import Approach, Certificate, SpaceProblem
from skygcs.ext.plans.certificates.closest_approach import Progress, least_clearance
from skygcs.ext.plans.certificates.space_check import Breach, breaches

MAX_NAMED = 20
"""Pairs and walls named in one refusal."""

HALVINGS = 3
"""Halvings of each piece for its largest speed: eight parts of degree 7 bound it to some per mille."""

STILL = Motion()


def certify(
    plan: Plan,
    rule: MarginRule,
    space: FlightSpace | None = None,
    *,
    limits: MotionLimits | Mapping[str, MotionLimits] | None = None,
    progress: Progress | None = None,
    barriers: bool = True,
) -> Certificate:
    """Judge the plan; ``limits``: the speeds and accelerations of a timed plan as well, of all vehicles or by name;
    ``barriers``: in a phased plan nobody begins a phase before all have ended the one before.

    Raises TrajectoryError where a trajectory jumps, RefusedError for names that are there twice.
    """
    space = space or FlightSpace()
    names = plan.trajectories if isinstance(plan, TimedPlan) else plan.starts
    if both := names.keys() & space.standing.keys():
        raise RefusedError(f"{min(both)} takes part in the plan and is named as standing, too")
    if isinstance(plan, TimedPlan):
        return _certify_timed(plan, rule, space, limits, progress)
    return _certify_phased(plan, rule, space, progress, barriers=barriers)


# --- timed ------------------------------------------------------------------------------------------------------------


def _certify_timed(
    plan: TimedPlan,
    rule: MarginRule,
    space: FlightSpace,
    limits: MotionLimits | Mapping[str, MotionLimits] | None,
    progress: Progress | None,
) -> Certificate:
    # each trajectory by itself: continuous, and within the limits of its vehicle
    too_fast = []
    for name, trajectory in plan.trajectories.items():
        try:
            require_continuous(trajectory)
        except TrajectoryError as error:
            raise TrajectoryError(f"vehicle {name}: {error}") from None
        try:
            own = limits.get(name) if isinstance(limits, Mapping) else limits
            if own is not None:
                require_within(trajectory, own)
        except TrajectoryError as error:
            too_fast.append(f"{name}: {error}")
    # the fleet: what flies, and what stands where it is for as long
    motions = dict(zip(plan.trajectories, motions_of(list(plan.trajectories.values())), strict=True))
    duration_s = max(t.duration_s for t in plan.trajectories.values())
    fleet = {**plan.trajectories, **{name: hover(place, duration_s) for name, place in space.standing.items()}}
    names = list(fleet)
    motions |= {name: STILL for name in space.standing}
    # the least distance of all pairs against the margins of both
    half = [rule.half_m(name, motions[name]) for name in names]
    found = least_clearance(
        list(fleet.values()), half, rule.downwash_ratio, standing=len(space.standing), progress=progress
    )
    closest = None
    if found is not None:
        one, other = names[found.first], names[found.second]
        closest = Approach(
            (one, other),
            found.distance_m,
            found.distance_at_least_m,
            half[found.first] + half[found.second],
            {name: rule.terms(name, motions[name]) for name in (one, other)},
            (fleet[one].at(found.t_s).pos_enu_m, fleet[other].at(found.t_s).pos_enu_m),
            t_s=found.t_s,
            sources={name: rule.sources(name) for name in (one, other)},
        )
    # walls, floor and ceiling
    moving = len(plan.trajectories)
    walls = breaches(list(plan.trajectories.values()), half[:moving], space)
    problems = tuple(_problem(names, half, breach) for breach in walls[:MAX_NAMED])
    safe = found is None or found.clearance_at_least_m >= 0.0
    return Certificate(
        safe and not problems and not too_fast,
        "timed",
        moving,
        rule.downwash_ratio,
        closest,
        () if safe or closest is None else (closest,),
        problems,
        duration_s,
        tuple(too_fast[:MAX_NAMED]),
    )


def motions_of(trajectories: Sequence[Trajectory]) -> list[Motion]:
    """Largest speeds (bounded from above, to some per mille) and jumps."""
    pieces = gathered(trajectories)
    degree = pieces.bernstein.shape[0] - 1
    length = pieces.end_s - pieces.begin_s
    speeds = np.zeros(len(length))
    if degree:
        parts, count = degree * np.diff(pieces.bernstein, axis=0) / length, len(length)
        for _ in range(HALVINGS):
            parts = np.concatenate(halved(parts), axis=2)
        square = squared_norm(parts).max(axis=0).reshape(-1, count).max(axis=0)
        largest = (np.abs(parts).max(axis=0) ** 2).sum(axis=0).reshape(-1, count).max(axis=0)
        slack = 2.0 * 1.7320509 * degree * pieces.error_m / length
        speeds = np.sqrt(square + (4 * degree + 16) * UNIT * largest) * (1.0 + 4 * UNIT) + slack
    found = []
    for index, trajectory in enumerate(trajectories):
        jumps = list(joints(trajectory))
        found.append(
            Motion(
                float(speeds[pieces.first[index] : pieces.first[index + 1]].max()),
                max(joint.velocity_mps for joint in jumps),
                max(joint.position_m for joint in jumps),
            )
        )
    return found


def _problem(names: Sequence[str], half: Sequence[float], breach: Breach, phase: str | None = None) -> SpaceProblem:
    return SpaceProblem(
        names[breach.vehicle],
        breach.what,
        breach.distance_m,
        0.0 if breach.what == "the floor" else half[breach.vehicle],
        breach.place_m,
        breach.t_s if phase is None else None,
        phase,
    )


# --- phased -----------------------------------------------------------------------------------------------------------


Legs = Mapping[str, tuple[Vector, Vector]]


def _certify_phased(
    plan: PhasedPlan, rule: MarginRule, space: FlightSpace, progress: Progress | None, *, barriers: bool
) -> Certificate:
    # legs of each phase; what stands has a leg from its place to its place
    names = [*plan.starts, *space.standing]
    half = [rule.half_m(name) for name in names]
    standing = {name: (place, place) for name, place in space.standing.items()}
    phases = [(phase, {**legs, **standing}) for phase, legs in plan.legs()]
    worst: Approach | None = None
    too_close: list[Approach] = []
    problems: list[SpaceProblem] = []
    # all pairs: in the same phase, and without barriers one vehicle in this phase and the other in any earlier one
    for number, (phase, legs) in enumerate(phases):
        if progress is not None:
            progress(number, len(phases))
        met: list[tuple[str, Legs, Legs]] = [(phase, legs, legs)]
        for earlier, others in phases[:number] if not barriers else ():
            met += [(f"{earlier} and {phase}", others, legs), (f"{earlier} and {phase}", legs, others)]
        for text, of_first, of_second in met:
            least_m = np.inf if worst is None else worst.clearance_m
            for approach in _approaches(text, names, (of_first, of_second), half, rule, len(plan.starts), least_m):
                if worst is None or approach.clearance_m < worst.clearance_m:
                    worst = approach
                if approach.clearance_m < SLACK_M and len(too_close) < MAX_NAMED:
                    too_close.append(approach)
        # walls, phase by phase
        if space.has_walls and len(problems) < MAX_NAMED:
            curves = [_line(*legs[name]) for name in plan.starts]
            problems += [
                _problem(names, half, breach, phase) for breach in breaches(curves, half[: len(curves)], space)
            ]
    return Certificate(
        not too_close and not problems,
        "phased" if barriers else "free",
        len(plan.starts),
        rule.downwash_ratio,
        worst,
        tuple(sorted(too_close, key=lambda approach: approach.clearance_m)),
        tuple(problems[:MAX_NAMED]),
    )


def _approaches(
    phase: str,
    names: Sequence[str],
    legs: tuple[Legs, Legs],
    half: Sequence[float],
    rule: MarginRule,
    moving: int,
    least_m: float,
) -> list[Approach]:
    """The pair with the least clearance, if that is below ``least_m``, and all pairs within the margin. ``legs``: of
    the first vehicle of each pair, and of the second."""
    first, second = np.triu_indices(len(names), 1)
    keep = first < moving  # two that stand are not compared
    first, second = first[keep], second[keep]
    if not len(first):
        return []
    begins, other_begins = (scaled([part[name][0] for name in names], rule.downwash_ratio) for part in legs)
    ends, other_ends = (scaled([part[name][1] for name in names], rule.downwash_ratio) for part in legs)
    margins = np.asarray(half)
    # by their balls and their begins most pairs cannot be the nearest one
    (middles, radii), (other_middles, other_radii) = (
        ((a + b) / 2.0, np.sqrt(((b - a) ** 2).sum(axis=1)) / 2.0 + margins)
        for a, b in ((begins, ends), (other_begins, other_ends))
    )
    at_least = np.sqrt(((middles[first] - other_middles[second]) ** 2).sum(axis=1))
    at_least -= radii[first] + other_radii[second]
    at_begin = np.sqrt(((begins[first] - other_begins[second]) ** 2).sum(axis=1)) - margins[first] - margins[second]
    near = at_least - SLACK_M < max(2.0 * SLACK_M, min(least_m, float(at_begin.min())))
    first, second = first[near], second[near]
    if not len(first):
        return []
    # the others by the exact distance
    distance, part_1, part_2 = segment_segment(begins[first], ends[first], other_begins[second], other_ends[second])
    clearance = distance - margins[first] - margins[second]
    order = np.argsort(clearance)
    found = []
    for index in order[: max(1, min(MAX_NAMED, int((clearance < SLACK_M).sum())))]:
        one, other = names[first[index]], names[second[index]]
        found.append(
            Approach(
                (one, other),
                float(distance[index]),
                float(distance[index]) - SLACK_M,
                float(margins[first[index]] + margins[second[index]]),
                {name: rule.terms(name) for name in (one, other)},
                (_on(legs[0][one], float(part_1[index])), _on(legs[1][other], float(part_2[index]))),
                phase=phase,
                sources={name: rule.sources(name) for name in (one, other)},
            )
        )
    return found


def _on(leg: tuple[Vector, Vector], part: float) -> Vector:
    east, north, up = (a + part * (b - a) for a, b in zip(*leg, strict=True))
    return east, north, up


def _line(begin: Vector, end: Vector) -> Trajectory:
    """The leg as a curve over one second."""
    east, north, up = ((a, b - a) for a, b in zip(begin, end, strict=True))
    return Trajectory((Piece(1.0, east, north, up),))
