"""Steps of a flight, its trajectories, and their rehearsal: what is heavy of it, for a process of its own (`Work`)."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from skygcs.core.trajectory import MotionLimits, least_limits, within_at_speed
from skygcs.core.vehicle.flight_lock import FlightLock
from skygcs.core.vehicle.offboard_entry import loss_reach
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory
from skygcs.ext.plans.flight.flight_situation import Prepared, Situation
from skygcs.ext.plans.flight.flight_steps import FlightStep
from skygcs.ext.plans.flight.plan_rehearsal import (
    PX4_OVERSHOOT_S,
    Flown,
    Stage,
    Stopped,
    factor_that_passes,
    rehearse,
    slowed,
    too_fast,
)

if TYPE_CHECKING:  # the process needs no vehicles
    from skygcs.runtime.vehicle_actor import VehicleActor

Work = Callable[..., Awaitable[Any]]
"""Calls a function of a module with these arguments, in another process."""


class Rehearsed(NamedTuple):
    """A prepared flight, its trajectories, and how its rehearsal ended."""

    prepared: Prepared
    loaded: tuple[dict[str, LoadedTrajectory], ...]
    stopped: tuple[Stopped, float | None] | None
    """Reason for which the rehearsal stopped, and the speed factor at which nothing stops it; None: it reached its
    end."""


def prepared_and_loaded(situation: Situation, rest: list[FlightStep] | None, stage: Stage | None) -> Rehearsed:
    """The steps (``rest``: after a stop), the bounds of each trajectory, and what stopped their rehearsal on a
    ``stage``; all take long, and load numpy. Straight legs that lead towards a fence too fast are slowed down."""
    from skygcs.ext.plans.flight.preparation import prepare, prepare_return

    prepared = prepare(situation) if rest is None else prepare_return(situation, rest)
    if prepared.problems:
        return Rehearsed(prepared, (), None)
    steps, loaded = [], []
    for step in prepared.steps:
        ways = _loaded(step)
        tubes = prepared.tubes
        if stage is not None and tubes is not None and not step.timed and too_fast(step, ways, stage, tubes):
            slower = slowed(step, situation.limits, stage, tubes)
            step, ways = (step, ways) if slower is None else (slower, _loaded(slower))
        steps.append(step)
        loaded.append(ways)
    prepared = replace(prepared, steps=tuple(steps))
    stopped = None
    if stage is not None and steps and prepared.tubes is not None:
        why = rehearse(steps, loaded, prepared.tubes, stage)
        if why is not None:
            stopped = why, factor_that_passes(loaded, steps, prepared.tubes, stage)
    return Rehearsed(prepared, tuple(loaded), stopped)


def _loaded(step: FlightStep) -> dict[str, LoadedTrajectory]:
    return {name: LoadedTrajectory(trajectory, step.name) for name, trajectory in step.trajectories.items()}


def stage_of(lock: FlightLock, actors: Sequence[VehicleActor], speed_factor: float) -> Stage:
    """Where a flight with this lock is rehearsed: with the guard's figures of now."""
    flown = {
        actor.name: Flown(
            lock.member(actor.name).fence,
            loss_reach(actor.vehicle),
            PX4_OVERSHOOT_S if actor.vehicle.family == "px4" else 0.0,
        )
        for actor in actors
    }
    brake_mps2 = min(lock.member(actor.name).limits.brake_mps2 for actor in actors)
    return Stage(lock.origin, flown, brake_mps2, speed_factor)


def way_down(*arguments: Any) -> Any:
    """`preparation.way_down`, which loads numpy."""
    from skygcs.ext.plans.flight import preparation

    return preparation.way_down(*arguments)


def limits_of(actors: Sequence[VehicleActor], speed_factor: float) -> MotionLimits:
    """Within which ways and phases are timed: the least of the vehicles' own, for a flight so many times as fast."""
    return within_at_speed(least_limits(actor.config.control.motion_limits() for actor in actors), speed_factor)
