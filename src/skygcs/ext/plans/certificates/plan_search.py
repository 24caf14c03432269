"""From starts and goals to a certified plan, or a refusal that names the pair, the time and the place.

    0  standing at the starts and at the goals
    1  timed, straight: goals exchanged first if they may be (`straight_flight`)
    2  layers: climb, cross, descend (`layered_flight`)
    3  layers and rounds, where the ceiling leaves too few layers

`Task.kind` leaves some of them out; "direct" is one phase of straight legs, which is what orders to go somewhere are.

Every plan that comes out was certified by `certify`, which shares nothing with the search but distances of segments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.margins import MarginRule
from skygcs.core.plan.straight_flight import assigned, straight_trajectories
from skygcs.core.trajectory import MotionLimits
from skygcs.core.trajectory.piecewise import Vector
from skygcs.errors import RefusedError
from skygcs.ext.plans.certificates.certificate import Certificate
from skygcs.ext.plans.certificates.certify import certify
from skygcs.ext.plans.certificates.layered_flight import layered, layers_text

Kind = Literal["auto", "timed", "phased", "direct"]
"""direct: one phase in which all fly straight, each as fast as it likes."""

AttemptProgress = Callable[[str, int, int], None]
"""Called with what is being certified, vehicles done and in all; it may raise to cancel."""


DIRECT = "straight"
"""Name of its one phase."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """One attempt: what was tried, and the plan that came of it, certified or not; None: it made none."""

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


def make_plan(
    task: Task,
    rule: MarginRule,
    limits: MotionLimits,
    space: FlightSpace | None = None,
    progress: AttemptProgress | None = None,
) -> Found:
    """Search in the order of the table. Raises RefusedError for an invalid task."""
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
    goal_of = dict(zip(names, goals, strict=True))
    search = _Search(dict(task.starts), goal_of, rule, limits, space or FlightSpace(), progress)
    if (ends := _ends(search)) is not None:
        return Found(None, ends.certificate, (ends,))
    for make in ATTEMPTS[task.kind]:
        attempt = make(search)
        attempts.append(attempt)
        if attempt.certificate is not None and attempt.certificate.certified:
            return Found(attempt.plan, attempt.certificate, tuple(attempts))
    last = next((a.certificate for a in reversed(attempts) if a.certificate is not None), None)
    return Found(None, last, tuple(attempts))


@dataclass(frozen=True, slots=True)
class _Search:
    """Inputs of every attempt."""

    starts: Mapping[str, Vector]
    goals: Mapping[str, Vector]
    rule: MarginRule
    limits: MotionLimits
    space: FlightSpace
    progress: AttemptProgress | None


def _ends(search: _Search) -> Attempt | None:
    """Standing at the starts, and at the goals: where that is not safe nothing can be."""
    for what, places in (("starts", search.starts), ("goals", search.goals)):
        certificate = certify(PhasedPlan(places, (Phase(f"standing at the {what}", {}),)), search.rule, search.space)
        if not certificate.certified:
            return Attempt(what, None, certificate)
    return None


def _direct(search: _Search) -> Attempt:
    plan = PhasedPlan(search.starts, (Phase(DIRECT, dict(search.goals)),))
    return Attempt("straight, each at its own speed", plan, certify(plan, search.rule, search.space))


def _straight(search: _Search) -> Attempt:
    trajectories = straight_trajectories(list(search.starts.values()), list(search.goals.values()), search.limits)
    plan = TimedPlan(dict(zip(search.starts, trajectories, strict=True)))
    report = None if search.progress is None else partial(search.progress, "straight, timed")
    return Attempt("straight, timed", plan, certify(plan, search.rule, search.space, progress=report))


def _layers(search: _Search) -> Attempt:
    if search.progress is not None:
        search.progress("layers", 0, len(search.starts))

    half = [search.rule.half_m(name) for name in search.starts]
    standing = max((search.rule.half_m(name) for name in search.space.standing), default=0.0)
    found = layered(
        list(search.starts),
        list(search.starts.values()),
        list(search.goals.values()),
        half,
        search.rule.downwash_ratio,
        search.space,
        standing,
    )
    if isinstance(found, str):
        return Attempt("layers", None, None, found)
    plan, layers = found
    rounds = len(set(layers.round))
    what = layers_text(len(set(layers.layer))) + ("" if rounds == 1 else f", {rounds} rounds")
    return Attempt(what, plan, certify(plan, search.rule, search.space))


ATTEMPTS = {"auto": (_straight, _layers), "timed": (_straight,), "phased": (_layers,), "direct": (_direct,)}
"""By `Task.kind`, in the order in which they are tried."""
