"""Check whether an order would bring a vehicle too close to another, before it is sent.

The path of the order is a straight line, after which the vehicle stays.

    another vehicle                           is compared
    ---------------------------------------   ----------------------------------------------------------------------
    is parked, or stands in the air           where it is
    was sent somewhere, comes home or down    as space with its way (`space_conflict`): when either of the two is where
                                              is not known, as they climb, sink and fly with speeds of their own
    flies otherwise                           flying straight on for the horizon, while this one flies `GOTO_MPS`: a
                                              model, and the monitor goes on watching
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from skygcs.core.geo import EnuFrame, Origin, ecef
from skygcs.core.monitor.approach import REST, Disc, Holder, Piece, Vector, circle_conflict, closest_on_paths
from skygcs.core.monitor.conflict_levels import HORIZON_S, NOISE_MPS
from skygcs.core.monitor.tracks import TRACK_SILENT_S, Place, Track
from skygcs.core.monitor.ways import Way, conflict_text, distance_m, sloped, standing, too_near
from skygcs.core.monitor.yielding import scaled, scaled_pieces
from skygcs.core.separation import Footprint, pair_margin, separation_m

GOTO_MPS = 5.0
"""PX4's MPC_XY_CRUISE; ArduCopter's WPNAV_SPEED is 5 to 10 m/s by version."""

CLIMB_MPS = 2.0

CLIMB_SLOPE = 0.2
"""Height over distance of a plane's climb: 11 degrees, between PX4's least pitch (10) and ArduPlane's (15)."""

AHEAD_S = 3.0
"""Time for which a streamed velocity is carried on: the next setpoints may be others."""

NEARER_M = 0.2
"""Two that are within their margin already may be sent anywhere that is not nearer by more than this."""

FRESH_S = 1.0
"""The ball of a vehicle grows from this age on: an order must not depend on when the last position came."""

FORGET = "; once you know that it is not there: skygcs-cli forget {name} --force"
"""To a person, of a vehicle that was lost in the air."""

OLD_S = 2.0
"""A position older than this is named as a reason."""


@dataclass(frozen=True, slots=True)
class Mover:
    """The vehicle of the order."""

    key: int
    name: str
    footprint: Footprint
    here: Place
    circle_m: float = 0.0
    """Radius of the circle by which it holds; 0: it stops."""


class Other(NamedTuple):
    """A vehicle that may be in the way, and where skygcs has sent it; None: nowhere that is known. With a destination
    only the circle counts here by which it holds there: its way is one of `space_conflict`."""

    track: Track
    destination: Place | None = None
    stays_yet: bool = False
    """It was sent elsewhere, and is not seen flying there."""


class _Path(NamedTuple):
    """The way of an order in the frame of the vehicle that it is for, from (0, 0, 0) on."""

    pieces: tuple[Piece, ...]
    duration_s: float
    ahead_s: float
    """How long after it others are looked at that fly straight on."""
    strict: bool
    """True if vehicles count that stand within the margin already."""

    @property
    def length_m(self) -> float:
        return sum(piece.duration_s * math.hypot(*piece.velocity_mps) for piece in self.pieces)


def goto_conflict(mover: Mover, to: Place, others: Iterable[Other], now: float) -> str | None:
    """With which vehicle the straight way to a place conflicts, in words; None: with none."""
    frame, others = mover_frame(mover), list(others)
    end = frame.from_geodetic(*to)
    way = _conflict(mover, frame, _straight(end, GOTO_MPS, HORIZON_S), others, now)
    return way or circle_conflict(
        mover.name, mover.footprint, Disc(end, mover.circle_m), _holders(mover, frame, others)
    )


def takeoff_conflict(mover: Mover, height_m: float, others: Iterable[Other], now: float) -> str | None:
    """The same of the way up, and of where it holds then. Vehicles that stand too near already count: it may be carried
    sideways as it rises."""
    frame, others, end = mover_frame(mover), list(others), (0.0, 0.0, height_m)
    path = _straight(end, CLIMB_MPS, HORIZON_S)._replace(strict=True)
    way = _conflict(mover, frame, path, others, now)
    return way or circle_conflict(
        mover.name, mover.footprint, Disc(end, mover.circle_m), _holders(mover, frame, others)
    )


def climb_out_end(mover: Mover, height_m: float, heading_rad: float) -> Place:
    """Where the way ends of a plane that takes off ahead. ``heading_rad``: compass."""
    along_m = height_m / CLIMB_SLOPE
    end = (along_m * math.sin(heading_rad), along_m * math.cos(heading_rad), height_m)
    return mover_frame(mover).to_geodetic(*end)


def setpoint_conflict(
    mover: Mover, to: Place | None, velocity_mps: Vector, others: Iterable[Other], now: float
) -> str | None:
    """The same of one setpoint of a stream: a place to be at now, or without one a velocity (true ENU)."""
    frame = mover_frame(mover)
    if to is None:
        path = _Path((Piece(AHEAD_S, velocity_mps),), AHEAD_S, 0.0, False)
    else:
        path = _straight(frame.from_geodetic(*to), GOTO_MPS, 0.0)
    return _conflict(mover, frame, path, others, now)


def space_conflict(mover: Mover, to: Place, ways: Iterable[Way], *, strict: bool = False) -> str | None:
    """With which of these ways (in `mover_frame`) the straight way to a place conflicts, in words, whichever of the two
    is where; None: with none. ``strict``: although it is not nearer there than it is."""
    mine = Way(mover.key, mover.name, mover.footprint, sloped((REST, mover_frame(mover).from_geodetic(*to))))
    here = replace(mine, legs=standing(REST))
    worst: tuple[float, Way] | None = None
    for way in ways:
        if not too_near(mine, way):
            continue
        near_m = distance_m(mine, way)
        if not strict and too_near(here, way) and near_m > distance_m(here, way) - NEARER_M:
            continue
        if worst is None or near_m < worst[0]:
            worst = near_m, way
    return None if worst is None else conflict_text(mine, worst[1], worst[0])


def mover_frame(mover: Mover) -> EnuFrame:
    """East, north, up of where it is."""
    return EnuFrame(Origin(*mover.here))


def holding_disc(other: Other, frame: EnuFrame) -> Disc:
    """Where another vehicle holds, or will: its circle about the place to which skygcs has sent it. One that is not
    known may be on any side of the middle of its circle, so all within two radii of it counts."""
    track = other.track
    radius_m = 0.0 if track.parked else track.circle_m
    if other.destination is not None:
        return Disc(frame.from_geodetic(*other.destination), radius_m)
    return Disc(frame.from_ecef(track.ecef_m), 2.0 * radius_m)


def _holders(mover: Mover, frame: EnuFrame, others: Iterable[Other]) -> Iterator[Holder]:
    """Where the others hold, or will."""
    for other in others:
        if other.track.key != mover.key:
            yield Holder(other.track.name, other.track.footprint, holding_disc(other, frame))


def _straight(to: Vector, speed_mps: float, ahead_s: float) -> _Path:
    duration_s = math.hypot(*to) / speed_mps
    if duration_s == 0.0:
        return _Path((), 0.0, ahead_s, False)
    velocity = (to[0] / duration_s, to[1] / duration_s, to[2] / duration_s)
    return _Path((Piece(duration_s, velocity),), duration_s, ahead_s, False)


def _conflict(mover: Mover, frame: EnuFrame, path: _Path, others: Iterable[Other], now: float) -> str | None:
    length_m = path.length_m
    here_m = ecef(*mover.here)
    worst: tuple[float, str] | None = None
    for other in others:
        track = other.track
        if track.key == mover.key or other.destination is not None:
            continue
        margin = pair_margin(mover.footprint, track.footprint)
        ratio = margin.downwash_ratio
        silence_s = 0.0 if track.parked else max(0.0, now - track.at)
        age_s = min(silence_s, TRACK_SILENT_S)  # the space of a lost one grows no more
        radius_m = margin.total_m + track.footprint.ball_m(max(0.0, age_s - FRESH_S))
        # too far away to be reached by either of them
        theirs_m = 0.0 if track.parked else math.hypot(*track.reported_mps) * (path.duration_s + path.ahead_s + age_s)
        away_m = math.dist(here_m, track.ecef_m)
        if away_m > length_m + theirs_m + radius_m * ratio:
            continue
        offset, pieces, horizon_s = _their_path(frame, other, age_s, path)
        near = closest_on_paths(
            scaled(offset, ratio), scaled_pieces(path.pieces, ratio), scaled_pieces(pieces, ratio), radius_m, horizon_s
        )
        if math.isinf(near.enters_s):
            continue
        now_m = separation_m(*offset, ratio)
        if not path.strict and now_m < radius_m and near.separation_m > now_m - NEARER_M:
            continue
        if worst is None or near.separation_m < worst[0]:
            worst = (near.separation_m, _text(mover, other, near.separation_m, radius_m, silence_s))
    return None if worst is None else worst[1]


def _their_path(frame: EnuFrame, other: Other, age_s: float, path: _Path) -> tuple[Vector, tuple[Piece, ...], float]:
    """Where another vehicle is in this frame, how it will fly, and for how long both are looked at."""
    track = other.track
    reported = frame.from_ecef(track.ecef_m)
    horizon_s = path.duration_s + path.ahead_s
    if track.parked:
        return reported, (), horizon_s
    u, v, w = track.reported_mps
    here = (reported[0] + u * age_s, reported[1] + v * age_s, reported[2] + w * age_s)
    speed_mps = math.hypot(u, v, w)
    if track.lost:
        return here, (), horizon_s
    if speed_mps <= 2 * NOISE_MPS:
        return here, (), horizon_s
    return here, (Piece(math.inf, (u, v, w)),), horizon_s if path.ahead_s == 0.0 else min(horizon_s, HORIZON_S)


def _text(mover: Mover, other: Other, separation: float, radius_m: float, age_s: float) -> str:
    track = other.track
    ratio = pair_margin(mover.footprint, track.footprint).downwash_ratio
    moves = "in the air" if track.vehicle.abilities.flies else "under way"
    where = "parked" if track.parked else "lost in the air" if track.lost else moves
    if other.stays_yet:
        where += ", and not seen yet to fly where it was sent"
    old = f", whose position is {age_s:.1f} s old" if age_s > OLD_S else ""
    return (
        f"{mover.name} would come {separation:.1f} m near {track.name} ({where}){old}; they need {radius_m:.1f} m, "
        f"heights divided by {ratio:g}" + (FORGET.format(name=track.name) if track.lost else "")
    )
