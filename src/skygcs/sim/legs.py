"""The legs that a flying vehicle is about to fly: a row, each flown until it is finished; the last one is kept.

A take-off is [GoTo], a return is [GoTo (climb), GoTo (home), Wait, Land], a goto is [GoTo] and then stays there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import hypot
from typing import assert_never

from skygcs.sim.body import AttitudeSetpoint, Body
from skygcs.sim.kinematics import CourseSetpoint, Limits, Setpoint
from skygcs.sim.position_control import NO_AXES, PositionTarget


@dataclass(frozen=True, slots=True)
class GoTo:
    """Fly there and hold. ``climb_mps`` replaces the normal climb speed (take-off)."""

    east_m: float
    north_m: float
    up_m: float
    yaw_rad: float | None = None
    climb_mps: float | None = None


@dataclass(frozen=True, slots=True)
class Follow:
    """Follow this setpoint: OFFBOARD and GUIDED targets. Never finished."""

    setpoint: PositionTarget | AttitudeSetpoint

    @property
    def needs_position(self) -> bool:
        setpoint = self.setpoint
        return isinstance(setpoint, PositionTarget) and (setpoint.pos_enu_m, setpoint.vel_enu_mps) != (NO_AXES, NO_AXES)


@dataclass(slots=True)
class Wait:
    """Hold here for so long."""

    seconds: float
    since: float | None = None


@dataclass(frozen=True, slots=True)
class Land:
    """Straight down here until the ground is met: at ``speed_mps`` below ``slow_below_m``, above ``fast_above_m`` at
    the vehicle's normal speed of descent. After a failsafe it waits until ``not_before``."""

    east_m: float
    north_m: float
    speed_mps: float
    fast_above_m: float = 10.0
    slow_below_m: float = 10.0
    not_before: float = 0.0


@dataclass(frozen=True, slots=True)
class Descend:
    """Down without a position: level, drifting with the wind, until the ground is met; see `Land`."""

    speed_mps: float
    not_before: float = 0.0


@dataclass(frozen=True, slots=True)
class Course:
    """Towards a place, as what cannot fly sideways: finished within ``reached_m`` of it over the ground, and then past
    it; round it with ``circle_m`` (positive clockwise), and then finished on the circle within `CIRCLE_UP_M` of its
    height; or to a stop there."""

    east_m: float
    north_m: float
    up_m: float
    reached_m: float = 0.0
    circle_m: float = 0.0
    stops: bool = False


@dataclass(slots=True)
class Stay:
    """Round a place, or standing at it, for so long."""

    course: Course
    seconds: float
    since: float | None = None


@dataclass(frozen=True, slots=True)
class ClimbOut:
    """Off the ground straight ahead, with level wings, until this high."""

    heading_rad: float
    up_m: float


@dataclass(frozen=True, slots=True)
class Glide:
    """Down to a place on the ground, and along the ground to a stop."""

    east_m: float
    north_m: float


CIRCLE_UP_M = 10.0
"""ArduPlane: ModeRTL::navigate and AUTO's loiters ask for 10 m (commands_logic.cpp); NAV_ACC_RAD of a PX4 plane is
10 m."""

CLIMBED_OUT_M = 2.0
"""So near its height a climb-out has ended: ModeTakeoff::update, 200 cm."""

Leg = GoTo | Follow | Wait | Land | Descend | Course | Stay | ClimbOut | Glide


class Plan:
    """The legs still to fly; empty on the ground."""

    def __init__(self) -> None:
        self._legs: list[Leg] = []
        self.arrived = False
        """The last leg is finished (and held)."""

    @property
    def leg(self) -> Leg | None:
        """The leg being flown."""
        return self._legs[0] if self._legs else None

    @property
    def landing(self) -> bool:
        return isinstance(self.leg, Land | Descend | Glide)

    def fly(self, *legs: Leg) -> None:
        """Forget what was planned and fly these."""
        self._legs = list(legs)
        self.arrived = False

    def step(
        self, motion: Body, limits: Limits, now: float
    ) -> tuple[Setpoint | PositionTarget | AttitudeSetpoint | None, Limits]:
        """Return what to steer to now, and the limits on the way; moves on to the next leg when one is finished."""
        while self._legs and _finished(self._legs[0], motion, now):
            if len(self._legs) == 1:
                self.arrived = True
                break
            self._legs.pop(0)
        leg = self.leg
        return (None, limits) if leg is None else _steer(leg, motion, limits, now)


@lru_cache(maxsize=256)
def _place(east_m: float, north_m: float, up_m: float, yaw_rad: float | None) -> Setpoint:
    """The setpoint of a `GoTo`, which is asked for with each tick of its leg; so are its limits."""
    return Setpoint((east_m, north_m, up_m), yaw_rad=yaw_rad)


@lru_cache(maxsize=256)
def _with_climb(limits: Limits, climb_mps: float) -> Limits:
    return replace(limits, climb_mps=climb_mps)


def _finished(leg: Leg, motion: Body, now: float) -> bool:
    match leg:
        case GoTo(east_m, north_m, up_m):
            return motion.is_at(east_m, north_m, up_m)
        case Follow():
            return False
        case Wait(seconds, since):
            if since is None:
                leg.since = now
                return seconds <= 0
            return now - since >= seconds
        case Land() | Descend():
            return motion.on_ground
        case Course():
            return _reached(leg, motion)
        case Stay():
            if leg.since is None and _reached(leg.course, motion):
                leg.since = now
            return leg.since is not None and now - leg.since >= leg.seconds
        case ClimbOut():
            return motion.up_m >= leg.up_m - CLIMBED_OUT_M
        case Glide():
            return motion.on_ground and motion.groundspeed_mps == 0.0
        case _:
            assert_never(leg)


def _steer(
    leg: Leg, motion: Body, limits: Limits, now: float
) -> tuple[Setpoint | PositionTarget | AttitudeSetpoint, Limits]:
    match leg:
        case GoTo(east_m, north_m, up_m, yaw_rad, climb_mps):
            if climb_mps is not None:
                limits = _with_climb(limits, climb_mps)
            return _place(east_m, north_m, up_m, yaw_rad), limits
        case Follow(setpoint):
            return setpoint, limits
        case Wait():
            return Setpoint((None, None, None)), limits
        case Land():
            return Setpoint(
                (leg.east_m, leg.north_m, None), (None, None, -_landing_speed(leg, motion, limits, now))
            ), limits
        case Descend(speed_mps, not_before):
            return AttitudeSetpoint(None, climb_mps=0.0 if now < not_before else -speed_mps), limits
        case Course():
            return _course(leg), limits
        case Stay(course):
            return _course(course), limits
        case ClimbOut(heading_rad, up_m):
            return CourseSetpoint((None, None, up_m), yaw_rad=heading_rad), limits
        case Glide(east_m, north_m):
            return CourseSetpoint((east_m, north_m, None), lands=True), limits
        case _:
            assert_never(leg)


def _course(leg: Course) -> CourseSetpoint:
    place = (leg.east_m, leg.north_m, leg.up_m)
    return CourseSetpoint(place, circle_m=leg.circle_m, stops=leg.stops, reached_m=leg.reached_m)


def _reached(leg: Course, motion: Body) -> bool:
    away_m = hypot(leg.east_m - motion.east_m, leg.north_m - motion.north_m)
    if leg.circle_m:
        return away_m <= abs(leg.circle_m) + leg.reached_m and abs(leg.up_m - motion.up_m) <= CIRCLE_UP_M
    return away_m <= leg.reached_m


def _landing_speed(leg: Land, motion: Body, limits: Limits, now: float) -> float:
    if now < leg.not_before:
        return 0.0
    if motion.up_m > leg.fast_above_m:
        return max(leg.speed_mps, limits.descent_mps)
    if motion.up_m <= leg.slow_below_m:
        return leg.speed_mps
    share = (motion.up_m - leg.slow_below_m) / (leg.fast_above_m - leg.slow_below_m)
    return leg.speed_mps + share * (max(leg.speed_mps, limits.descent_mps) - leg.speed_mps)
