"""The motion of each vehicle as far as it is known, for the monitor, and which vehicles it cannot watch.

    a vehicle that                                      counts as
    -------------------------------------------------   -----------------------------------------------------------
    is armed, unless it reports itself on the ground    flying: watched against all others
    is disarmed but shows signs of flight               flying; its height is no sign while it reports the ground
    is disarmed, or armed on the ground                 parked: an obstacle at rest for what flies, not for one another
    reports no position, or an impossible one           not watched; one that was seen before: as silent from then on
    flies and has been silent for `TRACK_SILENT_S`      lost: not watched any more, an obstacle for orders
    shares its system id on one link, is a recording    not watched: where it is is not known

A parked vehicle stays an obstacle where it was last heard until it is forgotten, and so does a lost one, with the space
that it may have reached in `TRACK_SILENT_S`: an order to go there waits for a person, who knows where it is or forgets
it. It makes no conflict: by then it may be anywhere, and all others would be held.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from skygcs.core.geo import EnuFrame, Origin, ecef, is_on_earth
from skygcs.core.monitor.approach import REST, Piece, Vector, arc, turn_radps
from skygcs.core.quantile import median_low
from skygcs.core.separation import Footprint
from skygcs.core.vehicle.flight_evidence import moves_disarmed
from skygcs.core.vehicle.order_plan import CLIMBED_M
from skygcs.core.vehicle.vehicle import Vehicle

TRACK_SILENT_S = 10.0
"""The monitor looks so far ahead; a vehicle whose position is older may be 150 m from where it was seen."""

HISTORY_S = 2.0
"""Velocities are kept for so long, to compare those of two vehicles at one time; two always, which show a turn."""

MAX_HISTORY = 32
"""Positions kept of one vehicle; read at most four times a second."""

TOWARDS = math.cos(math.radians(20.0))
"""A vehicle flies to where it was sent if its velocity leads there within 20 degrees ..."""

LEAST_SPEED_MPS = 0.5
"""... and is no drift."""

PLAN_STEP_S = 0.5
"""Between the points of a trajectory that are looked at: a curve of 3 m/s² bows by 0.1 m between them."""

OFF_PLAN_M = 2.0
"""A vehicle farther than this from its trajectory is not seen to follow it."""

USUAL_BRAKE_MPS2 = 2.0
"""PX4's MPC_ACC_HOR is 3 m/s² with limited jerk, ArduCopter's WPNAV_ACCEL 2.5 m/s²."""

REACTS_S = 0.5
"""A vehicle flies on for so long before it brakes as its `brake_mps2` is: the age of its position, the order's way to
it, and PX4's jerk (MPC_JERK_AUTO, 4 m/s³, takes 0.5 s to 2 m/s²)."""

SPEEDS_UP_MPS2 = 5.0
"""Speeding up counts to this: PX4's MPC_ACC_HOR_MAX is 5 m/s², ArduCopter's WPNAV_ACCEL 2.5; more is a wrong report."""

LEAST_CHANGE_S = 0.2
"""Between two velocities that show an acceleration: noise of 0.1 m/s is then 0.5 m/s²."""

HARDEST = 1.5
"""A vehicle brakes before its place by at most so many times `brake_mps2`: ArduCopter by 2.5, PX4 by 3 m/s²."""

ARC_S = 10.0
"""An arc is drawn as far as the monitor looks ahead."""

Place = tuple[float, float, float]
"""lat_deg, lon_deg, alt_amsl_m."""


class Sample(NamedTuple):
    """A position report."""

    at: float
    vel_enu_mps: Vector


@dataclass(slots=True)
class Track:
    """One watched vehicle. ``age_s`` and what follows are as of the last `TrackTable.refresh`."""

    vehicle: Vehicle
    footprint: Footprint
    priority: int
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    ecef_m: Vector = REST
    at: float = -math.inf
    """When its newest position came."""
    reported_mps: Vector = REST
    """True east, north, up."""
    soon_mps: Vector = REST
    """Its velocity when an order that is given now makes it turn (`soon_mps`)."""
    parked: bool = True
    lost: bool = False
    """It flew, and no position has come for `TRACK_SILENT_S`."""
    history: deque[Sample] = field(default_factory=lambda: deque(maxlen=MAX_HISTORY))
    circle_m: float = 0.0
    """How far from the middle of the circle it may be by which it holds; 0: it stops."""
    age_s: float = 0.0
    ball_m: float = 0.0
    """How far it may be from ``place_m``."""
    place_m: Vector = REST
    """East, north, up in the common frame: its position, carried on with its velocity for its age."""
    velocity_mps: Vector = REST
    """Zero while it is parked."""
    path: tuple[Piece, ...] = ()
    """How it will fly from there: straight on, or to where it was sent."""
    goal_m: Vector | None = None
    """Where skygcs has sent it, in the common frame."""
    has_goal: bool = False
    """The path ends where skygcs has sent it, or is its trajectory."""
    planned: bool = False
    """The path is its trajectory."""

    @property
    def key(self) -> int:
        return self.vehicle.key

    @property
    def name(self) -> str:
        return self.vehicle.name

    @property
    def brake_mps2(self) -> float:
        """Its deceleration when it is ordered to hold; of what is not counted on to stop the usual one."""
        return self.vehicle.abilities.brake_mps2 or USUAL_BRAKE_MPS2

    @property
    def turns_m(self) -> float:
        """How far it may come off a new way before it turns to that; 0 for what cannot stop: its circle counts."""
        return 0.0 if self.parked or self.circle_m else overshoot_m(self.soon_mps, self.brake_mps2)

    def turn_radps(self) -> float:
        """How fast it turns over the ground, positive to the left; 0 for what can stop, and goes where it is sent."""
        if not self.circle_m or len(self.history) < 2:
            return 0.0
        older, newer = self.history[0], self.history[-1]
        return turn_radps(older.vel_enu_mps, newer.vel_enu_mps, newer.at - older.at)

    def velocity_at(self, at: float) -> Vector:
        """Its velocity at an earlier time, between the two reports around it; the oldest one known if it is older."""
        newer: Sample | None = None
        for sample in reversed(self.history):
            if sample.at <= at:
                if newer is None or newer.at == sample.at:
                    return sample.vel_enu_mps
                share = (at - sample.at) / (newer.at - sample.at)
                a, b = sample.vel_enu_mps, newer.vel_enu_mps
                return (
                    a[0] + share * (b[0] - a[0]),
                    a[1] + share * (b[1] - a[1]),
                    a[2] + share * (b[2] - a[2]),
                )
            newer = sample
        return self.velocity_mps if newer is None else newer.vel_enu_mps


class Member(NamedTuple):
    """A vehicle of the fleet and what its fleet file says of it."""

    vehicle: Vehicle
    footprint: Footprint
    priority: int
    destination: Place | None = None
    """Where skygcs has sent it, if it is on its way there."""
    trajectory: Sequence[Place] = ()
    """Where it will be now and every `PLAN_STEP_S` from now on, if it follows a trajectory."""


class TrackTable:
    """The tracks of a fleet by sysid << 8 | compid, in one frame: true ENU about the middle of the fleet.

    The frame is chosen anew with each refresh, by medians, so that one wrong position does not tilt it for all others.
    """

    def __init__(self) -> None:
        self.tracks: dict[int, Track] = {}
        self.lost: dict[int, Track] = {}
        """Vehicles that were last heard in the air, where they were then."""
        self.unwatched: dict[int, tuple[str, str, bool]] = {}
        """By key: name, why it is not watched, and whether it flies."""
        self.frame: EnuFrame | None = None

    def refresh(self, members: Iterable[Member], now: float) -> Iterator[None]:
        """Read every vehicle and place it; yields after each, so that nobody waits for all of them. Complete only when
        it has ended."""
        tracks: dict[int, Track] = {}
        lost: dict[int, Track] = {}
        wanted: dict[int, Member] = {}
        unwatched: dict[int, tuple[str, str, bool]] = {}
        for member in members:
            vehicle = member.vehicle
            track = self.tracks.get(vehicle.key) or self.lost.get(vehicle.key)
            if track is None or track.vehicle is not vehicle:
                track = Track(vehicle, member.footprint, member.priority)
            track.footprint, track.priority = member.footprint, member.priority
            why = _read(track, now)
            if why is None:
                tracks[vehicle.key] = track
                wanted[vehicle.key] = member
            else:
                unwatched[vehicle.key] = (vehicle.name, why, is_flying(vehicle, now))
                if track.lost:
                    lost[vehicle.key] = track
            yield
        self.tracks, self.lost, self.unwatched = tracks, lost, unwatched
        self._place(now)
        if self.frame is not None:
            yield from self._lead(self.frame, wanted)

    def _place(self, now: float) -> None:
        """Carry every position on to ``now``, in a frame about the middle of all: in one turn, as orders are compared
        with them between two turns of a refresh."""
        tracks = self.tracks.values()
        if not tracks:
            self.frame = None
            return
        lat_deg, lon_deg = median_low(t.lat_deg for t in tracks), median_low(t.lon_deg for t in tracks)
        self.frame = frame = EnuFrame(Origin(lat_deg, lon_deg, 0.0))
        for track in tracks:
            carry_on(track, frame.from_ecef(track.ecef_m), now)

    def _lead(self, frame: EnuFrame, wanted: Mapping[int, Member]) -> Iterator[None]:
        """Find out how each will fly from its place."""
        for key, track in self.tracks.items():
            member = wanted[key]
            points = [frame.from_geodetic(*place) for place in member.trajectory]
            track.planned = follows(track, points)
            if track.planned:
                track.path, track.has_goal = planned_path(track, points), True
            else:
                track.goal_m = None if member.destination is None else frame.from_geodetic(*member.destination)
                track.path, track.has_goal = path_of(track, track.velocity_mps)
            yield


def carry_on(track: Track, reported_m: Vector, now: float) -> None:
    """Where it is now by its last report, and how far it may be from there."""
    if track.parked:
        track.age_s = track.ball_m = 0.0
        track.place_m, track.velocity_mps = reported_m, REST
        return
    age_s = max(0.0, now - track.at)
    u, v, w = track.reported_mps
    track.age_s, track.ball_m = age_s, track.footprint.ball_m(age_s)
    track.place_m = (reported_m[0] + u * age_s, reported_m[1] + v * age_s, reported_m[2] + w * age_s)
    track.velocity_mps = track.reported_mps


def path_of(track: Track, velocity: Vector) -> tuple[tuple[Piece, ...], bool]:
    """How it will fly if this is its velocity, and whether that is another way than straight on: to its goal, if it is
    seen to fly there, or on the circle of what cannot stop. That does not end at its goal, either."""
    goal_m = track.goal_m
    straight_on = (Piece(math.inf, velocity),)
    if track.circle_m:
        turn = track.turn_radps()
        return (arc(velocity, turn, ARC_S), True) if turn else (straight_on, False)
    way = None if goal_m is None else way_to(track, velocity, goal_m)
    return (straight_on, False) if way is None else ((way,), True)


def way_to(track: Track, velocity: Vector, goal_m: Vector) -> Piece | None:
    """Its way to a goal with this velocity, both in the common frame; None: the velocity does not lead it there."""
    here = track.place_m
    way = (goal_m[0] - here[0], goal_m[1] - here[1], goal_m[2] - here[2])
    if not leads(velocity, way):
        return None
    speed_mps, away_m = math.hypot(*velocity), math.hypot(*way)
    share = speed_mps / away_m
    return Piece(away_m / speed_mps, (way[0] * share, way[1] * share, way[2] * share))


def leads(velocity: Vector, way: Vector) -> bool:
    """True if a velocity is no drift and leads along a way."""
    speed_mps, away_m = math.hypot(*velocity), math.hypot(*way)
    along = way[0] * velocity[0] + way[1] * velocity[1] + way[2] * velocity[2]
    return speed_mps >= LEAST_SPEED_MPS and away_m > 0.0 and along >= TOWARDS * away_m * speed_mps


def arrives(velocity: Vector, way: Vector, brake_mps2: float) -> bool:
    """True if it is seen to fly along a way, and so slowly that it can stop at the end of that."""
    return leads(velocity, way) and math.hypot(*velocity) ** 2 <= 2.0 * HARDEST * brake_mps2 * math.hypot(*way)


def overshoot_m(velocity_mps: Vector, brake_mps2: float) -> float:
    """How far a vehicle flies on at most before it turns to another place; 0: it stands, or drifts."""
    speed_mps = math.hypot(*velocity_mps)
    return 0.0 if speed_mps < LEAST_SPEED_MPS else speed_mps * (REACTS_S + speed_mps / (2.0 * brake_mps2))


def soon_mps(samples: Sequence[Sample], newest: Sample) -> Vector:
    """The velocity of a vehicle `REACTS_S` after its newest report, if it goes on to speed up, or to turn, as its
    earlier ones show; what brakes is not counted on to go on with that."""
    velocity = newest.vel_enu_mps
    older = next((sample for sample in reversed(samples) if sample.at <= newest.at - LEAST_CHANGE_S), None)
    if older is None or newest.at - older.at > HISTORY_S:
        return velocity
    between_s = newest.at - older.at
    change = [(v - u) / between_s for u, v in zip(older.vel_enu_mps, velocity, strict=True)]
    along, square = sum(a * v for a, v in zip(change, velocity, strict=True)), sum(v * v for v in velocity)
    if along < 0.0:
        change = [a - v * along / square for a, v in zip(change, velocity, strict=True)]
    size_mps2 = math.hypot(*change)
    share = REACTS_S * (min(1.0, SPEEDS_UP_MPS2 / size_mps2) if size_mps2 > 0.0 else 0.0)
    east, north, up = (v + a * share for v, a in zip(velocity, change, strict=True))
    return east, north, up


def follows(track: Track, points: Sequence[Vector]) -> bool:
    """True if it is seen to be on its trajectory, of which these are the points from now on."""
    return len(points) > 1 and not track.parked and math.dist(track.place_m, points[0]) <= OFF_PLAN_M + track.ball_m


def planned_path(track: Track, points: Sequence[Vector]) -> tuple[Piece, ...]:
    """From where it is onto its trajectory, and along that."""
    pieces: list[Piece] = []
    here = track.place_m
    for there in points[1:]:
        velocity = tuple((q - p) / PLAN_STEP_S for p, q in zip(here, there, strict=True))
        pieces.append(Piece(PLAN_STEP_S, (velocity[0], velocity[1], velocity[2])))
        here = there
    return tuple(pieces)


def is_flying(vehicle: Vehicle, now: float) -> bool:
    """True if it is to be taken for flying: it is under way, or its height or its telemetry contradicts that it stands
    or is disarmed. One that is disarmed and reports itself on the ground may stand high above its home."""
    if not vehicle.armed:
        return vehicle.ids.beside or moves_disarmed(vehicle, now) is not None
    if vehicle.under_way(now):
        return True
    position = vehicle.telemetry("position")
    return position is not None and position["alt_rel_m"] >= CLIMBED_M


def _read(track: Track, now: float) -> str | None:
    """Take in its newest position. Returns why it cannot be watched, or None."""
    vehicle = track.vehicle
    track.lost = False
    if vehicle.replayed:
        return "it is heard in a recording only"
    if vehicle.ids.beside:
        return "two vehicles send with its system id on one link"
    position, at = vehicle.timed_telemetry("position")
    why = why_unplaced(position)
    if position is not None and at is not None and why is None and at != track.at:
        east, north, up = position["vel_enu_mps"]
        lat_deg, lon_deg, alt_m = position["lat_deg"], position["lon_deg"], position["alt_amsl_m"]
        track.at, track.reported_mps = at, (east, north, up)
        track.lat_deg, track.lon_deg, track.ecef_m = lat_deg, lon_deg, ecef(lat_deg, lon_deg, alt_m)
        newest = Sample(at, track.reported_mps)
        track.soon_mps = soon_mps(track.history, newest)
        track.history.append(newest)
        while len(track.history) > 2 and track.history[0].at < at - HISTORY_S:
            track.history.popleft()
    if track.at == -math.inf:
        return why or "it reports no position"
    track.parked = not is_flying(vehicle, now)
    track.circle_m = vehicle.hold_reach_m(now)
    track.lost = not track.parked and now - track.at > TRACK_SILENT_S
    return f"{why or f'no position for {TRACK_SILENT_S:g} s'}: it may be anywhere" if track.lost else None


def why_unplaced(position: Mapping[str, Any] | None) -> str | None:
    """Why a report is no position; None: it is one."""
    if position is None or position["lat_deg"] is None:
        return "it reports no position"
    on_earth = is_on_earth(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"])
    return None if on_earth else "the position that it reports is not on earth"
