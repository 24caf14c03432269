"""The rehearsal of a plan: what the guard would stop is found beforehand, and straight legs are slowed down for it."""

from __future__ import annotations

from dataclasses import replace

from skygcs.core.control.control_fence import COPTER_BRAKING, PX4_BRAKING, Fence, LossReach
from skygcs.core.geo import Origin
from skygcs.core.plan.fleet_plan import Phase, PhasedPlan, TimedPlan
from skygcs.core.trajectory import MotionLimits
from skygcs.core.trajectory.timing import path_within
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory
from skygcs.ext.plans.flight.flight_steps import FlightStep, StepKind, phased_steps, steps_of
from skygcs.ext.plans.flight.plan_rehearsal import (
    PX4_OVERSHOOT_S,
    Flown,
    Loaded,
    Stage,
    factor_that_passes,
    rehearse,
    slowed,
    too_fast,
)
from skygcs.ext.plans.flight.sights import Tubes

ORIGIN = Origin(43.78, -79.46, 180.0)
LIMITS = MotionLimits()
START, TOP, BESIDE = (0.0, 0.0, 6.0), (0.0, 0.0, 18.0), (8.0, 0.0, 6.0)


def stage(timeout_s: float, up_m: float = 20.0) -> Stage:
    fence = Fence(ORIGIN, up_m=(0.0, up_m))
    copter = Flown(fence, LossReach(timeout_s, COPTER_BRAKING))
    return Stage(ORIGIN, {"a": copter, "b": Flown(fence, LossReach(1.0, PX4_BRAKING))}, 1.0, 1.0)


def climb() -> list[FlightStep]:
    plan = PhasedPlan({"a": START, "b": BESIDE}, (Phase("climb", {"a": TOP}), Phase("back", {"a": START})))
    return phased_steps(plan, StepKind.PLAN, LIMITS)


def loaded(steps: list[FlightStep]) -> list[Loaded]:
    return [{n: LoadedTrajectory(t, step.name) for n, t in step.trajectories.items()} for step in steps]


def tubes() -> Tubes:
    both = {"a": 1.0, "b": 1.0}
    return Tubes(both, both, both, 2.0)


def test_a_climb_within_the_fence_that_leads_out_of_it_when_setpoints_cease_is_found_with_its_figure() -> None:
    """As it was seen: the places of a plan pass at 18 of 20 m, and the guard stops the climb to them."""
    steps = climb()
    stopped = rehearse(steps, loaded(steps), tubes(), stage(3.0))
    assert stopped is not None and (stopped.step, stopped.vehicle) == ("climb", "a")
    assert "3 s after its last setpoint, the vehicle is at up 20." in stopped.text
    assert rehearse(steps, loaded(steps), tubes(), stage(3.0, up_m=40.0)) is None
    assert rehearse(steps, loaded(steps), tubes(), stage(0.1)) is None, "away from a wall it may fly"


def test_straight_legs_are_slowed_down_until_they_pass_and_then_the_whole_does() -> None:
    steps = climb()
    where = stage(3.0)
    assert too_fast(steps[0], loaded(steps)[0], where, tubes()) is not None
    slower = slowed(steps[0], LIMITS, where, tubes())
    assert slower is not None and slower.places() == steps[0].places()
    assert slower.duration_s > steps[0].duration_s
    again = [slower, *steps[1:]]
    assert rehearse(again, loaded(again), tubes(), where) is None


def test_a_leg_whose_end_would_be_passed_by_more_than_its_tube_is_flown_slower() -> None:
    fast = replace(LIMITS, speed_mps=6.0, acceleration_mps2=2.0)
    plan = PhasedPlan({"a": START, "b": BESIDE}, (Phase("cross", {"a": (-60.0, 0.0, 6.0)}),))
    (step,) = phased_steps(plan, StepKind.PLAN, fast)
    wide = Fence(ORIGIN, x_m=(-200.0, 200.0), y_m=(-200.0, 200.0), up_m=(0.0, 40.0))
    px4 = Flown(wide, LossReach(1.0, PX4_BRAKING), PX4_OVERSHOOT_S)
    where = Stage(ORIGIN, {"a": px4, "b": px4}, 1.0, 1.0)
    narrow = Tubes(*({"a": 0.4, "b": 0.4},) * 3, 2.0)
    found = too_fast(step, loaded([step])[0], where, narrow)
    assert found is not None and found.vehicle == "a" and "pass the end of its way by 1.1" in found.text
    slower = slowed(step, fast, where, narrow)
    assert slower is not None and slower.places() == step.places()
    assert too_fast(slower, loaded([slower])[0], where, narrow) is None
    wide_tubes = Tubes(*({"a": 1.5, "b": 1.5},) * 3, 2.0)
    assert too_fast(step, loaded([step])[0], where, wide_tubes) is None, "a wider tube has room for it"
    assert rehearse([step], loaded([step]), wide_tubes, where) is None
    stopped = rehearse([step], loaded([step]), narrow, where)
    assert stopped is not None and "pass the end of its way by 1.1" in stopped.text
    assert too_fast(step, loaded([step])[0], replace(where, speed_factor=0.3), narrow) is None


def test_a_timed_plan_passes_at_a_speed_that_is_named_or_at_none() -> None:
    ways = {"a": path_within((START, TOP), LIMITS), "b": path_within((BESIDE, (9.0, 0.0, 6.0)), LIMITS)}
    steps = steps_of(TimedPlan(ways), LIMITS)
    where = stage(3.0)
    assert rehearse(steps, loaded(steps), tubes(), where) is not None
    factor = factor_that_passes(loaded(steps), steps, tubes(), where)
    assert factor is not None and 0.1 < factor < 1.0
    assert rehearse(steps, loaded(steps), tubes(), replace(where, speed_factor=factor)) is None
    assert factor_that_passes(loaded(steps), steps, tubes(), stage(3.0, up_m=18.0)) is None
