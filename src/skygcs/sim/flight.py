"""One tick of a simulated vehicle's flight: plan, setpoint, motion, battery, and whether it is in the air."""

from __future__ import annotations

from dataclasses import replace

from skygcs.sim.body import AccelerationSetpoint, AttitudeSetpoint
from skygcs.sim.kinematics import Limits, Setpoint
from skygcs.sim.position_control import PositionTarget
from skygcs.sim.quad import Quad
from skygcs.sim.vehicle_state import VehicleState

ROLLS_MPS = 5.0
"""Faster along the ground than this is no landing yet (PX4: LNDFW_VEL_XY_MAX; ArduPlane takes its GPS speed likewise,
is_flying.cpp)."""

FLYING_ABOVE_M = 0.15
"""Higher than this is taken off."""


def step(v: VehicleState, now: float, dt_s: float) -> None:
    """Move on by one tick of ``dt_s`` that ends at ``now``."""
    motion = v.motion
    # most of a fleet most of the time
    if v.landed and not v.armed and motion.on_ground and motion.groundspeed_mps == 0.0:
        v.battery.step(dt_s, flying=False)
        v.sensors.step()
        return
    setpoint, limits = v.plan.step(v.estimated, v.limits(), now)
    lifts = v.armed and setpoint is not None and now - v.armed_at >= v.firmware.spool_up_s.simulated
    if v.landed and v.plan.landing:
        lifts = False
    if isinstance(motion, Quad):
        motion.supply_v = v.battery.volts
    flown = _as_flown(v, setpoint, limits, dt_s) if lifts else None
    if not isinstance(flown, AccelerationSetpoint):
        v.position_control.restart(by_attitude=isinstance(flown, AttitudeSetpoint))
    motion.step(dt_s, flown, limits)
    v.sensors.step()
    v.battery.step(dt_s * v.faults.battery_drain, flying=not motion.on_ground, climb_mps=motion.vel_u_mps)
    _watch_ground(v, now)


def _watch_ground(v: VehicleState, now: float) -> None:
    """Taken off when it is clear of the ground, landed when it has lain there for a while. Disarmed it is landed for
    both firmwares, wherever it is (MulticopterLandDetector::_get_landed_state; Copter::update_land_detector)."""
    if not v.flies:
        v.landed = not v.armed
    elif not v.armed:
        if not v.landed:
            v.landed, v.landed_at = True, now
            v.on_landed(now)
    elif v.landed:
        if v.motion.up_m > FLYING_ABOVE_M:
            v.landed = False
            v.flown_since_arming = True
            v.touched_at = None
            v.on_takeoff(now)
    elif (
        not v.motion.on_ground
        or v.motion.groundspeed_mps > ROLLS_MPS
        or (v.armed and v.motion.crashed and v.firmware.crash.simulated[3] > 0.0)
    ):
        v.touched_at = None  # ArduCopter's land detector takes no landing with such an error of the attitude
    elif v.touched_at is None:
        v.touched_at = now
    elif now - v.touched_at >= v.firmware.landed_after_s.simulated:
        v.landed = True
        v.landed_at = now
        v.on_landed(now)


def _as_flown(
    v: VehicleState, setpoint: Setpoint | PositionTarget | AttitudeSetpoint | None, limits: Limits, dt_s: float
) -> Setpoint | AttitudeSetpoint | AccelerationSetpoint | None:
    """Return what the body flies: the acceleration that the firmware's controller asks for on the way to a position
    target; the setpoint of a leg, towards where the vehicle, wrong about where it is, takes it to be."""
    if isinstance(setpoint, PositionTarget):
        return v.position_control.step(v.estimated, dt_s, setpoint, limits)
    if v.estimated is v.motion or not isinstance(setpoint, Setpoint):
        return setpoint
    east, north, up = setpoint.pos_enu_m
    off_e, off_n, off_u = v.sensors.error_enu_m
    shifted = (
        None if east is None else east - off_e,
        None if north is None else north - off_n,
        None if up is None else up - off_u,
    )
    return replace(setpoint, pos_enu_m=shifted)
