"""Check whether an order or trajectories would bring a vehicle too close to another, before they begin.

The path of the order is a straight line, after which the vehicle stays.

    another vehicle                           is compared
    ---------------------------------------   ----------------------------------------------------------------------
    is parked, or stands in the air           where it is
    was sent somewhere, comes home or down    as space with its way (`space_conflict`): when either of the two is where
                                              is not known, as they climb, sink and fly with speeds of their own
    flies otherwise                           flying straight on for the horizon, while this one flies `GOTO_MPS`: a
                                              model, and the monitor goes on watching

One that moves does not turn to a new place at once: the space in which it turns (`turning`) is part of its way, whether
the order is for it or it is another one.

Trajectories are checked against others, and each other, on all their way.

Each of them has a course: its place at every time from now on. The others' courses are where they stand, the
trajectories that they follow, or straight on for the horizon. One that was sent somewhere, comes home or down has no
course but a way, anywhere on which it may be all the time.

Two courses, or a course and a way, are compared by conservative advancement: while they are far enough apart, time goes
on by as long as they need to meet at their largest speeds, so nothing is missed and little is looked at. Where they are
near, it goes on by `STEP_S`; between two such times both fly a chord, and what a curve can bow out of it is taken off
their distance.
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
from skygcs.core.monitor.tracks import PLAN_STEP_S, TRACK_SILENT_S, USUAL_BRAKE_MPS2, Place, Track, overshoot_m
from skygcs.core.monitor.ways import (
    LEGS_A_PART,
    Way,
    along,
    are_apart,
    beginning,
    conflict_text,
    distance_m,
    nearest_m,
    needed_m,
    shown_m,
    sloped,
    standing,
    too_near,
    turning,
    turning_lines,
)
from skygcs.core.separation import Footprint, pair_margin, separation_m
from skygcs.core.trajectory import TrajectoryClock
from skygcs.core.vehicle.frames import Setpoint
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, TrajectoryFlight
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

NEARER_BY_SETPOINT_M = 0.001
"""The same for one setpoint of a stream, beside what is in the air: each is checked from where the last one has led, so
with 0.2 m for each a stream at 10 Hz led from 2.3 to 1.7 m (random flight 2010)."""

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
    velocity_mps: Vector = REST
    """True ENU."""
    brake_mps2: float = USUAL_BRAKE_MPS2
    """Its deceleration before it turns to another place."""
    stops_in_m: float = math.inf
    """How far ahead it comes to rest in any case, because it was sent there."""

    @property
    def turns_m(self) -> float:
        """How far it may come off its new way before it turns to that; 0 for what cannot stop: its circle counts."""
        return 0.0 if self.circle_m else min(self.stops_in_m, overshoot_m(self.velocity_mps, self.brake_mps2))


class Other(NamedTuple):
    """A vehicle that may be in the way, and where skygcs has sent it; None: nowhere that is known. With a destination
    only the circle counts here by which it holds there: its way is one of `space_conflict`."""

    track: Track
    destination: Place | None = None
    stays_yet: bool = False
    """It was sent elsewhere, and is not seen flying there."""
    stops_in_s: float = math.inf
    """When it comes to rest since its last position, as it is seen flying where it was sent."""


class _Path(NamedTuple):
    """The way of an order in the frame of the vehicle that it is for, from (0, 0, 0) on."""

    pieces: tuple[Piece, ...]
    duration_s: float
    ahead_s: float
    """How long after it others are looked at that fly straight on."""
    strict: bool
    """True if vehicles count that stand within the margin already."""
    nearer_m: float = NEARER_M
    """By how much it may come nearer to what is in the air, and within the margin already."""

    @property
    def length_m(self) -> float:
        return sum(piece.duration_s * math.hypot(*piece.velocity_mps) for piece in self.pieces)

    @property
    def corners(self) -> tuple[Vector, Vector]:
        """The box that it does not leave."""
        return _corners([REST, *itertools.accumulate(self.pieces, _after, initial=REST)])


def goto_conflict(mover: Mover, to: Place, others: Iterable[Other], now: float) -> str | None:
    """With which vehicle the straight way to a place conflicts, in words; None: with none."""
    frame, others = mover_frame(mover), list(others)
    end = frame.from_geodetic(*to)
    way = _conflict(mover, frame, [_straight(end, GOTO_MPS, HORIZON_S)], others, now)
    if way is None and mover.turns_m:
        turns = [_through(line, HORIZON_S) for line in turning_lines(REST, mover.velocity_mps, mover.turns_m, end)]
        way = _before_it_turns(_conflict(mover, frame, turns, others, now))
    return way or circle_conflict(
        mover.name, mover.footprint, Disc(end, mover.circle_m), _holders(mover, frame, others)
    )


def takeoff_conflict(mover: Mover, height_m: float, others: Iterable[Other], now: float) -> str | None:
    """`goto_conflict` for a take-off: the way up, and the place where it holds then. Vehicles that stand too near
    already count: it may be carried sideways as it rises."""
    frame, others, end = mover_frame(mover), list(others), (0.0, 0.0, height_m)
    path = _straight(end, CLIMB_MPS, HORIZON_S)._replace(strict=True)
    way = _conflict(mover, frame, [path], others, now)
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
    """`goto_conflict` for one setpoint of a stream: a place to be at now, or without one a velocity (true ENU)."""
    frame = mover_frame(mover)
    if to is None:
        path = _Path((Piece(AHEAD_S, velocity_mps),), AHEAD_S, 0.0, False)
    else:
        path = _straight(frame.from_geodetic(*to), GOTO_MPS, 0.0)
    return _conflict(mover, frame, [path._replace(nearer_m=NEARER_BY_SETPOINT_M)], others, now)


def meant(mover: Mover, setpoint: Setpoint) -> tuple[Place | None, tuple[float, float, float]]:
    """The place that a setpoint leads to, and its velocity. An axis without a place is where the velocity leads it."""
    place, velocity = setpoint.place, setpoint.vel_enu_mps or (0.0, 0.0, 0.0)
    if place is None or setpoint.free_xy:
        return None, velocity
    height_m = mover.here[2] if setpoint.free_z else place.alt_amsl_m
    return (place.lat_deg, place.lon_deg, height_m), velocity


def space_conflict(
    mover: Mover, to: Place, ways: Iterable[Way], *, strict: bool = False, frame: EnuFrame | None = None
) -> str | None:
    """With which of these ways (in ``frame``, `mover_frame` by default) the straight way to a place conflicts, in
    words, whichever of the two is where; None: with none. ``strict``: although it is not nearer there than it is."""
    frame = frame or mover_frame(mover)
    begin, end, velocity = frame.from_geodetic(*mover.here), frame.from_geodetic(*to), mover.velocity_mps
    straight = Way(mover.key, mover.name, mover.footprint, sloped((begin, end)))
    here, mine = replace(straight, legs=standing(begin)), straight
    if mover.turns_m:
        mine = replace(straight, legs=straight.legs + turning(begin, velocity, mover.turns_m, end))
    worst: tuple[float, Way] | None = None
    for way in ways:
        near_m = nearest_m(mine, way, needed_m(mine, way) if worst is None else min(worst[0], needed_m(mine, way)))
        if near_m == math.inf:
            continue
        if (
            not strict
            and _comes_no_nearer(here, mine, way)
            and _comes_no_nearer(here, mine, beginning(way), or_clear=True)
        ):
            continue
        worst = near_m, way
        if near_m == 0.0:
            break
    if worst is None:
        return None
    text = conflict_text(mine, worst[1], worst[0])
    return text if too_near(straight, worst[1]) else _before_it_turns(text)


def _comes_no_nearer(here: Way, mine: Way, other: Way, *, or_clear: bool = False) -> bool:
    """True if it is too near already, and its way does not come nearer; ``or_clear``: or that way keeps clear. False
    if that is not known."""
    if or_clear and not too_near(mine, other):
        return True
    return other.is_known and too_near(here, other) and distance_m(mine, other) > distance_m(here, other) - NEARER_M


def _before_it_turns(conflict: str | None) -> str | None:
    return None if conflict is None else f"{conflict}, before it has turned there"


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


def _after(place: Vector, piece: Piece) -> Vector:
    return _moved(place, piece.velocity_mps, piece.duration_s)


def _straight(to: Vector, speed_mps: float, ahead_s: float) -> _Path:
    duration_s = math.hypot(*to) / speed_mps
    if duration_s == 0.0:
        return _Path((), 0.0, ahead_s, False)
    velocity = (to[0] / duration_s, to[1] / duration_s, to[2] / duration_s)
    return _Path((Piece(duration_s, velocity),), duration_s, ahead_s, False)


def _through(points: Sequence[Vector], ahead_s: float) -> _Path:
    """Straight through these points, with `GOTO_MPS`."""
    legs = [_straight((q[0] - p[0], q[1] - p[1], q[2] - p[2]), GOTO_MPS, 0.0) for p, q in itertools.pairwise(points)]
    return _Path(tuple(p for leg in legs for p in leg.pieces), sum(leg.duration_s for leg in legs), ahead_s, False)


def _conflict(mover: Mover, frame: EnuFrame, paths: Sequence[_Path], others: Iterable[Other], now: float) -> str | None:
    """With which vehicle one of these paths conflicts, each of which it may fly; none is left out that is near one."""
    length_m, corners = max(path.length_m for path in paths), _corners([p for path in paths for p in path.corners])
    longest = max(paths, key=lambda path: path.duration_s)
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
        flies_s = longest.duration_s + longest.ahead_s + age_s
        theirs_m = 0.0 if track.parked else math.hypot(*track.reported_mps) * flies_s
        away_m = math.dist(here_m, track.ecef_m)
        if away_m > length_m + theirs_m + radius_m * ratio:
            continue
        offset, pieces, horizon_s = _their_path(frame, other, age_s, longest)
        ends = offset, _moved(offset, pieces[0].velocity_mps, horizon_s) if pieces else offset
        if are_apart(ends, corners, (radius_m, radius_m, radius_m * ratio)):
            continue
        now_m = separation_m(*offset, ratio)
        for path in paths:
            _, pieces, horizon_s = _their_path(frame, other, age_s, path)
            mine, theirs = scaled_pieces(path.pieces, ratio), scaled_pieces(pieces, ratio)
            near = closest_on_paths(scaled(offset, ratio), mine, theirs, radius_m, horizon_s)
            if math.isinf(near.enters_s):
                continue
            nearer_m = NEARER_M if track.parked else path.nearer_m
            if not path.strict and now_m < radius_m and near.separation_m > now_m - nearer_m:
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
    flies_s = max(0.0, other.stops_in_s - age_s)
    return here, (Piece(flies_s, (u, v, w)),), horizon_s if path.ahead_s == 0.0 else min(horizon_s, HORIZON_S)


def _text(mover: Mover, other: Other, separation: float, radius_m: float, age_s: float) -> str:
    track = other.track
    ratio = pair_margin(mover.footprint, track.footprint).downwash_ratio
    moves = "in the air" if track.vehicle.abilities.flies else "under way"
    where = "parked" if track.parked else "lost in the air" if track.lost else moves
    if other.stays_yet:
        where += ", and not seen yet to fly where it was sent"
    old = f", whose position is {age_s:.1f} s old" if age_s > OLD_S else ""
    near, needed = shown_m(separation, radius_m)
    return (
        f"{mover.name} would come {near} m near {track.name} ({where}){old}; they need {needed} m, "
        f"heights divided by {ratio:g}" + (FORGET.format(name=track.name) if track.lost else "")
    )


# --- trajectories -----------------------------------------------------------------------------------------------------


STEP_S = 0.25
"""A curve of 3 m/s² bows by 0.02 m out of its chord."""

MOST_POINTS = 1200
"""Points of the way of a trajectory: ten minutes of it bow by 0.1 m between two, as `PLAN_STEP_S` does."""

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


def left_s(clock: TrajectoryClock, now: float) -> float:
    """Until it has come to its end; 0 if it does not run."""
    finishes_at_s = clock.finishes_at_s(now)
    return 0.0 if finishes_at_s is None else max(0.0, finishes_at_s - now)


def places_on(loaded: LoadedTrajectory, clock: TrajectoryClock, now: float) -> Callable[[float], Vector]:
    """Places of a vehicle on a trajectory, so many seconds from now, in the world's frame."""
    return lambda after_s: loaded.trajectory.at(clock.foreseen_s(now + after_s)).pos_enu_m


def places_in(frame: EnuFrame, local: EnuFrame, flight: TrajectoryFlight, now: float) -> Callable[[float], Vector]:
    """The places of a vehicle that flies its trajectory already, which stands on earth."""
    return lambda after_s: frame.from_geodetic(*local.to_geodetic(*flight.foreseen(now + after_s)))


def of_track(track: Track, frame: EnuFrame, now: float) -> Course:
    """The course of a vehicle that is watched: it stands, or flies straight on for the horizon. ``frame``: the common
    one."""
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


class TrajectorySpace:
    """The way of one vehicle on its trajectory, from end to end: made once, and then looked at from where it is on."""

    def __init__(self, flight: TrajectoryFlight, frame: EnuFrame) -> None:
        """``frame``: the vehicle's local one."""
        self.flight, self.frame = flight, frame
        steps = max(1, min(MOST_POINTS, math.ceil(flight.duration_s / PLAN_STEP_S)))
        self._step_s = flight.duration_s / steps
        self._points = [ecef(*frame.to_geodetic(*flight.place(n * self._step_s))) for n in range(steps + 1)]
        self._corners = [_corners(self._points[n : n + LEGS_A_PART + 1]) for n in range(0, steps, LEGS_A_PART)]
        peaks, long = flight.loaded.peaks, self._step_s > PLAN_STEP_S
        bent_m = peaks.acceleration_mps2.at_most * self._step_s * self._step_s / 8.0
        self.bow_m = min(bent_m, peaks.speed_mps.at_most * self._step_s / 2.0) if long else 0.0
        """How far it may be from the chords of a long one."""

    def left(self, now: float) -> list[Vector]:
        """The rest of it, earth-centred; empty: it stands, or has ended."""
        return [] if (first := self._first(now)) is None else self._points[first:]

    def left_near(self, ends: tuple[Vector, Vector], need_m: float, now: float) -> list[list[Vector]]:
        """The parts of `left` that may come so near a straight line, all earth-centred."""
        if (first := self._first(now)) is None:
            return []
        need, parts = (need_m, need_m, need_m), list[list[Vector]]()
        for n in range(first // LEGS_A_PART, len(self._corners)):
            if not are_apart(ends, self._corners[n], need):
                begin = n * LEGS_A_PART
                parts.append(self._points[max(first, begin) : begin + LEGS_A_PART + 1])
        return parts

    def _first(self, now: float) -> int | None:
        finishes_at_s = self.flight.clock.finishes_at_s(now)
        if finishes_at_s is None or finishes_at_s <= now:
            return None
        return min(int(self.flight.clock.at(now).trajectory_s / self._step_s), len(self._points) - 2)


def _corners(points: Sequence[Vector]) -> tuple[Vector, Vector]:
    (a, b, c), (d, e, f) = ([pick(p[axis] for p in points) for axis in range(3)] for pick in (min, max))
    return (a, b, c), (d, e, f)


def _moved(place: Vector, velocity: Vector, for_s: float) -> Vector:
    return place[0] + velocity[0] * for_s, place[1] + velocity[1] * for_s, place[2] + velocity[2] * for_s


def find_conflicts(
    movers: Sequence[Course], others: Sequence[Course | Way], end_s: float, found: dict[int, str]
) -> Iterator[None]:
    """Put into ``found``, by key of the mover, with which vehicle and when its course conflicts until ``end_s``, after
    which all stand still; one with a way may be anywhere on it all the time. Yields where other tasks of the loop may
    get their turn."""
    looks = itertools.count(1)
    for i, mover in enumerate(movers):
        worst_m = math.inf
        for other in (*others, *movers[:i], *movers[i + 1 :]):
            near = yield from _nearest(mover, other, end_s, looks)
            if near is not None and near[0] < worst_m:
                worst_m, at_s, need_m = near
                ratio = pair_margin(mover.footprint, other.footprint).downwash_ratio
                shown, needed = shown_m(worst_m, need_m)
                found[mover.key] = (
                    f"{mover.name} would come {shown} m near {other.name} ({other.doing}) in {at_s:.1f} s; "
                    f"they need {needed} m, heights divided by {ratio:g}"
                )
    if next(looks) > MAX_LOOKS:
        for mover in movers:
            found.setdefault(mover.key, "so many long trajectories, so near each other, are too much to be checked")


def _nearest(
    a: Course, b: Course | Way, end_s: float, count: Iterator[int]
) -> Generator[None, None, tuple[float, float, float] | None]:
    """Returns (distance, when, what they need) where two come nearest, if that is too near; or None."""
    pair = _BesideWay(a, b) if isinstance(b, Way) else _TwoCourses(a, b)
    if isinstance(b, Way) and not b.is_known:
        return 0.0, 0.0, pair.need_m
    need_m, bow, closing_mps, end_s = pair.need_m, pair.bow_m, pair.closing_mps, min(end_s, pair.known_s)
    here = pair.place(0.0)
    begun_m = pair.distance_m(here)
    least_m, least_s, t = begun_m, 0.0, 0.0
    # where they are far apart one stride, near each other closed steps of STEP_S
    while t < end_s:
        looks = next(count)
        if looks % pair.looks_a_turn == 0:
            yield
        if looks > MAX_LOOKS:
            return None
        spare_m = pair.distance_m(here) - min(need_m, least_m) - bow
        if spare_m > closing_mps * STEP_S:
            t += spare_m / closing_mps if closing_mps > 0.0 else end_s
            here = pair.place(min(t, end_s))
            continue
        step_s = min(STEP_S, end_s - t)
        there = pair.place(t + step_s)
        near_m, at_s = pair.nearest(here, there, step_s)
        if near_m - bow < least_m:
            least_m, least_s = max(0.0, near_m - bow), t + at_s
        here, t = there, t + step_s
    if least_m >= need_m:
        return None
    if begun_m >= need_m or least_m <= begun_m - NEARER_M:
        return least_m, least_s, need_m
    # it may leave the way of another, but not to where that one is
    return (yield from _nearest(a, beginning(b), end_s, count)) if isinstance(b, Way) and b != beginning(b) else None


class _TwoCourses:
    """How two courses come near each other; a place is the offset of the second, in the metric of the margin."""

    looks_a_turn = LOOKS_A_TURN

    def __init__(self, a: Course, b: Course) -> None:
        margin = pair_margin(a.footprint, b.footprint)
        self.need_m = margin.total_m + a.ball_m + b.ball_m
        self.bow_m = a.bow_m + b.bow_m
        self.closing_mps = a.speed_mps + b.speed_mps
        self.known_s = min(a.known_s, b.known_s)
        self._a, self._b, self._ratio = a.at, b.at, margin.downwash_ratio

    def place(self, at_s: float) -> Vector:
        p, q = self._a(at_s), self._b(at_s)
        return q[0] - p[0], q[1] - p[1], (q[2] - p[2]) / self._ratio

    def distance_m(self, here: Vector) -> float:
        return math.hypot(*here)

    def nearest(self, here: Vector, there: Vector, step_s: float) -> tuple[float, float]:
        """The least distance between two places of one chord, and when."""
        u, v, w = ((q - p) / step_s for p, q in zip(here, there, strict=True))
        near = closest_approach(here, (u, v, w), self.need_m, step_s)
        return near.separation_m, near.at_s


class _BesideWay:
    """How a course comes near a way; a place is one on the course."""

    looks_a_turn = 1
    """A way has many legs."""

    def __init__(self, a: Course, b: Way) -> None:
        self._mine, self._way = Way(a.key, a.name, a.footprint, (), a.ball_m), b
        self.need_m, self.bow_m = needed_m(self._mine, b), a.bow_m
        self.closing_mps, self.known_s, self.place = a.speed_mps, a.known_s, a.at

    def distance_m(self, here: Vector) -> float:
        return distance_m(replace(self._mine, legs=standing(here)), self._way)

    def nearest(self, here: Vector, there: Vector, step_s: float) -> tuple[float, float]:
        """The least distance on one chord, and when: the begin of the step."""
        return distance_m(replace(self._mine, legs=along((here, there))), self._way), 0.0
