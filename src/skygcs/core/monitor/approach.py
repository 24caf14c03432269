"""The closest approach of two vehicles in closed form.

All offsets and velocities are relative (of the second vehicle against the first) and in the metric of the margin: true
east, north, up, the vertical part divided by the downwash ratio. In it the distance of two vehicles that fly straight
on is the square root of a parabola of time, so nothing is sampled.

What cannot stop holds by a circle:

    it is                                       it may be anywhere
    -----------------------------------------   -----------------------------------------------------------------
    sent to a place                             within its radius of the place, at the height of the place
    circling, about a place that is not known   within two radii of where it is: each circle through that is there
    turning now                                 on the arc that it flies (`arc`), for as long as the monitor looks ahead

The radius is that of the parameter that the autopilot holds by (NAV_LOITER_RAD, WP_LOITER_RAD), or the firmware's
default where the parameter is not known. Wind carries a circle nowhere: both firmwares fly it over the ground.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from skygcs.core.separation import Footprint, pair_margin, separation_m

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


# -- circles

LEAST_TURN_RADPS = 0.05
"""A slower turn is flown as straight on: a circle of 300 m at 15 m/s."""

MOST_TURN_RADPS = 1.0
"""A faster one is a mistake of a velocity near zero: 15 m/s and a bank of 57 degrees."""

LONGEST_TURN_S = 6.0
"""Between two velocities that show a turn: a circle of 60 m is half flown."""

ARC_STEP_S = 1.0
"""Between the corners of an arc: at 0.25 rad/s the chord is 0.8 % short of it."""


class Disc(NamedTuple):
    """Everything over the ground within a radius of a point, at one height (m, one frame)."""

    middle_m: Vector
    radius_m: float


def gap_m(a: Disc, b: Disc, ratio: float) -> float:
    """How far apart two discs are in the metric of the margin."""
    (x, y, z), (u, v, w) = a.middle_m, b.middle_m
    apart_m = math.hypot(u - x, v - y) - a.radius_m - b.radius_m
    return separation_m(max(0.0, apart_m), 0.0, w - z, ratio)


class Holder(NamedTuple):
    """A vehicle in the way of a circle, and where it may be."""

    name: str
    footprint: Footprint
    disc: Disc


def circle_conflict(name: str, footprint: Footprint, disc: Disc, others: Iterable[Holder]) -> str | None:
    """With which other vehicle the space conflicts in which this one will hold, in words; None: with none. Only pairs
    of which one circles are compared: the others are the way's."""
    worst: tuple[float, str] | None = None
    for other in others:
        if disc.radius_m == 0.0 and other.disc.radius_m == 0.0:
            continue
        margin = pair_margin(footprint, other.footprint)
        away_m = gap_m(disc, other.disc, margin.downwash_ratio)
        if away_m >= margin.total_m or (worst is not None and away_m >= worst[0]):
            continue
        circles = (
            f"{name} would circle there with {disc.radius_m:.0f} m" if disc.radius_m else f"{name} would stay there"
        )
        theirs = f", which circles within {other.disc.radius_m:.0f} m" if other.disc.radius_m else ""
        worst = (
            away_m,
            (
                f"{circles}, {away_m:.1f} m from {other.name}{theirs}; they need {margin.total_m:.1f} m, "
                f"heights divided by {margin.downwash_ratio:g}"
            ),
        )
    return None if worst is None else worst[1]


def turn_radps(older: Vector, newer: Vector, between_s: float) -> float:
    """The turn over the ground between two velocities (ENU), positive to the left; 0 if it is no turn that a wing
    flies."""
    if not 0.0 < between_s <= LONGEST_TURN_S or math.hypot(*older[:2]) < 1.0 or math.hypot(*newer[:2]) < 1.0:
        return 0.0
    cross, dot = older[0] * newer[1] - older[1] * newer[0], older[0] * newer[0] + older[1] * newer[1]
    rate = math.atan2(cross, dot) / between_s
    return rate if LEAST_TURN_RADPS <= abs(rate) <= MOST_TURN_RADPS else 0.0


def arc(velocity_mps: Vector, turn: float, horizon_s: float) -> tuple[Piece, ...]:
    """The path of a vehicle that goes on turning so: chords of `ARC_STEP_S`, each in the middle of its direction."""
    east, north, up = velocity_mps
    pieces = []
    for i in range(math.ceil(horizon_s / ARC_STEP_S)):
        angle = turn * ARC_STEP_S * (i + 0.5)
        cos, sin = math.cos(angle), math.sin(angle)
        pieces.append(Piece(ARC_STEP_S, (east * cos - north * sin, east * sin + north * cos, up)))
    return tuple(pieces)
