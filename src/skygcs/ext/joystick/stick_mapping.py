"""Axes of a joystick to a velocity and a yaw rate, with dead zone, expo and limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

CENTRED = 0.15
"""Full scale 1. Worn gamepads rest up to 0.12 off their centre; a stick that is pushed on purpose is beyond."""


@dataclass(frozen=True)
class AxisChoice:
    """One axis of the device; ``sign`` -1 turns it round."""

    number: int
    sign: int = 1


@dataclass(frozen=True)
class StickAxes:
    """Which axis says what. Default: a gamepad in mode 2, left stick height and yaw, right stick the way.

    The kernel counts axes positive to the right and towards the person.
    """

    forward: AxisChoice = AxisChoice(4, -1)
    left: AxisChoice = AxisChoice(3, -1)
    up: AxisChoice = AxisChoice(1, -1)
    yaw: AxisChoice = AxisChoice(0, -1)

    def numbers(self) -> dict[int, str]:
        """Axis number -> what it is for."""
        return {getattr(self, field.name).number: field.name for field in fields(self)}


@dataclass(frozen=True)
class StickLimits:
    """Limits of a fully deflected stick; ``speed_mps`` across, in any direction."""

    speed_mps: float = 2.0
    climb_mps: float = 1.0
    yaw_rate_dps: float = 45.0
    acc_mps2: float = 2.0
    """A deflection takes effect at most so fast; releasing the button stops at once."""
    dead_zone: float = 0.1
    expo: float = 0.3
    """0: linear, 1: cubic. More makes the middle of the stick finer."""


@dataclass(frozen=True)
class StickDemand:
    """Velocity with x forward (or along the frame's x), y left, z up in m/s; yaw rate counter-clockwise."""

    vel_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rate_dps: float = 0.0


STILL = StickDemand()


def demand(axes: StickAxes, limits: StickLimits, values: Mapping[int, float]) -> StickDemand:
    """Return what the sticks ask for; ``values`` by axis number, -1 to 1. An axis without a value is at its centre."""

    def deflection(choice: AxisChoice) -> float:
        return choice.sign * values.get(choice.number, 0.0)

    # the dead zone and the limit of the way are circles: a corner of the stick is not faster than its edge
    forward, left = deflection(axes.forward), deflection(axes.left)
    length = math.hypot(forward, left)
    scale = limits.speed_mps * shaped(length, limits) / length if length > 0 else 0.0
    climb_mps = limits.climb_mps * shaped(deflection(axes.up), limits)
    yaw_rate_dps = limits.yaw_rate_dps * shaped(deflection(axes.yaw), limits)
    return StickDemand((forward * scale, left * scale, climb_mps), yaw_rate_dps)


def shaped(deflection: float, limits: StickLimits) -> float:
    """-1 to 1: 0 within the dead zone, from its edge on without a jump, bent by expo."""
    beyond = min(abs(deflection), 1.0) - limits.dead_zone
    if not beyond > 0:  # also NaN
        return 0.0
    x = beyond / (1.0 - limits.dead_zone)
    return math.copysign((1.0 - limits.expo) * x + limits.expo * x**3, deflection)


def approach(from_mps: tuple[float, float, float], to: StickDemand, limits: StickLimits, dt_s: float) -> StickDemand:
    """The demand with a velocity that differs from ``from_mps`` by at most the acceleration times ``dt_s``."""
    change = [b - a for a, b in zip(from_mps, to.vel_mps, strict=True)]
    most, length = limits.acc_mps2 * dt_s, math.hypot(*change)
    if length <= most:
        return to
    x, y, z = (a + c * most / length for a, c in zip(from_mps, change, strict=True))
    return StickDemand((x, y, z), to.yaw_rate_dps)


def off_centre(axes: StickAxes, values: Mapping[int, float]) -> list[str]:
    """ "axis 3 (left) at 40 %" for each mapped axis that is not at its centre."""
    return [
        f"axis {number} ({name}) at {values.get(number, 0.0):.0%}"
        for number, name in sorted(axes.numbers().items())
        if not abs(values.get(number, 0.0)) <= CENTRED
    ]


def turned(vel_mps: tuple[float, float, float], yaw_rad: float) -> tuple[float, float, float]:
    """A velocity with x forward, y left along the fleet's axes; ``yaw_rad`` of the nose from x, counter-clockwise."""
    x, y, z = vel_mps
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return c * x - s * y, s * x + c * y, z
