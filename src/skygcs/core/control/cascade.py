"""One step of the position controller: position error -> velocity -> thrust vector -> attitude and thrust.

    x_ref, x ──> P ──(+ v_ref, limits)──> v_sp, v ──> PI(D) ──(+ a_ref, hover, limits)──> thrust ──(yaw)──> attitude

Pure, and free of MAVLink: `step` takes what it remembers and returns what to remember. World frame ENU (x east,
y north, z up). Yaw is 0 = east and counter-clockwise positive; compass yaw (NED) is pi/2 minus it. Attitudes are
quaternions (w, x, y, z) that rotate body vectors to world vectors, once FLU body in ENU world and once FRD body in NED
world, the latter as autopilots take it. There are no body rates: the attitude's type mask makes the autopilot
ignore them. Measured: 4.4 us a step (CPython 3.11, one core of a virtual machine).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from skygcs.core.control.gains import GRAVITY_MPS2, ControlConfig
from skygcs.core.control.velocity_loop import (
    Horizontal,
    Vertical,
    approach_speed,
    clip,
    filtered_slope,
    grown,
    grown_xy,
    horizontal,
    newest_weight,
    record,
    vertical,
    within,
)

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

ZERO: Vector = (0.0, 0.0, 0.0)

LARGEST_INPUT = 1e6
"""m, m/s, m/s², rad or s. Larger values (1000 km) are impossible and refused like NaN."""

_SQRT_HALF = math.sqrt(0.5)


class _Judged:
    """Checks its numbers once, when it is created: the guard and the law both read an estimate, and a reference stays
    for many steps."""

    __slots__ = ("usable",)

    usable: bool
    """None of them is NaN, infinite or above `LARGEST_INPUT`."""

    def _judge(self, *vectors: Vector) -> None:
        largest = LARGEST_INPUT
        for x, y, z in vectors:
            if not (-largest <= x <= largest and -largest <= y <= largest and -largest <= z <= largest):  # also for NaN
                object.__setattr__(self, "usable", False)
                return
        object.__setattr__(self, "usable", True)  # immutable, and made of nothing but the fields


@record
class Estimate(_Judged):
    """Position and velocity of the vehicle. The guard checks their age."""

    pos_enu_m: Vector
    vel_enu_mps: Vector

    def __post_init__(self) -> None:
        self._judge(self.pos_enu_m, self.vel_enu_mps)


@dataclass(frozen=True, slots=True)
class Reference(_Judged):
    """Reference that the vehicle is to follow. An axis marked as velocity only follows ``vel_enu_mps``; its position,
    which the law does not use, is where that velocity has led since it began."""

    pos_enu_m: Vector = ZERO
    yaw_rad: float = 0.0
    """ENU: 0 = east, counter-clockwise positive. Not wrapped: any multiple of a turn means the same."""
    vel_enu_mps: Vector = ZERO
    acc_enu_mps2: Vector = ZERO
    velocity_only_xy: bool = False
    velocity_only_z: bool = False
    yaw_rate_radps: float = 0.0
    """Counter-clockwise positive. The law has no use for it: ``yaw_rad`` turns with it already."""
    yaw_rate_only: bool = False
    """It turns with the rate, from wherever its nose is, and ``yaw_rad`` is only where it should be by now."""

    def __post_init__(self) -> None:
        self._judge(self.pos_enu_m, self.vel_enu_mps, self.acc_enu_mps2, (self.yaw_rad, self.yaw_rate_radps, 0.0))

    @property
    def moves(self) -> bool:
        """True if it has a velocity: only then does an acceleration mean anything, and only then is it ahead of itself
        by the time an order takes."""
        return self.vel_enu_mps != ZERO

    @property
    def velocity_only(self) -> bool:
        """True if at least one axis follows a velocity and has no position."""
        return self.velocity_only_xy or self.velocity_only_z

    def ahead(self, time_s: float) -> Reference:
        """The same reference this much later: position and velocity by velocity and acceleration, yaw by its rate.

        A reference that slows down stops; no acceleration turns it back.
        """
        if time_s == 0.0 or not (self.moves or self.yaw_rate_radps):
            return self
        (x, y, z), (vx, vy, vz) = self.pos_enu_m, self.vel_enu_mps
        ax, ay, az = self.acc_enu_mps2
        along = vx * ax + vy * ay + vz * az
        t = time_s if along >= 0.0 else min(time_s, -(vx * vx + vy * vy + vz * vz) / along)
        half, rest = 0.5 * t * t, time_s - t
        later = (vx + ax * t, vy + ay * t, vz + az * t)
        return Reference(
            (
                x + vx * t + ax * half + later[0] * rest,
                y + vy * t + ay * half + later[1] * rest,
                z + vz * t + az * half + later[2] * rest,
            )
            if self.moves
            else self.pos_enu_m,
            self.yaw_rad + self.yaw_rate_radps * time_s,
            later if self.moves else self.vel_enu_mps,
            self.acc_enu_mps2 if rest == 0.0 else ZERO,
            self.velocity_only_xy,
            self.velocity_only_z,
            self.yaw_rate_radps,
            self.yaw_rate_only,
        )


@record
class Memory:
    """State between two steps. A new one, ``Memory()``, has integral 0."""

    integral_enu: Vector = ZERO
    """In normalised thrust: the steady thrust against wind (x, y) and a wrong hover thrust (z)."""
    vel_error_enu_mps: Vector | None = None
    """Velocity error of the last step; None before the first step, which has no slope."""
    slope_enu_mps2: Vector = ZERO
    """Filtered change of the velocity error."""
    vel_setpoint_enu_mps: Vector | None = None
    """Velocity setpoint of the last step; None before the first: the next one grows from the vehicle's velocity."""


@record
class Saturation:
    """The limits that the step reached, for display."""

    velocity_xy: bool
    velocity_z: bool
    thrust_max: bool
    thrust_min: bool
    tilt: bool
    """Horizontal thrust cut by the tilt limit."""
    no_thrust_left: bool
    """Horizontal thrust cut because the vertical, which has priority, takes the rest."""
    integral_xy: bool
    integral_z: bool
    dt: bool
    """The measured step was outside [0.5, 1.5] periods: the loop ran late, or twice."""

    def names(self) -> tuple[str, ...]:
        """The limits reached, by name."""
        return tuple(limit.name for limit in fields(self) if getattr(self, limit.name))


@record
class Output:
    """The output, valid until the next step."""

    attitude_ned_frd: Quaternion
    """(w, x, y, z) as SET_ATTITUDE_TARGET wants it; w is never negative."""
    collective_thrust: float
    """Along the body's up axis, 0..1: the length of ``thrust_enu``."""
    attitude_enu_flu: Quaternion
    """The same attitude in our own frames."""
    thrust_enu: Vector
    """Normalised thrust vector."""
    vel_setpoint_enu_mps: Vector
    """Velocity setpoint, from the position loop to the velocity loop."""
    roll_frd_rad: float
    """Right side down positive."""
    pitch_frd_rad: float
    """Nose up positive."""
    saturation: Saturation


def step(
    config: ControlConfig, memory: Memory, estimate: Estimate, reference: Reference, dt_s: float, *, following: bool
) -> tuple[Output | None, Memory]:
    """One control step, ``dt_s`` (measured) after the last. ``following``: the autopilot follows us (OFFBOARD, GUIDED).

    Otherwise the integrators are frozen: they would wind up while something else controls the vehicle. An input that is
    NaN, infinite or above `LARGEST_INPUT` gives no output and leaves the memory unchanged; the caller decides what to
    send. With any other input all output is finite and within the limits.
    """
    if not (reference.usable and estimate.usable and -LARGEST_INPUT <= dt_s <= LARGEST_INPUT):
        return None, memory
    dt = within(dt_s, config.dt_min_s, config.dt_max_s)
    integration_dt = dt if following else 0.0

    wanted = velocity_setpoint(
        config, estimate.pos_enu_m, reference, memory.vel_setpoint_enu_mps or estimate.vel_enu_mps, dt
    )
    vx, vy, vz = estimate.vel_enu_mps
    error = (wanted[0] - vx, wanted[1] - vy, wanted[2] - vz)
    slope = _slope(config, memory, error, dt)
    # A normalised thrust of hover carries 1 g: an acceleration in m/s² weighs hover / g.
    weight = config.hover_thrust / GRAVITY_MPS2
    ax, ay, az = reference.acc_enu_mps2
    held_x, held_y, held_z = memory.integral_enu

    up = vertical(config, error[2], slope[2], held_z, weight * az, integration_dt)
    push = (weight * ax, weight * ay)
    level = horizontal(config, error, slope, (held_x, held_y), push, up.thrust, integration_dt)

    thrust = (level.thrust_x, level.thrust_y, up.thrust)
    saturation = _saturation(config, wanted, up, level, dt != dt_s)
    output = _output(thrust, reference.yaw_rad, config.thrust_max, wanted, saturation)
    return output, Memory((level.integral_x, level.integral_y, up.integral), error, slope, wanted)


def velocity_step(
    config: ControlConfig, memory: Memory, estimate: Estimate, reference: Reference, dt_s: float
) -> tuple[Vector | None, Memory]:
    """The outer loop alone, for an autopilot that closes the velocity loop itself; as `step`. ENU, m/s."""
    if not (reference.usable and estimate.usable and 0.0 <= dt_s <= LARGEST_INPUT):
        return None, memory
    before = memory.vel_setpoint_enu_mps or estimate.vel_enu_mps
    wanted = velocity_setpoint(config, estimate.pos_enu_m, reference, before, dt_s)
    return wanted, Memory(memory.integral_enu, memory.vel_error_enu_mps, memory.slope_enu_mps2, wanted)


def velocity_setpoint(
    config: ControlConfig,
    pos_enu_m: Vector,
    reference: Reference,
    before: Vector,
    dt_s: float,
    vel_ref_enu_mps: Vector | None = None,
) -> Vector:
    """The velocity towards the reference, ``dt_s`` after ``before`` was asked for (`velocity_loop`).
    ``vel_ref_enu_mps``: to take instead of the reference's own."""
    x, y, z = pos_enu_m
    x_ref, y_ref, z_ref = reference.pos_enu_m
    vx, vy, vz = reference.vel_enu_mps if vel_ref_enu_mps is None else vel_ref_enu_mps
    if not reference.velocity_only_xy:
        p = config.xy.pos_p_per_s
        px, py = p * (x_ref - x), p * (y_ref - y)
        if (squared := px * px + py * py) > config.near_xy_squared:
            share = approach_speed(math.sqrt(squared), math.sqrt(config.near_xy_squared)) / math.sqrt(squared)
            px, py = px * share, py * share
        vx, vy = vx + px, vy + py
    if not reference.velocity_only_z:
        pz = config.z.pos_p_per_s * (z_ref - z)
        if not -config.near_z_mps <= pz <= config.near_z_mps:
            pz = math.copysign(approach_speed(abs(pz), config.near_z_mps), pz)
        vz += pz
    if (acc_xy := config.acc_xy_max_mps2) is not None:
        bx, by, _ = before
        if (squared := vx * vx + vy * vy) > bx * vx + by * vy:  # it grows
            ax, ay, _ = reference.acc_enu_mps2
            vx, vy = grown_xy(vx, vy, squared, bx + ax * dt_s, by + ay * dt_s, acc_xy * dt_s)
    if (acc_z := config.acc_z_max_mps2) is not None:
        vz = grown(vz, before[2] + reference.acc_enu_mps2[2] * dt_s, acc_z * dt_s)
    return clip(vx, config.vel_xy_max_mps), clip(vy, config.vel_xy_max_mps), clip(vz, config.vel_z_max_mps)


def attitude_from_thrust(thrust_enu: Vector, yaw_rad: float) -> tuple[Quaternion, float, float]:
    """Attitude (ENU/FLU) whose up axis is along the thrust and whose nose, seen from above, points along the yaw.

    Also its FLU roll and pitch. Of the two rotations that put the body's up axis where the thrust is, roll (about the
    nose) is the inner one and pitch the outer, which leaves the nose in the vertical plane of the yaw:

        heading frame:  up axis = (sin pitch cos roll, -sin roll, cos pitch cos roll)

    The thrust needs an upward or level part, which `step` guarantees; without any thrust the attitude is level.
    """
    cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
    ahead = cos_yaw * thrust_enu[0] + sin_yaw * thrust_enu[1]
    left = cos_yaw * thrust_enu[1] - sin_yaw * thrust_enu[0]
    roll = math.atan2(-left, math.hypot(ahead, thrust_enu[2]))
    pitch = math.atan2(ahead, thrust_enu[2])

    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    w = cy * cp * cr + sy * sp * sr
    x = cy * cp * sr - sy * sp * cr
    y = cy * sp * cr + sy * cp * sr
    z = sy * cp * cr - cy * sp * sr
    return _w_not_negative(w, x, y, z), roll, pitch


def ned_frd_from_enu_flu(attitude: Quaternion) -> Quaternion:
    """The same attitude with the world axes turned from ENU to NED and the body axes from FLU to FRD.

    (0, 1, 1, 0)/sqrt 2 swaps east with north and turns up to down, (0, 1, 0, 0) does left to right and up to down;
    their product with the attitude between them, multiplied out.
    """
    w, x, y, z = attitude
    return _w_not_negative((w + z) * _SQRT_HALF, (x + y) * _SQRT_HALF, (x - y) * _SQRT_HALF, (w - z) * _SQRT_HALF)


def _output(thrust: Vector, yaw_rad: float, thrust_max: float, wanted: Vector, saturation: Saturation) -> Output:
    """Positional arguments, as in `_saturation`: keywords would cost 0.7 us of the step's 5.5."""
    attitude, roll, pitch = attitude_from_thrust(thrust, yaw_rad)
    collective = math.hypot(*thrust)
    if collective > thrust_max:  # by rounding, a hair
        collective = thrust_max
    return Output(ned_frd_from_enu_flu(attitude), collective, attitude, thrust, wanted, roll, -pitch, saturation)


def _saturation(config: ControlConfig, wanted: Vector, up: Vertical, level: Horizontal, dt_clamped: bool) -> Saturation:
    by_tilt = level.limit >= up.thrust * config.tilt_max_tan
    most_xy = config.vel_xy_max_mps
    return Saturation(
        abs(wanted[0]) >= most_xy or abs(wanted[1]) >= most_xy,
        abs(wanted[2]) >= config.vel_z_max_mps,
        up.at_max,
        up.at_min,
        level.cut and by_tilt,
        level.cut and not by_tilt,
        level.integral_at_bound,
        abs(up.integral) >= config.thrust_max,
        dt_clamped,
    )


def _slope(config: ControlConfig, memory: Memory, error: Vector, dt_s: float) -> Vector:
    before, slope = memory.vel_error_enu_mps, memory.slope_enu_mps2
    if before is None:  # the first error has no predecessor; a difference from 0 would be a jump
        return ZERO
    weight = newest_weight(dt_s, config.derivative_cutoff_hz)
    return (
        filtered_slope(error[0], before[0], slope[0], dt_s, weight),
        filtered_slope(error[1], before[1], slope[1], dt_s, weight),
        filtered_slope(error[2], before[2], slope[2], dt_s, weight),
    )


def _w_not_negative(w: float, x: float, y: float, z: float) -> Quaternion:
    """A quaternion and its negative are the same attitude; return the one with w >= 0, so that values compare."""
    return (w, x, y, z) if w >= 0.0 else (-w, -x, -y, -z)
