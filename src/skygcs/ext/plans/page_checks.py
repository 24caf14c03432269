"""Checks of the page: `check_plan_files` certifies a plan for the fleet from files, or makes one from starts and goals;
`check_positions` reads a table.

The answer of the first has the certificate, the paths for the page's timeline, and the plan as text in skygcs' own
format, which is what is flown. A certificate is never believed by the daemon: it certifies the plan again before it
flies it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Field

from skygcs.core.plan.fleet_plan import FlightSpace, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.formations import formation
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.plan.plan_files import NamedFile, read_together
from skygcs.core.plan.plan_json import write_plan_json
from skygcs.core.trajectory import MotionLimits, Trajectory
from skygcs.core.trajectory.piecewise import Vector
from skygcs.errors import RefusedError
from skygcs.ext.plans.certificates.certificate import Certificate
from skygcs.ext.plans.position_table import WHICH, parse_table
from skygcs.web.dropped import CheckRequest, DroppedFile, Metres, Name, OriginKeys, Place, Point, parsed

MAX_FILES = 255
MAX_ANSWER_NUMBERS = 120_000
"""Coefficients of all paths that the page gets exactly: some 1.5 MB of JSON. Longer plans are drawn by samples."""

SAMPLED_POINTS = 30_000
"""Points of all vehicles together in a plan that is drawn by samples."""

LEAST_SAMPLES = 60


class Assumptions(CheckRequest):
    """Terms of the margin, as options of `skygcs-cli plan check`; null: the default."""

    margin_m: Annotated[float, Field(gt=0, le=1000)] | None = None
    wingspan_m: Annotated[float, Field(ge=0, le=100)] | None = None
    position_error_m: Annotated[float, Field(ge=0, le=100)] | None = None
    tracking_error_m: Annotated[float, Field(ge=0, le=100)] | None = None
    delay_s: Annotated[float, Field(ge=0, le=100)] | None = None
    downwash_ratio: Annotated[float, Field(ge=1, le=20)] = 2.0

    def rule(self) -> MarginRule:
        names = ("wingspan_m", "position_error_m", "tracking_error_m", "delay_s")
        given = {name: value for name in names if (value := getattr(self, name)) is not None}
        return MarginRule(Uncertainty(**given), downwash_ratio=self.downwash_ratio, fixed_m=self.margin_m)


class Formation(CheckRequest):
    """The goals as a shape about a middle."""

    shape: Literal["line", "column", "v", "circle", "grid"]
    spacing_m: Annotated[float, Field(ge=0.1, le=1000)] = 5.0
    middle_m: Place
    yaw_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0


class Task(CheckRequest):
    """Where the vehicles are and where they are to be."""

    starts: Annotated[dict[Name, Place], Field(min_length=1, max_length=255)]
    goals: dict[Name, Place] | None = None
    formation: Formation | None = None
    exchange: bool = False
    """Any vehicle may take any goal; always so in a formation."""
    kind: Literal["auto", "timed", "phased"] = "auto"


class PlanCheck(CheckRequest):
    """Either files of one plan, or a task to plan."""

    files: Annotated[list[DroppedFile], Field(max_length=MAX_FILES)] | None = None
    task: Task | None = None
    assumptions: Assumptions = Assumptions()
    standing: dict[Name, Place] = Field(default_factory=dict, max_length=255)
    """Vehicles that take no part."""
    ceiling_m: Metres | None = None
    floor_m: Metres | None = None
    fence: list[Point] = Field(default_factory=list, max_length=1000)
    limits: Annotated[list[Annotated[float, Field(gt=0, le=100)]], Field(min_length=3, max_length=3)] | None = None
    """Speed, acceleration, jerk: for the timing of paths without times, and checked if they are given."""
    origin: OriginKeys | None = None


def check_plan_files(params: Mapping[str, Any]) -> dict[str, Any]:
    """web.plan.check. Raises SkygcsError."""
    asked = parsed(PlanCheck, params)
    if (not asked.files) == (asked.task is None):
        raise RefusedError("give either files or a task")
    rule = asked.assumptions.rule()
    motion = MotionLimits() if asked.limits is None else _motion(asked.limits)
    if asked.files:
        return _certified(asked, asked.files, rule, motion)
    assert asked.task is not None
    return _planned(asked, asked.task, rule, motion)


def _motion(limits: Sequence[float]) -> MotionLimits:
    speed, acceleration, jerk = limits
    default = MotionLimits()
    return MotionLimits(speed, acceleration, jerk, min(speed, default.climb_mps), min(speed, default.descent_mps))


def _space(asked: PlanCheck, own: FlightSpace) -> FlightSpace:
    """Return what the file says, and what the page adds or replaces."""
    if 0 < len(asked.fence) < 3:
        raise RefusedError("fence: a fence has three corners at least")
    standing = {name: _vector(place) for name, place in asked.standing.items()}
    return FlightSpace(
        tuple((x, y) for x, y in asked.fence) or own.fence,
        own.floor_m if asked.floor_m is None else asked.floor_m,
        own.ceiling_m if asked.ceiling_m is None else asked.ceiling_m,
        own.boxes,
        {**own.standing, **standing},
    )


def _vector(place: Sequence[float]) -> Vector:
    x, y, z = place
    return x, y, z


# --- files ------------------------------------------------------------------------------------------------------------


def _certified(
    asked: PlanCheck, files: Sequence[DroppedFile], rule: MarginRule, motion: MotionLimits
) -> dict[str, Any]:
    from skygcs.ext.plans.certificates.certify import certify

    origin = None if asked.origin is None else asked.origin.origin()
    found = read_together([NamedFile(file.name, file.content()) for file in files], motion, origin)
    if origin is None and found.origin is not None:
        raise RefusedError("its positions are by latitude and longitude, and the fleet has no origin yet")
    # a vehicle of the plan does not stand aside, wherever the page saw it
    names = found.plan.trajectories if isinstance(found.plan, TimedPlan) else found.plan.starts
    others = {name: place for name, place in asked.standing.items() if name not in names}
    space = _space(asked.model_copy(update={"standing": others}), found.space)
    certificate = certify(found.plan, rule, space, limits=None if asked.limits is None else motion)
    name = files[0].name if len(files) == 1 else f"{len(files)} files"
    what = "; ".join((found.format, *found.notes))
    return _answer(name, what, found.plan, space, certificate, motion)


# --- a task -----------------------------------------------------------------------------------------------------------


def _planned(asked: PlanCheck, task: Task, rule: MarginRule, motion: MotionLimits) -> dict[str, Any]:
    from skygcs.ext.plans.certificates import plan_search

    # the task: goals as given, or places of a formation
    if (task.goals is None) == (task.formation is None):
        raise RefusedError("task: give either goals or a formation")
    starts = {name: _vector(place) for name, place in task.starts.items()}
    shape = task.formation
    if shape is not None:
        middle = _vector(shape.middle_m)
        places = formation(shape.shape, len(starts), shape.spacing_m, middle, math.radians(shape.yaw_deg))
        goals = dict(zip(starts, places, strict=True))
    else:
        goals = {name: _vector(place) for name, place in (task.goals or {}).items()}
    # search a plan
    space = _space(asked, FlightSpace())
    exchange = task.exchange or shape is not None
    found = plan_search.make_plan(plan_search.Task(starts, goals, exchange, task.kind), rule, motion, space)
    attempts = [attempt.what for attempt in found.attempts]
    # no plan: answer with the reasons
    if found.plan is None or found.certificate is None:
        return {
            "name": "planned",
            "ok": False,
            "format": "planned here",
            "kind": None,
            "certificate": None if found.certificate is None else found.certificate.as_dict(),
            "reasons": found.reasons(),
            "attempts": attempts,
            "goals": {name: list(place) for name, place in goals.items()},
            "paths": None,
            "text": None,
        }
    answer = _answer("planned", "planned here", found.plan, space, found.certificate, motion)
    return answer | {"attempts": attempts, "reasons": found.reasons()}


# --- the answer -------------------------------------------------------------------------------------------------------


def _answer(
    name: str, what: str, plan: Plan, space: FlightSpace, certificate: Certificate, motion: MotionLimits
) -> dict[str, Any]:
    trajectories = plan.trajectories if isinstance(plan, TimedPlan) else plan.trajectories(motion)
    return {
        "name": name,
        "ok": certificate.certified,
        "format": what,
        "kind": certificate.kind,
        "certificate": certificate.as_dict(),
        "reasons": certificate.reasons(),
        "attempts": [],
        "goals": {vehicle: list(path.end_enu_m) for vehicle, path in trajectories.items()},
        "paths": paths_of(trajectories, _phase_names(plan)),
        "space": {
            "fence": [list(corner) for corner in space.fence],
            "floor_m": space.floor_m,
            "ceiling_m": space.ceiling_m,
            "boxes": [[list(least), list(greatest)] for least, greatest in space.boxes],
            "standing": {vehicle: list(place) for vehicle, place in space.standing.items()},
        },
        "text": write_plan_json(plan, space, certificate.as_dict()),
    }


def _phase_names(plan: Plan) -> list[str]:
    return [phase.name for phase in plan.phases] if isinstance(plan, PhasedPlan) else []


def paths_of(trajectories: Mapping[str, Trajectory], phases: Sequence[str] = ()) -> dict[str, Any]:
    """Return what the timeline draws: by vehicle, pieces [duration_s, [east…], [north…], [up…]] with ascending
    coefficients.

    ``exact`` is false where the plan is too long for that and each piece is a straight line between two samples.
    """
    numbers = sum(len(p.east) + len(p.north) + len(p.up) + 1 for t in trajectories.values() for p in t.pieces)
    exact = numbers <= MAX_ANSWER_NUMBERS
    count = max(LEAST_SAMPLES, SAMPLED_POINTS // max(1, len(trajectories)))
    return {
        "exact": exact,
        "duration_s": max(t.duration_s for t in trajectories.values()),
        "phases": list(phases),
        "vehicles": {
            name: [[p.duration_s, p.east, p.north, p.up] for p in t.pieces] if exact else _sampled(t, count)
            for name, t in trajectories.items()
        },
    }


def _sampled(trajectory: Trajectory, count: int) -> list[list[Any]]:
    """The path as ``count`` straight pieces."""
    step = trajectory.duration_s / count
    points = [trajectory.at(trajectory.duration_s * k / count).pos_enu_m for k in range(count + 1)]
    return [
        [step, *([round(a, 3), round((b - a) / step, 6)] for a, b in zip(begin, end, strict=True))]
        for begin, end in pairwise(points)
    ]


class PositionsCheck(CheckRequest):
    """A table of initial and final positions."""

    file: DroppedFile


def check_positions(params: Mapping[str, Any]) -> dict[str, Any]:
    """web.positions.check: the positions of a table, by the names that the file has."""
    file = parsed(PositionsCheck, params).file
    table = parse_table(file.name, file.content())
    return {
        "name": file.name,
        "vehicles": {
            name: {which: None if (spot := places.get(which)) is None else list(spot.position_m) for which in WHICH}
            for name, places in table.items()
        },
        "headings": any(spot.heading_deg is not None for places in table.values() for spot in places.values()),
    }
