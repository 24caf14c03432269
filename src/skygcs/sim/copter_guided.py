"""ArduCopter's GUIDED targets: which are taken, and what becomes of one that nobody renews."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from skygcs.sim.attitude_targets import Refusal, copter_attitude
from skygcs.sim.behaviours import CopterMode
from skygcs.sim.body import AttitudeSetpoint
from skygcs.sim.kinematics import Setpoint
from skygcs.sim.legs import Follow
from skygcs.sim.position_targets import setpoint_of

if TYPE_CHECKING:
    from skygcs.sim.ardupilot import CopterVehicle

THRUST_AS_THRUST = 8
"""GUID_OPTIONS bit 3: SET_ATTITUDE_TARGET.thrust is thrust; without it, a climb rate."""

SHORTEST_TIMEOUT_S = 0.1
"""The firmware's lower bound of GUID_TIMEOUT."""


def take(v: CopterVehicle, name: str, fields: dict[str, Any], now: float) -> None:
    """A SET_ATTITUDE_TARGET or SET_POSITION_TARGET_*; nothing interrupts a take-off."""
    if v.mode != CopterMode.GUIDED or v.taking_off:
        return
    setpoint: Setpoint | AttitudeSetpoint | None
    if name == "SET_ATTITUDE_TARGET":
        target = _attitude(v, fields)
        if isinstance(target, Refusal):
            _stop(v)
            return
        setpoint = target
        lifts = target is not None and (target.thrust or target.climb_mps) > 0.0
    else:
        setpoint = setpoint_of(v, name, fields, any_bit=True)
        lifts = False  # from the ground only NAV_TAKEOFF or an attitude with a climb lifts it
        if setpoint is not None and not _within_fence(v, setpoint):
            return
    if setpoint is None or (v.landed and not lifts):
        return
    v.setpoint_at = now
    v.velocity_target = isinstance(setpoint, Setpoint) and setpoint.pos_enu_m[0] is None
    v.plan.fly(Follow(setpoint))


def watch(v: CopterVehicle, now: float) -> None:
    """A velocity that nobody renews ends in a stop, an attitude level and without climb; a position stays.

    Level is not still: it drifts with the wind until somebody or a failsafe changes the mode.
    """
    if v.mode != CopterMode.GUIDED:
        return
    age, leg = now - v.setpoint_at, v.plan.leg
    longest = max(SHORTEST_TIMEOUT_S, v.params[v.firmware.setpoint_timeout.simulated])
    if v.velocity_target and age > longest:
        _stop(v)
    elif isinstance(leg, Follow) and isinstance(leg.setpoint, AttitudeSetpoint):
        if v.attitude_timeout_s is not None:
            longest = v.attitude_timeout_s
        if age > longest and leg.setpoint.attitude_ned_frd is not None:
            v.plan.fly(Follow(AttitudeSetpoint(None)))


def _stop(v: CopterVehicle) -> None:
    v.velocity_target = False
    v.hold_here()


def _attitude(v: CopterVehicle, fields: dict[str, Any]) -> AttitudeSetpoint | Refusal | None:
    p = v.params
    return copter_attitude(
        fields,
        thrust_as_thrust=bool(int(p["GUID_OPTIONS"]) & THRUST_AS_THRUST),
        climb_mps=p["WPNAV_SPEED_UP"] / 100,
        descent_mps=p["WPNAV_SPEED_DN"] / 100,
        angle_boost=bool(p["ATC_ANGLE_BOOST"]),
    )


def _within_fence(v: CopterVehicle, setpoint: Setpoint) -> bool:
    east, north, up = setpoint.pos_enu_m
    return east is None or north is None or up is None or v.inside_fence(east, north, up)
