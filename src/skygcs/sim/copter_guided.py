"""ArduCopter's GUIDED targets: which are taken, and what becomes of one that nobody renews."""

from __future__ import annotations

from dataclasses import replace
from math import cos, hypot
from typing import TYPE_CHECKING, Any

from skygcs.sim.attitude_targets import Refusal, copter_attitude
from skygcs.sim.behaviours import CopterMode
from skygcs.sim.body import AttitudeSetpoint
from skygcs.sim.copter_position_control import CopterPositionControl
from skygcs.sim.failsafe import FENCE_CIRCLE
from skygcs.sim.kinematics import approach_speed
from skygcs.sim.legs import Follow
from skygcs.sim.position_control import PositionTarget
from skygcs.sim.position_targets import copter_target

if TYPE_CHECKING:
    from skygcs.sim.ardupilot import CopterVehicle

THRUST_AS_THRUST = 8
"""GUID_OPTIONS bit 3: SET_ATTITUDE_TARGET.thrust is thrust; without it, a climb rate."""

AVOID_FENCE = 1
"""Bit of AVOID_ENABLE."""

LEVEL = AttitudeSetpoint(None)
"""What an attitude that nobody renews ends in."""

SHORTEST_TIMEOUT_S = 0.1
"""The firmware's lower bound of GUID_TIMEOUT."""


def take(v: CopterVehicle, name: str, fields: dict[str, Any], now: float) -> None:
    """A SET_ATTITUDE_TARGET or SET_POSITION_TARGET_*; nothing interrupts a take-off."""
    if v.mode != CopterMode.GUIDED or v.taking_off:
        return
    setpoint: PositionTarget | AttitudeSetpoint | None
    if name == "SET_ATTITUDE_TARGET":
        target = _attitude(v, fields)
        if isinstance(target, Refusal):
            if target is Refusal.STOP:
                _stop(v)
            return
        setpoint = target
        lifts = (target.thrust or target.climb_mps) > 0.0
    else:
        position = copter_target(v, name, fields)
        if isinstance(position, Refusal):
            _stop(v)
            return
        setpoint = position
        lifts = False  # from the ground only NAV_TAKEOFF or an attitude with a climb lifts it
        if setpoint is not None and not _within_fence(v, setpoint):
            return
    if setpoint is None or (v.landed and not lifts):
        return
    v.setpoint_at = now
    v.velocity_target = isinstance(setpoint, PositionTarget) and setpoint.pos_enu_m[0] is None
    if v.velocity_target and isinstance(setpoint, PositionTarget):
        v.velocity_wanted = setpoint
        setpoint = _before_the_fence(v, setpoint)
    v.plan.fly(Follow(setpoint))


def watch(v: CopterVehicle, now: float) -> None:
    """A target that nobody renews moves no more, an attitude ends level and without climb; a position stays.

    Level is not still: it drifts with the wind until somebody or a failsafe changes the mode.
    """
    if v.mode != CopterMode.GUIDED:
        return
    age, leg = now - v.setpoint_at, v.plan.leg
    longest = max(SHORTEST_TIMEOUT_S, v.params[v.firmware.setpoint_timeout.simulated])
    if isinstance(leg, Follow) and isinstance(leg.setpoint, PositionTarget) and age > longest:
        if isinstance(v.position_control, CopterPositionControl):
            v.position_control.cease()
    elif v.velocity_target and v.params["FENCE_ENABLE"]:
        v.plan.fly(Follow(_before_the_fence(v, v.velocity_wanted)))
    elif isinstance(leg, Follow) and isinstance(leg.setpoint, AttitudeSetpoint):
        if v.attitude_timeout_s is not None:
            longest = v.attitude_timeout_s
        if age > longest and leg.setpoint != LEVEL:
            v.plan.fly(Follow(LEVEL))


def _before_the_fence(v: CopterVehicle, setpoint: PositionTarget) -> PositionTarget:
    """A velocity that goes no faster towards the circle about home than it can still stop FENCE_MARGIN before it
    (AC_Avoid::adjust_velocity_circle_fence, bit 0 of AVOID_ENABLE)."""
    p, home, here = v.params, v.home, v.estimated
    east_mps, north_mps, up_mps = setpoint.vel_enu_mps
    circle = p["FENCE_ENABLE"] and int(p["FENCE_TYPE"]) & FENCE_CIRCLE and int(p["AVOID_ENABLE"]) & AVOID_FENCE
    if not circle or home is None or east_mps is None or north_mps is None:
        return setpoint
    east_m, north_m = here.east_m - home.east_m, here.north_m - home.north_m
    away_m = hypot(east_m, north_m)
    if away_m < 1e-6:
        return setpoint
    outward_mps = (east_mps * east_m + north_mps * north_m) / away_m
    left_m = max(0.0, p["FENCE_RADIUS"] - p["FENCE_MARGIN"] - away_m)
    excess = outward_mps - approach_speed(left_m, p["WPNAV_ACCEL"] / 100, abs(outward_mps))
    if excess <= 0.0:
        return setpoint
    slower = (east_mps - excess * east_m / away_m, north_mps - excess * north_m / away_m, up_mps)
    return replace(setpoint, vel_enu_mps=slower)


def _stop(v: CopterVehicle) -> None:
    v.velocity_target = False
    v.hold_here()


def _attitude(v: CopterVehicle, fields: dict[str, Any]) -> AttitudeSetpoint | Refusal:
    p = v.params
    return copter_attitude(
        fields,
        thrust_as_thrust=bool(int(p["GUID_OPTIONS"]) & THRUST_AS_THRUST),
        climb_mps=p["WPNAV_SPEED_UP"] / 100,
        descent_mps=p["WPNAV_SPEED_DN"] / 100,
        angle_boost=bool(p["ATC_ANGLE_BOOST"]),
        upright=cos(v.estimated.roll_rad) * cos(v.estimated.pitch_rad),
    )


def _within_fence(v: CopterVehicle, setpoint: PositionTarget) -> bool:
    east, north, up = setpoint.pos_enu_m
    return east is None or north is None or up is None or v.inside_fence(east, north, up)
