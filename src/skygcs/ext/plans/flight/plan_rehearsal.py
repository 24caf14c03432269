"""A plan flown beforehand, in virtual time: the same state machine (`Execution`), the same clock, the same references
and the same fence with the guard's look-ahead as in the flight, with vehicles that follow exactly. Pure.

    what of the flight               in the rehearsal
    ------------------------------   ---------------------------------------------------------------------------------
    steps, barriers, their ends      `Execution`, tick by tick
    clock and speed factor           `TrajectoryClock`, as `common_clock` makes it
    references                       `TrajectoryFlight.reference`
    fence: look-ahead of velocity    `fence_ahead`, which the control loop asks at each of its ticks
    fence: the vehicle itself        its reference, with its tube around it
    the end of a way                 passed by `Flown.overshoot_s` times the speed, which has to stay in the tube

Not rehearsed: wind, losses, pilots, orders and what a firmware does by itself. What stops a rehearsal stops the flight;
an undisturbed flight is stopped by nothing that a rehearsal does not have.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from skygcs.core.control.control_fence import Fence, LossReach, fence_ahead
from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.trajectory import ClockState, MotionLimits
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.trajectory.timing import path_within
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, TrajectoryFlight, common_clock
from skygcs.ext.plans.flight.execution import Execution
from skygcs.ext.plans.flight.flight_steps import FlightStep
from skygcs.ext.plans.flight.plan_states import OrderKind, PlanState
from skygcs.ext.plans.flight.sights import Measurement, Tubes

TICK_S = 0.2
"""Seconds between two looks at its vehicles, and between two position setpoints, as in `PlanFlight`."""

SLACK_M = 0.1
"""The ticks of the control loop fall between those here; on a ramp of 2 m/s² the place that is asked about goes to and
fro by less in half a tick."""

LONGEST_S = 7_200.0
"""Longest rehearsal of a plan; one that is not over by then never is."""

SLOWER = (0.7, 0.5, 0.45, 0.35, 0.25, 0.17, 0.12)
"""Multiples of the speed that are tried for a step, or for a whole plan, that leads out of the fence too fast."""

PX4_OVERSHOOT_S = 0.2
"""A PX4 passes the end of its way by so much times the speed it comes with, for a second and more: its velocity
integrator (MPC_XY_VEL_I_ACC) has taken up what its drag takes, unless `core.control.drag_estimate` has learned that.
Model of its loop, ways of 15 to 60 m at 1.3 to 3 m/s, positions .05 to .3 s late: .06 to .16 s with the drag of an
F450; .21 to .32 s with six times that drag (its own simulator) on the first way, and .05 to .12 s on the eighth."""

COMES_WITH_S = 4.0
"""The speed with which a trajectory comes to its end: the largest of its last seconds."""


class Flown(NamedTuple):
    """One vehicle, as the flight has it: its control fence on earth, how far it goes when setpoints cease, and how far
    it passes the end of a leg, per m/s."""

    fence: Fence
    reach: LossReach
    overshoot_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Stage:
    """Where a rehearsal takes place."""

    origin: Origin
    flown: Mapping[str, Flown]
    brake_mps2: float
    """Deceleration with which the clock stops."""
    speed_factor: float


class Stopped(NamedTuple):
    """Why a rehearsal did not reach its end."""

    step: str
    vehicle: str | None
    text: str


Loaded = Mapping[str, LoadedTrajectory]


def rehearse(steps: Sequence[FlightStep], loaded: Sequence[Loaded], tubes: Tubes, stage: Stage) -> Stopped | None:
    """Fly the steps from where the vehicles stand under control to the end; what stopped them, None if nothing did."""
    execution = Execution(steps, (), tubes, steps[0].starts())
    names = execution.names
    places: Mapping[str, Vector] = steps[0].starts()
    orders = execution.begin()
    flights: dict[str, TrajectoryFlight] = {}
    now, frame = 0.0, EnuFrame(stage.origin)
    while not execution.over and now < LONGEST_S:
        # what the execution orders succeeds at once
        clock, trajectory_s = ClockState.FINISHED, 0.0
        for order in orders:
            for name in order.vehicles if order.kind is OrderKind.ENGAGE else ():
                execution.outcome(OrderKind.ENGAGE, name, True, "")
            if order.kind is OrderKind.FLY:
                passing = _passing(execution.step, loaded[execution.index], tubes, stage)
                if passing is not None:
                    return passing
                flights = _begun(loaded[execution.index], stage, frame, now)
        # where the vehicles would be now
        if flights:
            time = next(iter(flights.values())).clock.at(now)
            clock, trajectory_s = time.state, time.trajectory_s
            ahead = _ahead(execution.step.name, flights, stage, now)
            if isinstance(ahead, Stopped):
                return ahead
            places = ahead
        # what they see there, and the next orders
        sights = {name: Measurement(places[name], reported_m=places[name]) for name in names}
        orders = execution.tick(now, clock if flights else None, trajectory_s, sights)
        if execution.state is PlanState.STOPPED:
            return Stopped(execution.step.name, None, execution.reason)
        now += TICK_S
    if not execution.over:
        return Stopped(execution.step.name, None, f"it is not over after {LONGEST_S / 60:.0f} min")
    return None


def _passes(metres: float) -> str:
    return f"it would pass the end of its way by {metres:.2f} m"


def _passing(step: FlightStep, loaded: Loaded, tubes: Tubes, stage: Stage) -> Stopped | None:
    """The first vehicle that comes to the end of its trajectory too fast to keep its tube there; None: none does."""
    for name, one in loaded.items():
        end_s = one.trajectory.duration_s
        last = (end_s - COMES_WITH_S / 20 * k for k in range(1, 21))
        speed_mps = max((math.hypot(*one.trajectory.at(t).vel_enu_mps) for t in last if t > 0.0), default=0.0)
        passes_m = stage.flown[name].overshoot_s * speed_mps * stage.speed_factor
        if passes_m > tubes.tube_m(name, timed=step.timed):
            return Stopped(step.name, name, _passes(passes_m))
    return None


def _begun(loaded: Loaded, stage: Stage, frame: EnuFrame, now: float) -> dict[str, TrajectoryFlight]:
    clock = common_clock(list(loaded.values()), stage.brake_mps2, stage.speed_factor)
    clock.start(now, now)
    return {name: TrajectoryFlight(one, clock, stage.origin, frame) for name, one in loaded.items()}


def _ahead(step: str, flights: Mapping[str, TrajectoryFlight], stage: Stage, now: float) -> dict[str, Vector] | Stopped:
    """Where all are, or whom the guard stops there."""
    places = {}
    for name, flight in flights.items():
        reference = flight.reference(now, 0.0)
        places[name] = reference.pos_enu_m
        if not reference.moves:
            continue
        fence, reach, _ = stage.flown[name]
        place, velocity = reference.pos_enu_m, reference.vel_enu_mps
        why = fence_ahead(fence, stage.origin, place, velocity, reach, less_m=SLACK_M)
        if why is not None:
            return Stopped(step, name, why)
    return places


# --- slower, where that helps -----------------------------------------------------------------------------------------


def too_fast(step: FlightStep, loaded: Loaded, stage: Stage, tubes: Tubes) -> Stopped | None:
    """The first vehicle that flies towards its fence, or the end of its leg, too fast in this step of straight legs;
    None: none does."""
    passing = _passing(step, loaded, tubes, stage)
    if passing is not None:
        return passing
    frame = EnuFrame(stage.origin)
    flights = _begun(loaded, stage, frame, 0.0)
    clock = next(iter(flights.values())).clock
    now, end_s = 0.0, (clock.finishes_at_s(0.0) or 0.0)
    while now <= end_s:
        ahead = _ahead(step.name, flights, stage, now)
        if isinstance(ahead, Stopped):
            return ahead
        now += TICK_S
    return None


def slowed(step: FlightStep, limits: MotionLimits, stage: Stage, tubes: Tubes) -> FlightStep | None:
    """The step of straight legs at the first of `SLOWER` at which none is `too_fast`; None: at none.
    A certificate of straight legs holds at any speed."""
    for factor in SLOWER:
        less = replace(
            limits,
            speed_mps=limits.speed_mps * factor,
            climb_mps=limits.climb_mps * factor,
            descent_mps=limits.descent_mps * factor,
        )
        ways = {
            name: path_within((way.start_enu_m, way.end_enu_m), less)
            if math.dist(way.start_enu_m, way.end_enu_m) > SLACK_M
            else way
            for name, way in step.trajectories.items()
        }
        slower = replace(step, trajectories=ways)
        loaded = {name: LoadedTrajectory(way, step.name) for name, way in ways.items()}
        if too_fast(slower, loaded, stage, tubes) is None:
            return slower
    return None


def factor_that_passes(
    loaded: Sequence[Loaded], steps: Sequence[FlightStep], tubes: Tubes, stage: Stage
) -> float | None:
    """The largest multiple of the planned speed at which a rehearsal reaches its end; None: none does."""
    for factor in SLOWER:
        if rehearse(steps, loaded, tubes, replace(stage, speed_factor=stage.speed_factor * factor)) is None:
            return stage.speed_factor * factor
    return None
