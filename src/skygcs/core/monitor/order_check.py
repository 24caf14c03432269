"""Check whether an order or trajectories would bring a vehicle too close to another, before they begin.

The path of the order is a straight line, after which the vehicle stays.

    another vehicle                           is compared
    ---------------------------------------   ----------------------------------------------------------------------
    is parked, or stands in the air           where it is
    was sent somewhere, comes home or down    as space with its way (`space_conflict`): when either of the two is where
                                              is not known, as they climb, sink and fly with speeds of their own
    flies otherwise                           flying straight on for the horizon, while this one flies `GOTO_MPS`: a
                                              model, and the monitor goes on watching

Trajectories are checked against others, and each other, on all their way.

Each vehicle has a course: its place at every time from now on. The others' courses are where they stand, the
trajectories that they follow, the straight line to where skygcs has sent them, or straight on for the horizon.

Two courses are compared by conservative advancement: while they are far enough apart, time goes on by as long as they
need to meet at their largest speeds, so nothing is missed and little is looked at. Where they are near, it goes on by
`STEP_S`; between two such times both fly a chord, and what a curve can bow out of it is taken off their distance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from skygcs.core.geo import EnuFrame, Origin, ecef, world_from_enu
from skygcs.core.monitor.approach import (
    REST,
    Disc,
    Holder,
    Piece,
    Vector,
    circle_conflict,
    closest_approach,
    closest_on_paths,
)
from skygcs.core.monitor.conflict_levels import HORIZON_S, NOISE_MPS, scaled, scaled_pieces
from skygcs.core.monitor.tracks import TRACK_SILENT_S, Place, Track
from skygcs.core.monitor.ways import Way, conflict_text, distance_m, sloped, standing, too_near
from skygcs.core.separation import Footprint, pair_margin, separation_m
from skygcs.core.trajectory import TrajectoryClock
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory
from skygcs.core.vehicle.vehicle import Vehicle

# --- orders -----------------------------------------------------------------------------------------------------------

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
    """Where the others hold, or will, as far as `circle_conflict` compares them."""
    for other in others:
        if other.track.key != mover.key and (mover.circle_m or other.track.circle_m):
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


# --- trajectories -----------------------------------------------------------------------------------------------------


STEP_S = 0.25
"""A curve of 3 m/s² bows by 0.02 m out of its chord."""

LOOKS_A_TURN = 20
"""Places compared before other tasks of the loop may get their turn: 0.2 ms."""


MAX_LOOKS = 2_000_000
"""Comparisons of places in one check: some 20 s of CPU time, which 50 vehicles need that fly in formation for an
hour."""


@dataclass(frozen=True, slots=True)
class Course:
    """How one vehicle will fly."""

    key: int
    name: str
    footprint: Footprint
    at: Callable[[float], Vector]
    """Its place so many seconds from now, in a frame that is common to all."""
    speed_mps: float
    """At most."""
    bow_m: float = 0.0
    """How far it may be from the chord of two places `STEP_S` apart."""
    ball_m: float = 0.0
    """How far it may be from its place, because its last position is old."""
    known_s: float = math.inf
    """Time for which the course is known; nothing is known after it."""
    doing: str = "in the air"


def bow_m(loaded: LoadedTrajectory, speed_factor: float, brake_mps2: float) -> float:
    """How far a trajectory may be from its chord of `STEP_S`: a·h²/8, and h/4 for each jump of its velocity; never more
    than is flown in half of that time. ``brake_mps2``: what a ramp of its clock adds."""
    peaks = loaded.peaks
    speed_mps = peaks.speed_mps.at_most * speed_factor
    acceleration_mps2 = peaks.acceleration_mps2.at_most * speed_factor * speed_factor + brake_mps2
    jump_mps = max(loaded.velocity_jump_mps, loaded.first_speed_mps, loaded.last_speed_mps) * speed_factor
    shortest_s = min(piece.duration_s for piece in loaded.trajectory.pieces) / speed_factor
    bent_m = STEP_S * STEP_S * acceleration_mps2 / 8.0 + (2.0 + STEP_S / shortest_s) * STEP_S * jump_mps / 4.0
    return min(bent_m, STEP_S * speed_mps / 2.0)


def on_trajectory(
    vehicle: Vehicle,
    footprint: Footprint,
    loaded: LoadedTrajectory,
    clock: TrajectoryClock,
    at: Callable[[float], Vector],
) -> Course:
    """The course of a vehicle that follows a trajectory, or is about to."""
    fastest = max(clock.speed_factor, clock.latest_rate)
    return Course(
        vehicle.key,
        vehicle.name,
        footprint,
        at,
        loaded.peaks.speed_mps.at_most * fastest,
        bow_m(loaded, fastest, clock.rate_limit_per_s * loaded.peaks.speed_mps.at_most),
        doing="on its trajectory",
    )


def of_track(track: Track, destination: Place | None, frame: EnuFrame, now: float) -> Course:
    """The course of a vehicle that is watched: it stands, flies to where skygcs has sent it and stays, or flies
    straight on for the horizon. ``frame``: the common one."""
    reported = frame.from_ecef(track.ecef_m)
    if track.parked:
        return Course(track.key, track.name, track.footprint, lambda _: reported, 0.0, doing="parked")
    # what flies or was lost: moved on by the age of its report
    age_s = min(max(0.0, now - track.at), TRACK_SILENT_S)
    ball_m = track.footprint.ball_m(max(0.0, age_s - FRESH_S))
    velocity = world_from_enu(track.reported_mps, frame.origin)
    speed_mps = math.hypot(*velocity)
    here = _moved(reported, velocity, age_s)
    if track.lost:
        doing = "lost in the air" + FORGET.format(name=track.name)
        return Course(track.key, track.name, track.footprint, lambda _: here, 0.0, ball_m=ball_m, doing=doing)
    if destination is not None:
        end = frame.from_geodetic(*destination)
        away_m, flown_mps = math.dist(here, end), max(speed_mps, GOTO_MPS)
        along = _divided((end[0] - here[0], end[1] - here[1], end[2] - here[2]), max(away_m, NEARER_M) / flown_mps)

        def at(after_s: float) -> Vector:
            return end if flown_mps * after_s >= away_m else _moved(here, along, after_s)

        return Course(track.key, track.name, track.footprint, at, flown_mps, ball_m=ball_m, doing="sent there")
    # no destination: it hovers, or flies straight on
    if speed_mps <= 2 * NOISE_MPS:
        return Course(track.key, track.name, track.footprint, lambda _: here, 0.0, ball_m=ball_m)
    return Course(
        track.key,
        track.name,
        track.footprint,
        lambda after_s: _moved(here, velocity, after_s),
        speed_mps,
        ball_m=ball_m,
        known_s=HORIZON_S,
    )


def _moved(place: Vector, velocity: Vector, for_s: float) -> Vector:
    return place[0] + velocity[0] * for_s, place[1] + velocity[1] * for_s, place[2] + velocity[2] * for_s


def _divided(vector: Vector, by: float) -> Vector:
    return vector[0] / by, vector[1] / by, vector[2] / by


def find_conflicts(
    movers: Sequence[Course], others: Sequence[Course], end_s: float, found: dict[int, str]
) -> Iterator[None]:
    """Put into ``found``, by key of the mover, with which vehicle and when its course conflicts until ``end_s``, after
    which all stand still. Yields where other tasks of the loop may get their turn."""
    looks = itertools.count(1)
    for i, mover in enumerate(movers):
        worst_m = math.inf
        for other in (*others, *movers[:i], *movers[i + 1 :]):
            near = yield from _nearest(mover, other, end_s, looks)
            if near is not None and near[0] < worst_m:
                worst_m, at_s, need_m = near
                ratio = pair_margin(mover.footprint, other.footprint).downwash_ratio
                found[mover.key] = (
                    f"{mover.name} would come {worst_m:.1f} m near {other.name} ({other.doing}) in {at_s:.1f} s; "
                    f"they need {need_m:.1f} m, heights divided by {ratio:g}"
                )
    if next(looks) > MAX_LOOKS:
        for mover in movers:
            found.setdefault(mover.key, "so many long trajectories, so near each other, are too much to be checked")


def _nearest(
    a: Course, b: Course, end_s: float, count: Iterator[int]
) -> Generator[None, None, tuple[float, float, float] | None]:
    """Returns (distance, when, what they need) where two come nearest, if that is too near; or None."""
    # what they need, and how fast they can come nearer
    margin = pair_margin(a.footprint, b.footprint)
    need_m, ratio = margin.total_m + a.ball_m + b.ball_m, margin.downwash_ratio
    bow = a.bow_m + b.bow_m
    closing_mps = a.speed_mps + b.speed_mps
    end_s = min(end_s, a.known_s, b.known_s)
    here = _offset(a, b, 0.0, ratio)
    begun_m = separation_m(*here, 1.0)
    least_m, least_s, t = begun_m, 0.0, 0.0
    # where they are far apart one stride, near each other closed steps of STEP_S
    while t < end_s:
        looks = next(count)
        if looks % LOOKS_A_TURN == 0:
            yield
        if looks > MAX_LOOKS:
            return None
        spare_m = separation_m(*here, 1.0) - min(need_m, least_m) - bow
        if spare_m > closing_mps * STEP_S:
            t += spare_m / closing_mps if closing_mps > 0.0 else end_s
            here = _offset(a, b, min(t, end_s), ratio)
            continue
        step_s = min(STEP_S, end_s - t)
        there = _offset(a, b, t + step_s, ratio)
        velocity = tuple((q - p) / step_s for p, q in zip(here, there, strict=True))
        near = closest_approach(here, (velocity[0], velocity[1], velocity[2]), need_m, step_s)
        if near.separation_m - bow < least_m:
            least_m, least_s = max(0.0, near.separation_m - bow), t + near.at_s
        here, t = there, t + step_s
    if least_m >= need_m or (begun_m < need_m and least_m > begun_m - NEARER_M):
        return None
    return least_m, least_s, need_m


def _offset(a: Course, b: Course, at_s: float, ratio: float) -> Vector:
    """Offset of the second from the first, in the metric of the margin."""
    p, q = a.at(at_s), b.at(at_s)
    return q[0] - p[0], q[1] - p[1], (q[2] - p[2]) / ratio
