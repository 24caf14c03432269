"""Makes the steps of a flight from a plan and from where the vehicles were measured, and certifies them. numpy.

    way        from → to                          tried in this order, the first certified one is flown
    --------   --------------------------------   -------------------------------------------------------------------
    there      where they stand → their starts    up to the start's height, then level; climb, cross, descend in layers
    back       where they are → their references  straight; then as above
    down       where they are → the ground        all at once; one after the other, the lowest first

A phased plan that begins on the ground under vehicles that stand there begins with their take-off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.margins import JUMPS, TIMING, MarginRule, Uncertainty
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.trajectory.timing import hover
from skygcs.errors import RefusedError, SkygcsError
from skygcs.ext.plans.certificates.certificate import Certificate
from skygcs.ext.plans.certificates.certify import certify, motions_of
from skygcs.ext.plans.certificates.layered_flight import LIFT_M, layered
from skygcs.ext.plans.flight.flight_situation import Prepared, Situation
from skygcs.ext.plans.flight.flight_steps import (
    FlightStep,
    StepKind,
    free_step,
    joined,
    phased_steps,
    plan_of,
    starts_of,
    steps_of,
)
from skygcs.ext.plans.flight.guidance import Guidance, level_or_vertical
from skygcs.ext.plans.flight.sights import Tubes

LEAST_TUBE_M = 0.3
"""A measured tracking error below it is not demanded at barriers: positions are noisy."""

AT_PLACE_M = 1.0
"""Starts of a plan so near to where a vehicle stands are meant to be there."""

Places = Mapping[str, Vector]


@dataclass(slots=True)
class _Problems:
    lines: list[str] = field(default_factory=list)
    vehicles: list[str | None] = field(default_factory=list)

    def add(self, line: str, vehicle: str | None = None) -> None:
        self.lines.append(line)
        self.vehicles.append(vehicle)

    def of(self, what: str, certificate: Certificate) -> None:
        for reason in certificate.reasons():
            self.add(f"{what}: {reason}")


def prepare(situation: Situation) -> Prepared:
    """The flight from where the vehicles stand to the end of the plan; with `problems` it must not be flown."""
    problems = _Problems()
    # the plan from where the vehicles are, and whether its heights are above the ground
    plan = _from_the_air(situation)
    if situation.by.own_way and isinstance(plan, PhasedPlan):
        plan = level_or_vertical(plan)
    ground_m = _ground_m(situation)
    _check_heights(plan, situation, ground_m, problems)
    if problems.lines:
        return Prepared((), None, None, None, tuple(problems.lines), tuple(problems.vehicles))
    # the plan itself, with what is measured now
    rule = at_speed(situation.rule, situation.speed_factor)
    try:
        certificate = certify(plan, rule, situation.space)
        own = steps_of(plan, situation.limits)
        way = way_between(situation, starts_of(plan))
        if situation.by is Guidance.MISSION and certificate.certified and way.plan is not None:
            return _mission(situation, plan, way, rule)
    except SkygcsError as error:
        return Prepared((), None, None, None, (str(error),), (None,))
    if not certificate.certified:
        problems.of("the plan", certificate)
    # what forbids it, and the steps of what is left
    if way.plan is None:
        for line in way.reasons:
            problems.add(f"the way to the starts: {line}")
    steps = [] if way.plan is None else phased_steps(way.plan, StepKind.WAY_THERE, situation.limits)
    return Prepared(
        (*_after_takeoff(steps, situation), *own),
        tubes_of(rule, plan),
        way.certificate,
        certificate,
        tuple(problems.lines),
        tuple(problems.vehicles),
    )


def _mission(situation: Situation, plan: Plan, way: Way, rule: MarginRule) -> Prepared:
    """The way there and the plan as one step, in which nobody waits for anybody. Raises TrajectoryError."""
    assert isinstance(plan, PhasedPlan) and way.plan is not None
    there = _from_top(way.plan, situation.grounded)
    whole = joined((there, plan))
    certificate = certify(whole, rule, _without_floor(situation.space, whole.starts), barriers=False)
    problems = _Problems()
    if not certificate.certified:
        problems.of("as missions, without barriers", certificate)
    return Prepared(
        (free_step(whole, situation.limits),),
        tubes_of(rule, plan),
        way.certificate,
        certificate,
        tuple(problems.lines),
        tuple(problems.vehicles),
    )


def _from_top(plan: PhasedPlan, grounded: frozenset[str]) -> PhasedPlan:
    """The way there without its first phase for those on the ground, whose take-off that is."""
    if not grounded or not plan.phases:
        return plan
    first, *others = plan.phases
    starts = {name: first.goals.get(name, start) if name in grounded else start for name, start in plan.starts.items()}
    left = {name: goal for name, goal in first.goals.items() if name not in grounded}
    return PhasedPlan(starts, (Phase(first.name, left), *others) if left else tuple(others))


def prepare_return(situation: Situation, rest: Sequence[FlightStep]) -> Prepared:
    """After a stop: the way back from where the vehicles of ``measured`` are, and the rest, certified anew."""
    problems = _Problems()
    rule = at_speed(situation.rule, situation.speed_factor)
    worst: Certificate | None = None
    timed = [step for step in rest if step.timed]
    try:
        way = way_between(situation, rest[0].starts(), straight=True)
        for step in rest:
            certificate = certify(plan_of(step), rule, situation.space)
            worst = certificate if worst is None or _clearance(certificate) < _clearance(worst) else worst
            if not certificate.certified:
                problems.of(step.name, certificate)
    except SkygcsError as error:
        return Prepared((), None, None, None, (str(error),), (None,))
    for line in way.reasons if way.plan is None else ():
        problems.add(f"the way back: {line}")
    steps = [] if way.plan is None else phased_steps(way.plan, StepKind.WAY_BACK, situation.limits)
    tubes = tubes_of(rule, plan_of(timed[0] if timed else rest[0]))
    return Prepared((*steps, *rest), tubes, way.certificate, worst, tuple(problems.lines), tuple(problems.vehicles))


def _clearance(certificate: Certificate) -> float:
    return math.inf if certificate.closest is None else certificate.closest.clearance_m


# --- ways -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Way:
    """A certified way, or the reasons why none was found."""

    plan: PhasedPlan | None
    certificate: Certificate | None
    reasons: tuple[str, ...] = ()


def way_between(situation: Situation, goals: Places, *, straight: bool = False) -> Way:
    """From where the vehicles are measured to these places, timing-free. ``straight``: at once, if that can be."""
    starts = {name: situation.measured[name] for name in goals}
    above = {name: (s[0], s[1], goals[name][2]) for name, s in starts.items()}
    tries: list[PhasedPlan] = []
    if straight and not situation.grounded and not situation.by.own_way:
        tries.append(PhasedPlan(starts, (Phase("way back", dict(goals)),)))
    tries.append(PhasedPlan(starts, (Phase("climb", above), Phase("to the starts", dict(goals)))))
    space = _without_floor(situation.space, starts)
    reasons: list[str] = []
    last: Certificate | None = None
    for plan in tries:
        last = certify(plan, situation.rule, space)
        if last.certified:
            return Way(plan, last)
        reasons = reasons or last.reasons()[:3]
    found = _in_layers(situation, starts, goals, space)
    if isinstance(found, str):
        return Way(None, last, (*reasons, f"in layers: {found}"))
    last = certify(found, situation.rule, space)
    return Way(found, last) if last.certified else Way(None, last, (*reasons, *last.reasons()[:3]))


def _in_layers(situation: Situation, starts: Places, goals: Places, space: FlightSpace) -> PhasedPlan | str:
    names = list(starts)
    rule = situation.rule
    half = [rule.half_m(name) for name in names]
    standing = max((rule.half_m(name) for name in space.standing), default=0.0)
    highest_ground_m = max((starts[name][2] for name in situation.grounded), default=None)
    floor_m = highest_ground_m if situation.space.floor_m is None else situation.space.floor_m
    found = layered(
        names,
        list(starts.values()),
        [goals[name] for name in names],
        half,
        rule.downwash_ratio,
        replace(space, floor_m=floor_m),
        standing,
    )
    return found if isinstance(found, str) else found[0]


def _after_takeoff(steps: Sequence[FlightStep], situation: Situation) -> list[FlightStep]:
    """The way there without the climb of those on the ground, which is their take-off: they stand at its top."""
    if not situation.grounded or not steps:
        return list(steps)
    first, *others = steps
    flown = {
        name: hover(way.end_enu_m, way.duration_s) if name in situation.grounded else way
        for name, way in first.trajectories.items()
    }
    if all(way.start_enu_m == way.end_enu_m for way in flown.values()):
        return others
    return [replace(first, trajectories=flown), *others]


def _without_floor(space: FlightSpace, starts: Places) -> FlightSpace:
    """Vehicles that stand below the floor of the plan, on the ground, take off all the same."""
    lowest_m = min(place[2] for place in starts.values())
    return space if space.floor_m is None else replace(space, floor_m=min(space.floor_m, lowest_m))


def way_down(
    measured: Places, ground_m: float, rule: MarginRule, space: FlightSpace
) -> tuple[list[list[str]], Certificate]:
    """Landing vertically: the rounds, and the certificate, which may be a refusal."""
    free = replace(space, floor_m=None, fence=(), ceiling_m=None, boxes=())  # down is the way out of all of them
    ground = {name: (place[0], place[1], min(ground_m, place[2])) for name, place in measured.items()}
    at_once = certify(PhasedPlan(dict(measured), (Phase("landing", ground),)), rule, free)
    if at_once.certified or len(measured) == 1:
        return [list(measured)], at_once
    order = sorted(measured, key=lambda name: measured[name][2])
    phases = tuple(Phase(f"landing of {name}", {name: ground[name]}) for name in order)
    return [[name] for name in order], certify(PhasedPlan(dict(measured), phases), rule, free)


# --- heights and margins ----------------------------------------------------------------------------------------------


def _from_the_air(situation: Situation) -> Plan:
    """A phased plan that begins on the ground, without the climb that is the take-off, or that is done already."""
    plan = situation.plan
    ground_m = _ground_m(situation)
    if not isinstance(plan, PhasedPlan) or len(plan.phases) < 2 or not ground_m:
        return plan
    first = plan.phases[0]
    for name, start in plan.starts.items():
        goal = first.goals.get(name, start)
        low = name in ground_m and start[2] < ground_m[name] + LIFT_M
        vertical = math.dist(start[:2], goal[:2]) <= 1e-6 and goal[2] > start[2]
        if not (low and vertical):
            return plan
    return PhasedPlan({name: first.goals[name] for name in plan.starts}, plan.phases[1:])


def _ground_m(situation: Situation) -> dict[str, float]:
    return {**situation.ground_m, **{name: situation.measured[name][2] for name in situation.grounded}}


def _check_heights(plan: Plan, situation: Situation, ground_m: Mapping[str, float], problems: _Problems) -> None:
    """Vehicles under control stay off the ground, at the first place and at the last."""
    if not ground_m:
        return
    lowest_m = min(ground_m.values())
    ends = (
        {name: t.end_enu_m for name, t in plan.trajectories.items()}
        if isinstance(plan, TimedPlan)
        else {name: leg[1] for name, leg in plan.legs()[-1][1].items()}
    )
    for what, places in (("start", starts_of(plan)), ("goal", ends)):
        for name, place in places.items():
            own_m = ground_m.get(name, lowest_m)
            if place[2] < own_m + LIFT_M:
                problems.add(
                    f"its {what} is {place[2] - own_m:.1f} m above the ground, and the least is {LIFT_M:g} m: a plan "
                    "begins and ends in the air, `plan land` ends it",
                    name,
                )


def at_speed(rule: MarginRule, speed_factor: float) -> MarginRule:
    """The rule for flying a timed plan at this multiple of its speed: speeds grow with it, jumps of velocity too."""
    if speed_factor == 1.0:
        return rule

    def scaled(u: Uncertainty) -> Uncertainty:
        return replace(
            u,
            delay_s=u.delay_s * speed_factor,
            clock_error_s=u.clock_error_s * speed_factor,
            acceleration_mps2=max(0.01, u.acceleration_mps2 / speed_factor**2),
        )

    by_vehicle = {name: scaled(u) for name, u in rule.by_vehicle.items()}
    return replace(rule, uncertainty=scaled(rule.uncertainty), by_vehicle=by_vehicle)


def tubes_of(rule: MarginRule, plan: Plan) -> Tubes:
    """Return what each vehicle may be off, from the terms of its margin that are about that. A fixed margin has the
    same."""
    names = list(plan.trajectories) if isinstance(plan, TimedPlan) else list(plan.starts)
    motions = (
        dict(zip(names, motions_of(list(plan.trajectories.values())), strict=True))
        if isinstance(plan, TimedPlan)
        else {}
    )
    free = {name: max(LEAST_TUBE_M, rule.by_vehicle.get(name, rule.uncertainty).tracking_error_m) for name in names}
    terms = replace(rule, fixed_m=None)
    timed = {}
    for name in names:
        parts = terms.terms(name, motions.get(name))
        timed[name] = free[name] + math.fsum(m for what, m in parts.items() if what in _MOVING_TERMS)
    half = {name: rule.half_m(name, motions.get(name)) for name in names}
    return Tubes(half, timed, free, rule.downwash_ratio)


_MOVING_TERMS = frozenset({TIMING, JUMPS})


def require_vehicles(plan: Plan, names: Sequence[str]) -> None:
    """Raise RefusedError where the plan has none of a vehicle."""
    known = starts_of(plan)
    for name in names:
        if name not in known:
            raise RefusedError(f"the plan has no {name}; it is for {', '.join(list(known)[:10])}")
