"""From starts and goals to a certified plan, or a refusal that names the pair, the time and the place.

    1  timed, straight: goals exchanged first if they may be (`straight_flight`)
    2  layers: climb, cross, descend (`layered_flight`)
    3  layers and rounds, where the ceiling leaves too few layers

Every plan that comes out was certified by `certify`, which shares nothing with the search but distances of segments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from skygcs.core.plan.certificate import Certificate
from skygcs.core.plan.certify import certify
from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.margins import MarginRule
from skygcs.core.trajectory import MotionLimits
from skygcs.core.trajectory.piecewise import Vector
from skygcs.errors import RefusedError

Kind = Literal["auto", "timed", "phased"]


@dataclass(frozen=True, slots=True)
class Attempt:
    """One way that was tried; ``plan`` is None where it makes none."""

    what: str
    plan: Plan | None
    certificate: Certificate | None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Found:
    """The outcome of a search: the plan of the first certified attempt, else None, and all that was tried."""

    plan: Plan | None
    certificate: Certificate | None
    attempts: tuple[Attempt, ...]

    def reasons(self) -> list[str]:
        """Why nothing was certified, a line each."""
        lines = []
        for attempt in self.attempts:
            reasons = [attempt.reason] if attempt.certificate is None else attempt.certificate.reasons()[:3]
            lines += [f"{attempt.what}: {reason}" for reason in reasons]
        return lines


@dataclass(frozen=True, slots=True)
class Task:
    """Starts and goals by vehicle."""

    starts: Mapping[str, Vector]
    goals: Mapping[str, Vector]
    exchangeable: bool = False
    """Any vehicle may take any goal."""
    kind: Kind = "auto"


def make_plan(task: Task, rule: MarginRule, limits: MotionLimits, space: FlightSpace | None = None) -> Found:
    """Search in the order of the table. Raises RefusedError for an invalid task."""
    from skygcs.core.plan.straight_flight import assigned

    space = space or FlightSpace()
    names = list(task.starts)
    if not names:
        raise RefusedError("a plan has one vehicle at least")
    if odd := set(names) ^ set(task.goals):
        raise RefusedError(f"{min(odd)} has no {'goal' if min(odd) in task.starts else 'start'}")
    starts = [task.starts[name] for name in names]
    goals = [task.goals[name] for name in names]
    if task.exchangeable:
        order = assigned(starts, goals, rule.downwash_ratio)
        goals = [goals[index] for index in order]
    attempts: list[Attempt] = []
    for make in (_ends, _straight, _layers):
        if task.kind == ("phased" if make is _straight else "timed" if make is _layers else ""):
            continue
        attempt = make(dict(zip(names, starts, strict=True)), dict(zip(names, goals, strict=True)), rule, limits, space)
        if attempt is None:
            continue
        attempts.append(attempt)
        if make is _ends:
            return Found(None, attempt.certificate, tuple(attempts))
        if attempt.certificate is not None and attempt.certificate.certified:
            return Found(attempt.plan, attempt.certificate, tuple(attempts))
    last = next((a.certificate for a in reversed(attempts) if a.certificate is not None), None)
    return Found(None, last, tuple(attempts))


Places = Mapping[str, Vector]


def _ends(starts: Places, goals: Places, rule: MarginRule, limits: MotionLimits, space: FlightSpace) -> Attempt | None:
    """Standing at the starts, and at the goals: where that is not safe nothing can be."""
    for what, places in (("starts", starts), ("goals", goals)):
        certificate = certify(PhasedPlan(places, (Phase(f"standing at the {what}", {}),)), rule, space)
        if not certificate.certified:
            return Attempt(what, None, certificate)
    return None


def _straight(starts: Places, goals: Places, rule: MarginRule, limits: MotionLimits, space: FlightSpace) -> Attempt:
    from skygcs.core.plan.straight_flight import straight_trajectories

    trajectories = straight_trajectories(list(starts.values()), list(goals.values()), limits)
    plan = TimedPlan(dict(zip(starts, trajectories, strict=True)))
    return Attempt("straight, timed", plan, certify(plan, rule, space))


def _layers(starts: Places, goals: Places, rule: MarginRule, limits: MotionLimits, space: FlightSpace) -> Attempt:
    from skygcs.core.plan.layered_flight import layered

    half = [rule.half_m(name) for name in starts]
    standing = max((rule.half_m(name) for name in space.standing), default=0.0)
    found = layered(
        list(starts), list(starts.values()), list(goals.values()), half, rule.downwash_ratio, space, standing
    )
    if isinstance(found, str):
        return Attempt("layers", None, None, found)
    plan, layers = found
    rounds = len(set(layers.round))
    what = f"{len(set(layers.layer))} layers" + ("" if rounds == 1 else f", {rounds} rounds")
    return Attempt(what, plan, certify(plan, rule, space))
