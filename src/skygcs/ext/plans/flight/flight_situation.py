"""Situation of a flight: what is to be flown, where the vehicles are, and what was made of that: the question and the
answer of `flight.preparation`, without numpy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from skygcs.core.plan.fleet_plan import FlightSpace, Plan
from skygcs.core.plan.margins import MarginRule
from skygcs.core.trajectory import MotionLimits
from skygcs.core.trajectory.piecewise import Vector
from skygcs.ext.plans.certificates.certificate import Certificate
from skygcs.ext.plans.flight.flight_steps import FlightStep
from skygcs.ext.plans.flight.guidance import Guidance
from skygcs.ext.plans.flight.sights import Tubes

Places = Mapping[str, Vector]


@dataclass(frozen=True, slots=True)
class Situation:
    """The flight that is asked for, and by which vehicles, in the frame of the plan."""

    plan: Plan
    space: FlightSpace
    """With all vehicles that take no part, where they were measured."""
    measured: Places
    grounded: frozenset[str]
    rule: MarginRule
    limits: MotionLimits
    """Within which ways and phases are flown."""
    speed_factor: float = 1.0
    by: Guidance = Guidance.SETPOINTS
    ground_m: Mapping[str, float] = field(default_factory=dict)
    """How high the ground is under each vehicle, as far as that is known."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """The steps, the certificates of the ways and of the plan, and why it must not be flown."""

    steps: tuple[FlightStep, ...]
    tubes: Tubes | None
    way: Certificate | None
    certificate: Certificate | None
    problems: tuple[str, ...] = ()
    """Lines, each with its pair, time and place."""
    vehicles: tuple[str | None, ...] = ()
    """Vehicle of each problem, if it is about one."""

    @property
    def duration_s(self) -> float:
        return math.fsum(step.duration_s for step in self.steps)
