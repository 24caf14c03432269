"""PX4's position controller as OFFBOARD uses it: no path is shaped, each axis follows what it was given.

    v_sp = v_ff + P (p_sp - p)         within MPC_XY_VEL_MAX, the position's part first
    a_sp = a_ff + PID (v_sp - v)       within MPC_TILTMAX_AIR

An axis without position and velocity follows its acceleration alone, without any feedback. Read from
mc_pos_control/PositionControl/PositionControl.cpp and MulticopterPositionControl.cpp.
"""

from __future__ import annotations

from math import hypot, sqrt

from skygcs.sim.body import GRAVITY_MPS2, AccelerationSetpoint, Body
from skygcs.sim.kinematics import Limits
from skygcs.sim.position_control import (
    ControlGains,
    PositionControl,
    PositionTarget,
    bounded_length,
    filter_share,
    leaning_acceleration,
)

DERIVATIVE_HZ = 5.0
"""MPC_VELD_LP: low-pass of the measured acceleration."""

RAMP_S = 1.5
"""Half of MPC_TKO_RAMP_T (Takeoff::updateRamp); the first half is in `Firmware.spool_up_s`."""

MOST_LIFT_MPS2 = 1.2 * GRAVITY_MPS2
"""Upwards, beside gravity: MPC_THR_MAX 1 of a vehicle that hovers at 0.45."""

INVALID_HOLD_S = 0.2
"""MulticopterPositionControl::Run: so long the last valid setpoint replaces an invalid one, then it stops."""

STOP = PositionTarget(vel_enu_mps=(0.0, 0.0, 0.0))
"""generateFailsafeSetpoint: "stop and wait"."""

IDLE = AccelerationSetpoint((0.0, 0.0, -GRAVITY_MPS2))
"""On the ground, without a take-off requested."""


class Px4PositionControl(PositionControl):
    """See the module."""

    def __init__(self, gains: ControlGains) -> None:
        super().__init__(gains)
        self._fresh = False
        self._learnt_lean = True
        self.restart()

    def restart(self, *, by_attitude: bool = False) -> None:
        self._learnt_lean = not by_attitude
        if self._fresh:
            return
        self._fresh = True
        self._integral = [0.0, 0.0, 0.0]
        self._accel = (0.0, 0.0, 0.0)
        self._last_valid: PositionTarget | None = None
        self._invalid_s = 0.0
        self._ramp: float | None = None
        """Share of the climb rate that the take-off allows by now; None: flying."""

    def step(self, body: Body, dt_s: float, target: PositionTarget, limits: Limits) -> AccelerationSetpoint:
        target = self._checked(target, dt_s)
        if self._fresh:
            self._fresh = False
            self._accel = body.accel_enu_mps2
            # MulticopterPositionControl::Run resets it as long as it does not run, as under attitude setpoints; modes
            # that are flown here without it have held the vehicle against the wind by it
            self._integral = [*leaning_acceleration(body), 0.0] if self._learnt_lean else [0.0, 0.0, 0.0]
        if body.on_ground and (self._ramp is None or not _wants_up(target, body)):
            self._integral, self._ramp = [0.0, 0.0, 0.0], 0.0
            if not _wants_up(target, body):
                return IDLE
        if self._ramp is not None:
            self._ramp += dt_s / RAMP_S
            if self._ramp >= 1.0 and not body.on_ground:
                self._ramp = None
        share = filter_share(dt_s, DERIVATIVE_HZ)
        e, n, u = self._accel
        ae, an, au = body.accel_enu_mps2
        self._accel = (e + (ae - e) * share, n + (an - n) * share, u + (au - u) * share)
        up = self._vertical(body, dt_s, target, limits)
        east, north = self._horizontal(body, dt_s, target, limits, up)
        return AccelerationSetpoint((east, north, up), target.yaw_rad, target.yaw_rate_radps or 0.0)

    def _checked(self, target: PositionTarget, dt_s: float) -> PositionTarget:
        """PositionControl::_inputValid: something on every axis, east and north in pairs."""
        axes = list(zip(target.pos_enu_m, target.vel_enu_mps, target.acc_enu_mps2, strict=True))
        valid = all(any(value is not None for value in axis) for axis in axes)
        valid = valid and all((e is None) == (n is None) for e, n in zip(axes[0], axes[1], strict=True))
        if valid:
            self._last_valid, self._invalid_s = target, 0.0
            return target
        self._invalid_s += dt_s
        return self._last_valid if self._last_valid and self._invalid_s < INVALID_HOLD_S else STOP

    def _horizontal(
        self, body: Body, dt_s: float, target: PositionTarget, limits: Limits, up_mps2: float
    ) -> tuple[float, float]:
        """East and north, within the tilt."""
        gains, held = self.gains, self._integral
        most = gains.accel_max_mps2
        pe, pn, _ = target.pos_enu_m
        ve, vn, _ = target.vel_enu_mps
        ae, an, _ = target.acc_enu_mps2
        accel_e, accel_n = ae or 0.0, an or 0.0
        if (pe is None or pn is None) and (ve is None or vn is None):
            held[0] = held[1] = 0.0  # resetIntegralXY
            return bounded_length(accel_e, accel_n, most)
        to_e = gains.xy_p * (pe - body.east_m) if pe is not None else 0.0
        to_n = gains.xy_p * (pn - body.north_m) if pn is not None else 0.0
        want_e, want_n = constrained(to_e, to_n, ve or 0.0, vn or 0.0, limits.speed_mps)
        error_e, error_n = want_e - body.vel_e_mps, want_n - body.vel_n_mps
        accel_e += gains.xy_vel_p * error_e + held[0] - gains.xy_vel_d * self._accel[0]
        accel_n += gains.xy_vel_p * error_n + held[1] - gains.xy_vel_d * self._accel[1]
        east, north = bounded_length(accel_e, accel_n, most)
        lift = max(0.0, 1.0 + up_mps2 / GRAVITY_MPS2)  # thrust makes more or less of the same lean
        if hypot(accel_e, accel_n) > hypot(east, north) * lift and gains.xy_vel_p > 0.0:
            unwind = 2.0 / gains.xy_vel_p
            error_e -= unwind * (accel_e - east * lift)
            error_n -= unwind * (accel_n - north * lift)
        held[0] += gains.xy_vel_i * error_e * dt_s
        held[1] += gains.xy_vel_i * error_n * dt_s
        return east, north

    def _vertical(self, body: Body, dt_s: float, target: PositionTarget, limits: Limits) -> float:
        gains, held = self.gains, self._integral
        pu, vu, au = target.pos_enu_m[2], target.vel_enu_mps[2], target.acc_enu_mps2[2]
        if pu is None and vu is None:
            return max(-GRAVITY_MPS2, min(MOST_LIFT_MPS2, au or 0.0))
        climb = limits.climb_mps if self._ramp is None else limits.climb_mps * min(1.0, self._ramp)
        want = (vu or 0.0) + (gains.z_p * (pu - body.up_m) if pu is not None else 0.0)
        error = max(-limits.descent_mps, min(climb, want)) - body.vel_u_mps
        held[2] = max(-GRAVITY_MPS2, min(GRAVITY_MPS2, held[2]))
        accel = gains.z_vel_p * error + held[2]
        if au is not None and self._ramp is None:
            accel += au
        if -GRAVITY_MPS2 < accel < MOST_LIFT_MPS2:  # no integration into the limits of the thrust
            held[2] += gains.z_vel_i * error * dt_s
        return max(-GRAVITY_MPS2, min(MOST_LIFT_MPS2, accel))


def _wants_up(target: PositionTarget, body: Body) -> bool:
    """MulticopterPositionControl::Run: want_takeoff in OFFBOARD."""
    up, climb, push = target.pos_enu_m[2], target.vel_enu_mps[2], target.acc_enu_mps2[2]
    if up is not None and up > body.up_m:
        return True
    return (climb is not None and climb > 0.0) or (push is not None and push > 0.0)


def constrained(to_e: float, to_n: float, ff_e: float, ff_n: float, most: float) -> tuple[float, float]:
    """ControlMath::constrainXY: their sum, at most so fast; the feed-forward is shortened first."""
    if hypot(to_e + ff_e, to_n + ff_n) <= most:
        return to_e + ff_e, to_n + ff_n
    first = hypot(to_e, to_n)
    if first >= most or hypot(ff_e - to_e, ff_n - to_n) < 1e-3:
        return to_e * most / first, to_n * most / first
    ahead = hypot(ff_e, ff_n)
    if first < 1e-3:
        return ff_e * most / ahead, ff_n * most / ahead
    unit_e, unit_n = ff_e / ahead, ff_n / ahead
    along = unit_e * to_e + unit_n * to_n
    scale = -along + sqrt(along * along - (first * first - most * most))
    return to_e + unit_e * scale, to_n + unit_n * scale
