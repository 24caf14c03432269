"""The velocity loop: the velocity that a far position error may ask for, and, axis by axis, PI with a filtered D that
follows it. Pure.

The velocity setpoint is limited to what the vehicle brakes from, and grows slowly:

    v_p  = Kp e                           as long as |v_p| <= a / Kp
           sqrt(2 a |e| - (a / Kp)²)      farther away: braking with a from there on, it stops at the reference
    v_sp = v_ref + v_p                    its length grows by at most a · dt in its own direction, beside the
                                          reference's own acceleration; it shrinks, turns back and stops at once

At 35 degrees of tilt a vehicle gains 6.9 m/s each second, more than an autopilot that brakes with 2.5 m/s² can stop
when a slow link ends the law. References within a / Kp² of the vehicle, those that move with their own velocity, and
braking are as without. Derivation and figures: docs/explanation/control-law.md.

In the PI each limit and anti-windup stands next to its integrator. Errors are in m/s, results in normalised thrust. A
step of 0 s integrates nothing; the caller uses it to freeze the integrators.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

from skygcs.core.control.gains import ControlConfig

# --- values that are made in every tick -------------------------------------------------------------------------------

T = TypeVar("T")


@dataclass_transform(frozen_default=True)
def record(cls: type[T]) -> type[T]:
    """``@dataclass(frozen=True, slots=True)`` for hot paths: immutable to mypy, and quick to make. Equality, hash and
    `replace` are the same.

    A frozen dataclass sets each of its fields through ``object.__setattr__``, 0.12 us apiece: with the sixty fields of
    what one control tick makes that is 7 us, a sixth of the tick. A record is a plain dataclass with slots at run time
    (eight fields: 0.94 -> 0.18 us, CPython 3.11), and mypy refuses to assign to its fields.
    """
    return dataclass(slots=True, unsafe_hash=True)(cls)


# --- velocity setpoint ------------------------------------------------------------------------------------------------


def approach_speed(proportional: float, near: float) -> float:
    """The speed towards a position, less than the ``proportional`` one of the P loop where it could not brake from
    that: above ``near``, a / Kp. Both at least 0."""
    return proportional if proportional <= near else math.sqrt((2.0 * proportional - near) * near)


def grown(wanted: float, before: float, most: float) -> float:
    """``wanted``, at most by ``most`` farther from 0 than ``before`` in the same direction."""
    if wanted >= 0.0:
        bound = before + most if before > 0.0 else most
        return bound if wanted > bound else wanted
    bound = before - most if before < 0.0 else -most
    return bound if wanted < bound else wanted


def grown_xy(x: float, y: float, squared: float, before_x: float, before_y: float, most: float) -> tuple[float, float]:
    """The same of a vector's length, whose square is ``squared``."""
    if squared <= most * most:
        return x, y
    size = math.sqrt(squared)
    along = (before_x * x + before_y * y) / size
    bound = along + most if along > 0.0 else most
    return (x, y) if size <= bound else (x * bound / size, y * bound / size)


# --- PI with a filtered D ---------------------------------------------------------------------------------------------


@record
class Vertical:
    """Vertical thrust. ``at_max`` and ``at_min``: the demand was above, or below, the limits."""

    thrust: float
    integral: float
    at_max: bool
    at_min: bool


@record
class Horizontal:
    """Horizontal thrust, limited by the tilt limit and the vertical thrust."""

    thrust_x: float
    thrust_y: float
    integral_x: float
    integral_y: float
    limit: float
    cut: bool
    """The demand was above ``limit``."""
    integral_at_bound: bool


def clip(value: float, bound: float) -> float:
    """The value, its magnitude at most ``bound``."""
    return -bound if value < -bound else bound if value > bound else value


def within(value: float, low: float, high: float) -> float:
    """The value, limited to the bounds. (``min(max(...))`` takes three times as long.)"""
    return low if value < low else high if value > high else value


def newest_weight(dt_s: float, cutoff_hz: float) -> float:
    """Weight of the newest value in a first-order low pass with period ``dt_s``."""
    reach = math.tau * cutoff_hz * dt_s
    return reach / (1.0 + reach)


def filtered_slope(error: float, previous_error: float, slope: float, dt_s: float, weight: float) -> float:
    """Change of the error per second through a low pass of that `newest_weight`; ``slope`` is what it gave the last
    time."""
    return weight * (error - previous_error) / dt_s + (1.0 - weight) * slope


def vertical(
    config: ControlConfig, error_mps: float, slope_mps2: float, integral: float, feedforward: float, dt_s: float
) -> Vertical:
    """The z axis, computed first: it has priority. The thrust uses the integral from before this step."""
    gains = config.z
    asked = feedforward + gains.vel_p * error_mps + integral + gains.vel_d * slope_mps2 + config.hover_thrust
    at_max = asked >= config.thrust_max
    at_min = asked <= config.thrust_min
    # Anti-windup by clamping: an error that leads further into the limit is not integrated, one that leads out is.
    if not (at_max and error_mps >= 0.0) and not (at_min and error_mps <= 0.0):
        integral += gains.vel_i * error_mps * dt_s
    integral = clip(integral, config.thrust_max)
    thrust = within(asked, config.thrust_min, config.thrust_max)
    return Vertical(thrust, integral, at_max, at_min)


def horizontal_limit(config: ControlConfig, thrust_z: float) -> float:
    """Largest horizontal thrust beside ``thrust_z``: within the tilt limit, and the vector within ``thrust_max``.

    0 if ``thrust_z`` is slightly above ``thrust_max`` by rounding, which would give the root of a negative number.
    """
    square = config.thrust_max * config.thrust_max - thrust_z * thrust_z
    left = math.sqrt(square) if square > 0.0 else 0.0
    by_tilt = thrust_z * config.tilt_max_tan
    return by_tilt if by_tilt <= left else left


def horizontal(
    config: ControlConfig,
    error_mps: Sequence[float],
    slope_mps2: Sequence[float],
    integral: tuple[float, float],
    feedforward: tuple[float, float],
    thrust_z: float,
    dt_s: float,
) -> Horizontal:
    """x and y together, scaled to what ``thrust_z`` leaves them, so that the direction stays."""
    gains = config.xy
    limit = horizontal_limit(config, thrust_z)
    asked_x = feedforward[0] + gains.vel_p * error_mps[0] + integral[0] + gains.vel_d * slope_mps2[0]
    asked_y = feedforward[1] + gains.vel_p * error_mps[1] + integral[1] + gains.vel_d * slope_mps2[1]
    norm = math.hypot(asked_x, asked_y)
    cut = norm > limit
    scale = limit / norm if cut else 1.0
    thrust_x, thrust_y = asked_x * scale, asked_y * scale

    # Anti-windup by tracking: the part cut off reduces the integral (gain 2 / vel_p, as in the law this follows).
    # It pulls past zero while the cut lasts, so the bound below is needed even though this term is there.
    tracking = 2.0 / gains.vel_p
    integral_x = integral[0] + gains.vel_i * (error_mps[0] - (asked_x - thrust_x) * tracking) * dt_s
    integral_y = integral[1] + gains.vel_i * (error_mps[1] - (asked_y - thrust_y) * tracking) * dt_s
    size = math.hypot(integral_x, integral_y)
    bound = config.integral_xy_max
    at_bound = size > bound
    if at_bound:
        integral_x, integral_y = integral_x * bound / size, integral_y * bound / size
    return Horizontal(thrust_x, thrust_y, integral_x, integral_y, limit, cut, at_bound)
