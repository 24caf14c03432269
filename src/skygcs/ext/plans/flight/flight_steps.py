"""The steps in which a plan is flown: straight ways and trajectories, each on one clock, with a barrier after each.

    step         what each vehicle flies                                             certified
    ----------   -----------------------------------------------------------------   --------------------------------
    way there    climb, cross and descend from where it stands to its start          timing-free, with measured places
    way back     straight to where it has to be on its way, after a stop             timing-free, with measured places
    plan         the phases of a phased plan, or the trajectories of a timed one     as the plan is
    mission      all of that in one, where nobody waits for anybody                  free: without barriers

A vehicle that has nothing to do in a step stands. The next step begins when all were measured at their places.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from skygcs.core.plan.fleet_plan import Phase, PhasedPlan, Plan, TimedPlan
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory
from skygcs.core.trajectory.piecewise import MIN_PIECE_S, Vector
from skygcs.core.trajectory.splitting import shifted
from skygcs.core.trajectory.timing import SAME_PLACE_M, hover, path_within

Places = Mapping[str, Vector]


class StepKind(StrEnum):
    WAY_THERE = "way there"
    WAY_BACK = "way back"
    PLAN = "plan"


@dataclass(frozen=True, slots=True)
class FlightStep:
    """One step. ``trajectories`` has every vehicle; ``timed``: it has to be at a place at a time, else only on its
    straight way. ``corners``: the places of ways of several legs, from the first to the last."""

    name: str
    kind: StepKind
    trajectories: Mapping[str, Trajectory]
    timed: bool = False
    corners: Mapping[str, tuple[Vector, ...]] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        return max(trajectory.duration_s for trajectory in self.trajectories.values())

    def places(self) -> dict[str, Vector]:
        """Where each vehicle is at its end."""
        return {name: trajectory.end_enu_m for name, trajectory in self.trajectories.items()}

    def starts(self) -> dict[str, Vector]:
        """Where each vehicle is at its begin."""
        return {name: trajectory.start_enu_m for name, trajectory in self.trajectories.items()}

    def off_m(self, name: str, place_m: Vector, trajectory_s: float, downwash_ratio: float) -> float:
        """How far a vehicle is from where it may be, in the metric of the certificate: from its reference, or from its
        straight way."""
        trajectory = self.trajectories[name]
        place = scaled(place_m, downwash_ratio)
        if self.timed:
            return math.dist(place, scaled(trajectory.at(trajectory_s).pos_enu_m, downwash_ratio))
        places = self.corners.get(name) or (trajectory.start_enu_m, trajectory.end_enu_m)
        corners = [scaled(corner, downwash_ratio) for corner in places]
        return min(distance_to_leg(place, begin, end) for begin, end in itertools.pairwise(corners))


def steps_of(plan: Plan, limits: MotionLimits) -> list[FlightStep]:
    """The steps of a plan itself; phases are flown within ``limits``."""
    if isinstance(plan, TimedPlan):
        return [FlightStep("trajectories", StepKind.PLAN, dict(plan.trajectories), timed=True)]
    return phased_steps(plan, StepKind.PLAN, limits)


def phased_steps(plan: PhasedPlan, kind: StepKind, limits: MotionLimits) -> list[FlightStep]:
    """A step of each phase in which anybody moves."""
    found = []
    for name, legs in plan.legs():
        ways = {v: path_within(leg, limits) for v, leg in legs.items() if math.dist(*leg) > SAME_PLACE_M}
        if not ways:
            continue
        took_s = max(way.duration_s for way in ways.values())
        standing = {v: hover(leg[1], took_s) for v, leg in legs.items() if v not in ways}
        found.append(FlightStep(name, kind, {v: ways.get(v) or standing[v] for v in legs}))
    return found


def joined(plans: Sequence[PhasedPlan]) -> PhasedPlan:
    """The phases of all these plans, one after the other: each begins where the one before ended."""
    return PhasedPlan(plans[0].starts, tuple(phase for plan in plans for phase in plan.phases))


def free_step(plan: PhasedPlan, limits: MotionLimits) -> FlightStep:
    """The whole plan as one step in which nobody waits for anybody; certified by `certify` without barriers."""
    corners: dict[str, tuple[Vector, ...]] = {name: (start,) for name, start in plan.starts.items()}
    for _, legs in plan.legs():
        for name, (begin, end) in legs.items():
            if math.dist(begin, end) > SAME_PLACE_M:
                corners[name] += (end,)
    ways = {name: path_within(places, limits) for name, places in corners.items() if len(places) > 1}
    took_s = max((way.duration_s for way in ways.values()), default=1.0)
    flown = {name: ways.get(name) or hover(places[-1], took_s) for name, places in corners.items()}
    several = {name: places for name, places in corners.items() if len(places) > 1}
    return FlightStep("mission", StepKind.PLAN, flown, corners=several)


def starts_of(plan: Plan) -> dict[str, Vector]:
    """The first place of each vehicle."""
    if isinstance(plan, TimedPlan):
        return {name: trajectory.start_enu_m for name, trajectory in plan.trajectories.items()}
    return dict(plan.starts)


def ends_of(plan: Plan) -> dict[str, Vector]:
    """The last place of each vehicle."""
    if isinstance(plan, TimedPlan):
        return {name: trajectory.end_enu_m for name, trajectory in plan.trajectories.items()}
    legs = plan.legs()
    return {name: leg[1] for name, leg in legs[-1][1].items()} if legs else dict(plan.starts)


def renamed(plan: Plan, names: Mapping[str, str]) -> Plan:
    """The plan of these vehicles only: ``names`` maps names in the plan to names of the fleet."""
    if isinstance(plan, TimedPlan):
        return TimedPlan({names[name]: t for name, t in plan.trajectories.items() if name in names})
    phases = tuple(
        Phase(phase.name, {names[name]: goal for name, goal in phase.goals.items() if name in names})
        for phase in plan.phases
    )
    return PhasedPlan({names[name]: start for name, start in plan.starts.items() if name in names}, phases)


def rest_of(steps: list[FlightStep], trajectory_s: float, names: frozenset[str]) -> list[FlightStep]:
    """Return what is left of the steps for these vehicles, of which the first one has been flown up to
    ``trajectory_s``."""
    if not steps:
        return []
    first, *others = steps
    left = {v: remainder(t, trajectory_s) for v, t in first.trajectories.items() if v in names}
    rest = [FlightStep(first.name, first.kind, left, first.timed)]
    for step in others:
        own = {v: t for v, t in step.trajectories.items() if v in names}
        rest.append(FlightStep(step.name, step.kind, own, step.timed))
    return rest


def from_where(step: FlightStep, places: Places, downwash_ratio: float, limits: MotionLimits) -> FlightStep:
    """Return what is left of a step of straight legs: of each from its nearest point to the vehicle's place on. A part
    of a leg keeps what the whole one was certified to keep."""
    left: dict[str, Trajectory] = {}
    for name, trajectory in step.trajectories.items():
        begin, end = trajectory.start_enu_m, trajectory.end_enu_m
        part = part_of_leg(*(scaled(point, downwash_ratio) for point in (places[name], begin, end)))
        near = (
            begin[0] + part * (end[0] - begin[0]),
            begin[1] + part * (end[1] - begin[1]),
            begin[2] + part * (end[2] - begin[2]),
        )
        far = math.dist(near, end) > SAME_PLACE_M
        left[name] = path_within((near, end), limits) if far else hover(end, 1.0)
    return FlightStep(step.name, step.kind, left, step.timed)


def plan_of(step: FlightStep) -> Plan:
    """Return what is certified of a step."""
    if step.timed:
        return TimedPlan(step.trajectories)
    return PhasedPlan(step.starts(), (Phase(step.name, step.places()),))


def remainder(trajectory: Trajectory, from_s: float) -> Trajectory:
    """Return what is left of a trajectory from this time on; standing at its end, if nothing is."""
    pieces: list[Piece] = []
    for begin_s, piece in zip(trajectory.begins_s, trajectory.pieces, strict=True):
        skipped_s = max(0.0, from_s - begin_s)
        left_s = piece.duration_s - skipped_s
        if left_s < MIN_PIECE_S:
            continue
        if skipped_s == 0.0:
            pieces.append(piece)
            continue
        axes = [shifted(c, skipped_s) for c in (piece.east, piece.north, piece.up)]
        yaw = None if piece.yaw is None else shifted(piece.yaw, skipped_s)
        pieces.append(Piece(left_s, axes[0], axes[1], axes[2], yaw))
    if pieces:
        return Trajectory(pieces)
    return hover(trajectory.end_enu_m, 1.0, trajectory.at(trajectory.duration_s).yaw_rad)


def scaled(place_m: Vector, downwash_ratio: float) -> Vector:
    return place_m[0], place_m[1], place_m[2] / downwash_ratio


def distance_to_leg(place_m: Vector, begin_m: Vector, end_m: Vector) -> float:
    """The distance of a place from a straight way."""
    part = part_of_leg(place_m, begin_m, end_m)
    return math.dist(place_m, [a + part * (b - a) for a, b in zip(begin_m, end_m, strict=True)])


def part_of_leg(place_m: Vector, begin_m: Vector, end_m: Vector) -> float:
    """Which part of a straight way lies before its nearest point to a place, from 0 to 1."""
    way = [b - a for a, b in zip(begin_m, end_m, strict=True)]
    square = sum(w * w for w in way)
    if square == 0.0:
        return 0.0
    along = sum((p - a) * w for p, a, w in zip(place_m, begin_m, way, strict=True))
    return min(1.0, max(0.0, along / square))
