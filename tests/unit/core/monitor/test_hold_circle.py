"""What cannot stop, for the monitor: its arcs, the space of its circle, and who is counted on to stop."""

from __future__ import annotations

import math
import random

import pytest

from skygcs.core.monitor.approach import Disc, Holder, arc, circle_conflict, gap_m, turn_radps
from skygcs.core.monitor.conflict_levels import why_not_yield
from skygcs.core.monitor.monitor import Monitor
from skygcs.core.monitor.order_check import Mover, Other, climb_out_end, goto_conflict, takeoff_conflict
from skygcs.core.monitor.tracks import Track
from skygcs.core.separation import Footprint
from support.table import each
from support.watched_fleet import WatchedVehicle

PLANE, COPTER, ROVER = 1, 2, 10
AUTO_PLANE, LOITER_PLANE, AUTO_ROVER, GUIDED_ROVER = 10, 12, 10, 15
SPEED_MPS, RADIUS_M = 12.0, 60.0
TURN_RADPS = SPEED_MPS / RADIUS_M
NOW = 1000.0


def on_circle(at_s: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Position and velocity, to the left about the origin."""
    angle = TURN_RADPS * at_s
    place = (RADIUS_M * math.cos(angle), RADIUS_M * math.sin(angle), 50.0)
    return place, (-SPEED_MPS * math.sin(angle), SPEED_MPS * math.cos(angle), 0.0)


@each("way", [1.0, -1.0])
def test_an_arc_stays_on_the_circle_that_is_flown(way: float) -> None:
    """The oracle is the circle itself: after 10 s, 114 degrees on, the chords are 0.5 m beside it at most."""
    place, velocity = on_circle(0.0)
    velocity = (velocity[0], way * velocity[1], velocity[2])
    x, y, at_s = place[0], place[1], 0.0
    for piece in arc(velocity, way * TURN_RADPS, 10.0):
        x, y, at_s = x + piece.velocity_mps[0], y + piece.velocity_mps[1], at_s + piece.duration_s
        (u, v, _), _ = on_circle(way * at_s)
        assert math.hypot(x - u, y - v) < 0.5
    assert at_s == 10.0


def test_a_turn_is_measured_by_two_velocities_and_noise_is_none() -> None:
    assert turn_radps(on_circle(0.0)[1], on_circle(2.0)[1], 2.0) == pytest.approx(TURN_RADPS)
    assert turn_radps(on_circle(2.0)[1], on_circle(0.0)[1], 2.0) == pytest.approx(-TURN_RADPS)
    for older, newer, between_s in (
        ((12.0, 0.0, 0.0), (12.0, 0.1, 0.0), 2.0),  # straight on
        ((0.2, 0.0, 0.0), (0.0, 0.2, 0.0), 1.0),  # it stands
        ((12.0, 0.0, 0.0), (0.0, 12.0, 0.0), 0.0),  # at one time
        ((12.0, 0.0, 0.0), (-12.0, 0.1, 0.0), 0.1),  # no wing turns so
        ((math.nan, 0.0, 0.0), (12.0, 0.0, 0.0), 1.0),
    ):
        assert turn_radps(older, newer, between_s) == 0.0


def test_the_gap_of_two_discs_is_that_of_their_nearest_points() -> None:
    """The oracle samples both discs."""
    chance = random.Random(31)
    for _ in range(30):
        a, b = (
            Disc((chance.uniform(-90, 90), chance.uniform(-90, 90), chance.uniform(0, 40)), chance.uniform(0, 50))
            for _ in range(2)
        )

        def points(disc: Disc) -> list[tuple[float, float]]:
            x, y, _ = disc.middle_m
            angles = [i * math.tau / 180 for i in range(180)]
            shares = [i / 10 for i in range(11)]
            return [
                (x + s * disc.radius_m * math.cos(w), y + s * disc.radius_m * math.sin(w))
                for w in angles
                for s in shares
            ]

        theirs = points(b)
        nearest = min(math.hypot(u - x, v - y) for x, y in points(a)[::7] for u, v in theirs[::7])
        wanted = math.hypot(nearest, (b.middle_m[2] - a.middle_m[2]) / 2.0)
        assert gap_m(a, b, 2.0) <= wanted + 1e-9
        assert gap_m(a, b, 2.0) == pytest.approx(wanted, abs=12.0)  # as coarse as the samples


def test_only_pairs_of_which_one_circles_are_compared_here() -> None:
    near = Holder("beta", Footprint(), Disc((1.0, 0.0, 10.0), 0.0))
    assert circle_conflict("alpha", Footprint(), Disc((0.0, 0.0, 10.0), 0.0), [near]) is None
    found = circle_conflict("alpha", Footprint(), Disc((40.0, 0.0, 10.0), 60.0), [near])
    assert found is not None and "alpha would circle there with 60 m, 0.0 m from beta" in found
    assert circle_conflict("alpha", Footprint(), Disc((40.0, 0.0, 20.0), 60.0), [near]) is None  # 10 m above it


def look(monitor: Monitor, now: float, *vehicles: WatchedVehicle) -> None:
    for _ in monitor.evaluate([v.member for v in vehicles], now):
        pass


def watched(*vehicles: WatchedVehicle, now: float) -> Monitor:
    monitor = Monitor(acting=True)
    look(monitor, now, *vehicles)
    return monitor


def fly_circle(monitor: Monitor, plane: WatchedVehicle, kind: int, period_s: float, *others: WatchedVehicle) -> None:
    """Reports of four seconds up to `NOW`, each seen by the monitor."""
    for i in range(round(4.0 / period_s) + 1):
        at = -4.0 + period_s * i
        plane.heartbeat(NOW + at, kind=kind, mode=LOITER_PLANE)
        plane.position(NOW + at, *on_circle(at))
        look(monitor, NOW + at, plane, *others)


@each(
    ("bearing_rad", "meets", "period_s"),
    [(TURN_RADPS * 6.0, True, 0.25), (TURN_RADPS * 6.0, True, 2.0), (TURN_RADPS * -6.0, False, 0.25)],
)
def test_a_circling_plane_is_expected_on_its_circle(bearing_rad: float, meets: bool, period_s: float) -> None:
    """A copter hovers on the circle six seconds ahead of it, or behind it: straight on meets neither."""
    monitor, plane, copter = Monitor(acting=True), WatchedVehicle(1), WatchedVehicle(2)
    copter.heartbeat(NOW - 4.0)
    copter.position(NOW - 4.0, (RADIUS_M * math.cos(bearing_rad), RADIUS_M * math.sin(bearing_rad), 50.0))
    fly_circle(monitor, plane, PLANE, period_s)
    copter.heartbeat(NOW)
    copter.position(NOW, (RADIUS_M * math.cos(bearing_rad), RADIUS_M * math.sin(bearing_rad), 50.0))
    look(monitor, NOW, plane, copter)
    assert bool(monitor.pairs) is meets
    assert monitor.tracks.tracks[plane.vehicle.key].circle_m == pytest.approx(1.25 * 60.0)


def test_a_copter_with_the_same_reports_is_expected_straight_on() -> None:
    """It can stop: what it turned by says nothing of where it will be."""
    monitor, turning, other = Monitor(acting=True), WatchedVehicle(1), WatchedVehicle(2)
    fly_circle(monitor, turning, COPTER, 0.25)
    other.heartbeat(NOW)
    other.position(NOW, (RADIUS_M, 60.0, 50.0))  # straight ahead of it
    look(monitor, NOW, turning, other)
    assert monitor.pairs


def seen(vehicle: WatchedVehicle, *others: WatchedVehicle, now: float = 1000.0) -> Track:
    return watched(vehicle, *others, now=now).tracks.tracks[vehicle.vehicle.key]


def test_only_what_can_be_counted_on_to_stop_is_ordered_to_hold() -> None:
    def why(kind: int, mode: int) -> str | None:
        vehicle = WatchedVehicle(1)
        vehicle.heartbeat(1000.0, kind=kind, mode=mode)
        vehicle.position(1000.0, (0.0, 0.0, 20.0), (5.0, 0.0, 0.0))
        return why_not_yield(seen(vehicle), 1000.0)

    assert why(COPTER, 4) is None
    assert why(ROVER, GUIDED_ROVER) is None
    assert why(PLANE, AUTO_PLANE) == "a plane cannot be counted on to stop"
    assert why(20, AUTO_PLANE) == "a vtol cannot be counted on to stop"
    assert why(11, AUTO_ROVER) == "a boat cannot be counted on to stop"


def test_a_rover_is_under_way_while_it_is_armed_and_parked_when_it_is_not() -> None:
    rover = WatchedVehicle(1)
    rover.heartbeat(1000.0, kind=ROVER, mode=GUIDED_ROVER)
    rover.position(1000.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    assert not seen(rover).parked
    rover.heartbeat(1001.0, kind=ROVER, mode=GUIDED_ROVER, armed=False)
    rover.position(1001.0, (0.0, 0.0, 0.0))
    assert seen(rover, now=1001.0).parked


# -- orders


def mover(vehicle: WatchedVehicle, circle_m: float) -> Mover:
    return Mover(vehicle.vehicle.key, vehicle.vehicle.name, Footprint(), vehicle.geodetic_of(0.0, 0.0, 20.0), circle_m)


def hovering(sysid: int, *place_m: float) -> WatchedVehicle:
    vehicle = WatchedVehicle(sysid)
    vehicle.heartbeat(1000.0)
    vehicle.position(1000.0, place_m)
    return vehicle


def test_a_plane_is_not_sent_where_its_circle_would_come_too_near() -> None:
    plane, copter = WatchedVehicle(1, "kite"), hovering(2, 300.0, 50.0, 20.0)
    other = [Other(seen(copter))]
    to = plane.geodetic_of(300.0, 0.0, 20.0)
    assert goto_conflict(mover(plane, 0.0), to, other, 1000.0) is None  # a copter would stop there
    found = goto_conflict(mover(plane, 75.0), to, other, 1000.0)
    assert found is not None and "kite would circle there with 75 m" in found
    assert goto_conflict(mover(plane, 75.0), plane.geodetic_of(300.0, 0.0, 40.0), other, 1000.0) is None


def test_nobody_is_sent_into_the_circle_of_a_plane() -> None:
    plane, copter = WatchedVehicle(1, "kite"), hovering(2, 0.0, 0.0, 20.0)
    fly_circle(monitor := Monitor(acting=True), plane, PLANE, 0.25)
    track = monitor.tracks.tracks[plane.vehicle.key]
    here = Mover(copter.vehicle.key, "alpha", Footprint(), copter.geodetic_of(-300.0, 0.0, 50.0))
    middle = plane.geodetic_of(0.0, 0.0, 50.0)
    sent = Other(track, plane.geodetic_of(0.0, 0.0, 50.0))
    found = goto_conflict(here, middle, [sent], 1000.0)
    assert found is not None and "kite" in found
    low = plane.geodetic_of(0.0, 0.0, 30.0)
    assert goto_conflict(here, low, [sent], 1000.0) is None  # 20 m below it
    unknown = goto_conflict(here, plane.geodetic_of(-70.0, 0.0, 50.0), [Other(track)], 1000.0)
    assert unknown is not None and "kite, which circles within 150 m" in unknown
    assert goto_conflict(here, plane.geodetic_of(-200.0, 0.0, 50.0), [Other(track)], 1000.0) is None


def test_nobody_takes_off_into_the_circle_of_a_plane() -> None:
    plane, copter = WatchedVehicle(1, "kite"), hovering(2, 0.0, 0.0, 20.0)
    fly_circle(monitor := Monitor(acting=True), plane, PLANE, 0.25)
    track = monitor.tracks.tracks[plane.vehicle.key]
    # 130 m from where it is: within two radii, where it may come by a circle about a place that is not known
    here = Mover(copter.vehicle.key, "alpha", Footprint(), copter.geodetic_of(-70.0, 0.0, 0.0))
    unknown = takeoff_conflict(here, 50.0, [Other(track)], 1000.0)
    assert unknown is not None and "kite, which circles within 150 m" in unknown
    assert takeoff_conflict(here, 20.0, [Other(track)], 1000.0) is None
    sent = Other(track, plane.geodetic_of(200.0, 0.0, 50.0))
    assert takeoff_conflict(here, 50.0, [sent], 1000.0) is None  # it circles elsewhere


@each("heading_rad", [0.0, 0.7, 2.0, 4.0])
def test_a_plane_takes_off_ahead_and_not_straight_up(heading_rad: float) -> None:
    mine = mover(WatchedVehicle(1, "kite"), 0.0)
    east, north = math.sin(heading_rad), math.cos(heading_rad)
    for along_m, up_m, meets in ((60.0, 32.0, True), (0.0, 60.0, False), (-300.0, 60.0, False)):
        other = hovering(2, along_m * east, along_m * north, up_m)
        found = goto_conflict(mine, climb_out_end(mine, 50.0, heading_rad), [Other(seen(other))], 1000.0)
        assert (found is not None) is meets, (along_m, found)
