"""The closest approach of two vehicles in closed form.

All offsets and velocities are relative (of the second vehicle against the first) and in the metric of the margin: true
east, north, up, the vertical part divided by the downwash ratio. In it the distance of two vehicles that fly straight
on is the square root of a parabola of time, so nothing is sampled.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

Vector = tuple[float, float, float]

REST: Vector = (0.0, 0.0, 0.0)


class Approach(NamedTuple):
    """Closest approach of two vehicles within a time."""

    separation_m: float
    """The smallest."""
    at_s: float
    """When it is reached."""
    enters_s: float
    """When it first falls below the radius that was asked for; 0 if it is below now, infinite if it never is."""


def closest_approach(offset_m: Vector, velocity_mps: Vector, radius_m: float, horizon_s: float) -> Approach:
    """Closest approach of two vehicles that fly straight on for ``horizon_s``."""
    x, y, z = offset_m
    u, v, w = velocity_mps
    speed2 = u * u + v * v + w * w
    closing = x * u + y * v + z * w
    distance2 = x * x + y * y + z * z
    # the smallest distance
    at_s = 0.0 if closing >= 0.0 or speed2 == 0.0 else min(-closing / speed2, horizon_s)
    least2 = distance2 + at_s * (2.0 * closing + at_s * speed2)
    least_m = math.sqrt(least2) if least2 > 0.0 else 0.0
    # when the radius is crossed: the smaller root, in the form that loses no digits
    beyond = distance2 - radius_m * radius_m
    if beyond <= 0.0:
        return Approach(least_m, at_s, 0.0)
    root = closing * closing - speed2 * beyond
    if closing >= 0.0 or root < 0.0:
        return Approach(least_m, at_s, math.inf)
    enters_s = beyond / (math.sqrt(root) - closing)
    return Approach(least_m, at_s, enters_s if enters_s <= horizon_s else math.inf)


class Piece(NamedTuple):
    """A part of a path, flown with one velocity for so long."""

    duration_s: float
    velocity_mps: Vector


def closest_on_paths(
    offset_m: Vector,
    first: Sequence[Piece],
    second: Sequence[Piece],
    radius_m: float,
    horizon_s: float,
    noise_mps: float = 0.0,
) -> Approach:
    """The same where both fly piece by piece; after its last piece each of them stays where it is. ``noise_mps``: so
    much of each relative velocity is not believed."""
    begun_s, least = 0.0, Approach(math.inf, 0.0, math.inf)
    here = offset_m
    for duration_s, a, b in _steps(first, second, horizon_s):
        velocity = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
        if noise_mps > 0.0:
            speed_mps = math.hypot(*velocity)
            share = 1.0 - noise_mps / speed_mps if speed_mps > noise_mps else 0.0
            velocity = (velocity[0] * share, velocity[1] * share, velocity[2] * share)
        part = closest_approach(here, velocity, radius_m, duration_s)
        enters_s = min(least.enters_s, begun_s + part.enters_s)
        if part.separation_m < least.separation_m:
            least = Approach(part.separation_m, begun_s + part.at_s, enters_s)
        else:
            least = least._replace(enters_s=enters_s)
        here = (
            here[0] + velocity[0] * duration_s,
            here[1] + velocity[1] * duration_s,
            here[2] + velocity[2] * duration_s,
        )
        begun_s += duration_s
    return least


def _steps(first: Sequence[Piece], second: Sequence[Piece], horizon_s: float) -> Iterator[tuple[float, Vector, Vector]]:
    """(duration, velocity of the first, of the second) from one change of a velocity to the next, up to the horizon."""
    ends = sorted({horizon_s, *_ends(first, horizon_s), *_ends(second, horizon_s)})
    begun_s = 0.0
    for end_s in ends:
        if end_s > begun_s or len(ends) == 1:
            middle_s = (begun_s + end_s) / 2
            yield end_s - begun_s, _velocity_at(first, middle_s), _velocity_at(second, middle_s)
            begun_s = end_s


def _ends(pieces: Sequence[Piece], horizon_s: float) -> Iterator[float]:
    end_s = 0.0
    for piece in pieces:
        end_s += piece.duration_s
        if end_s < horizon_s:
            yield end_s


def _velocity_at(pieces: Sequence[Piece], at_s: float) -> Vector:
    for piece in pieces:
        if at_s < piece.duration_s:
            return piece.velocity_mps
        at_s -= piece.duration_s
    return REST
