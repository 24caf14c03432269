"""ArduCopter's GUIDED targets: which are taken, and what becomes of one that nobody renews."""

from __future__ import annotations

from dataclasses import replace
from math import cos, hypot
from typing import Any

from skygcs.sim.attitude_targets import Refusal, copter_attitude
from skygcs.sim.body import AttitudeSetpoint, Vector
from skygcs.sim.copter_position_control import CopterPositionControl
from skygcs.sim.failsafe import FENCE_CIRCLE
from skygcs.sim.firmware_modes import CopterMode
from skygcs.sim.kinematics import approach_speed
from skygcs.sim.legs import Follow, GoTo
from skygcs.sim.position_control import NO_AXES, PositionTarget
from skygcs.sim.position_targets import copter_target
from skygcs.sim.vehicle_state import VehicleState

THRUST_AS_THRUST = 8
"""GUID_OPTIONS bit 3: SET_ATTITUDE_TARGET.thrust is thrust; without it, a climb rate."""

AVOID_FENCE = 1
"""Bit of AVOID_ENABLE."""

LEVEL = AttitudeSetpoint(None)
"""Attitude after nobody has renewed the last one."""

SHORTEST_TIMEOUT_S = 0.1
"""The firmware's lower bound of GUID_TIMEOUT."""


class GuidedTargets:
    """Targets that an ArduCopter in GUIDED was ordered to follow last."""

    def __init__(self) -> None:
        self.velocity: PositionTarget | None = None
        """The target as it came, if it is one without a position: the fence bounds it."""
        self.place_enu_m: Vector | None = None
        """The place that it flies to and reports (SubMode::Pos), if its target is nothing but a place."""

    def forget(self) -> None:
        """Forget the target, as another mode has come instead (ModeGuided::init)."""
        self.velocity = self.place_enu_m = None

    def go_to(self, v: VehicleState, east_m: float, north_m: float, up_m: float) -> None:
        """Fly to a place (DO_REPOSITION, or a waypoint outside a mission), until another target or mode comes."""
        self.velocity, self.place_enu_m = None, (east_m, north_m, up_m)
        v.plan.fly(GoTo(east_m, north_m, up_m))

    def take(self, v: VehicleState, name: str, fields: dict[str, Any], now: float) -> None:
        """A SET_ATTITUDE_TARGET or SET_POSITION_TARGET_*; nothing interrupts a take-off."""
        if v.mode != CopterMode.GUIDED or v.taking_off:
            return
        target: PositionTarget | AttitudeSetpoint | Refusal | None
        lifts = False  # from the ground only NAV_TAKEOFF or an attitude with a climb lifts it
        if name == "SET_ATTITUDE_TARGET":
            target = _attitude(v, fields)
            lifts = isinstance(target, AttitudeSetpoint) and (target.thrust or target.climb_mps) > 0.0
        else:
            target = copter_target(v, name, fields)
        if target is Refusal.STOP:
            self._stop(v)
        if target is None or isinstance(target, Refusal) or (v.landed and not lifts):
            return
        if isinstance(target, PositionTarget) and not _within_fence(v, target):
            return
        v.setpoint_at = now
        self.velocity, self.place_enu_m = None, _place_alone(target)
        if isinstance(target, PositionTarget) and target.pos_enu_m[0] is None:
            self.velocity = target
            target = _before_the_fence(v, target)
        v.plan.fly(Follow(target))

    def watch(self, v: VehicleState, now: float, attitude_timeout_s: float | None) -> None:
        """A target that nobody renews moves no more, an attitude ends level and without climb; a position stays.

        Level is not still: it drifts with the wind until somebody or a failsafe changes the mode. An attitude lasts
        ``attitude_timeout_s``; None: as long as a target.
        """
        if v.mode != CopterMode.GUIDED or not isinstance(v.plan.leg, Follow):
            return
        age, setpoint = now - v.setpoint_at, v.plan.leg.setpoint
        longest = max(SHORTEST_TIMEOUT_S, v.params[v.firmware.setpoint_timeout.simulated])
        if isinstance(setpoint, AttitudeSetpoint):
            if age > (longest if attitude_timeout_s is None else attitude_timeout_s) and setpoint != LEVEL:
                v.plan.fly(Follow(LEVEL))
        elif age > longest:
            if isinstance(v.position_control, CopterPositionControl):
                v.position_control.cease()
        elif self.velocity is not None and v.params["FENCE_ENABLE"]:
            v.plan.fly(Follow(_before_the_fence(v, self.velocity)))

    def _stop(self, v: VehicleState) -> None:
        self.forget()
        v.hold_here()


def _place_alone(target: PositionTarget | AttitudeSetpoint) -> Vector | None:
    """The place of a target without velocity and acceleration (ModeGuided::set_destination)."""
    if isinstance(target, AttitudeSetpoint) or (target.vel_enu_mps, target.acc_enu_mps2) != (NO_AXES, NO_AXES):
        return None
    east_m, north_m, up_m = target.pos_enu_m
    return None if east_m is None or north_m is None or up_m is None else (east_m, north_m, up_m)


def _before_the_fence(v: VehicleState, setpoint: PositionTarget) -> PositionTarget:
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


def _attitude(v: VehicleState, fields: dict[str, Any]) -> AttitudeSetpoint | Refusal:
    p = v.params
    return copter_attitude(
        fields,
        thrust_as_thrust=bool(int(p["GUID_OPTIONS"]) & THRUST_AS_THRUST),
        climb_mps=p["WPNAV_SPEED_UP"] / 100,
        descent_mps=p["WPNAV_SPEED_DN"] / 100,
        angle_boost=bool(p["ATC_ANGLE_BOOST"]),
        upright=cos(v.estimated.roll_rad) * cos(v.estimated.pitch_rad),
    )


def _within_fence(v: VehicleState, setpoint: PositionTarget) -> bool:
    east, north, up = setpoint.pos_enu_m
    return east is None or north is None or up is None or v.breach(east, north, up) == ""
