"""Limits the velocity setpoint that a far reference may build up: no faster than it brakes, and growing slowly. Pure.

    v_p  = Kp e                           as long as |v_p| <= a / Kp
           sqrt(2 a |e| - (a / Kp)²)      farther away: braking with a from there on, it stops at the reference
    v_sp = v_ref + v_p                    its length grows by at most a · dt in its own direction, beside the
                                          reference's own acceleration; it shrinks, turns back and stops at once

At 35 degrees of tilt a vehicle gains 6.9 m/s each second, more than an autopilot that brakes with 2.5 m/s² can stop
when a slow link ends the law. References within a / Kp² of the vehicle, those that move with their own velocity, and
braking are as without. Derivation and figures: docs/explanation/control-law.md.
"""

from __future__ import annotations

import math


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
