"""The table of missions one after another."""

from __future__ import annotations

import itertools

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.mavlink.modes import Family
from skygcs.core.mavlink.vehicle_class import ReturnEnd, VehicleClass, abilities_of
from skygcs.core.mission.item import MissionItem
from skygcs.core.vehicle.flight_evidence import Landed
from skygcs.core.vehicle.mission_orders import (
    HomeWatch,
    Phase,
    Turn,
    ends_on_ground,
    is_at_home,
    last_moving,
    next_turn,
)
from skygcs.core.vehicle.vehicle import Vehicle
from support.table import each
from support.vehicles import HOME, Voice, flight_dialect

DOWN, CRASHED, UNKNOWN = Landed(True, ""), Landed(False, "it lies"), Landed(None, "no attitude has come")
ON_ITS_WAY = Turn("v1", True, True, True, False, False, False, True, landed=DOWN)
ENDING = ON_ITS_WAY._replace(ending=True, returns=True)
EARLY = "v1 is on the ground before the last item of its mission"


@each(
    ("flown", "next_", "why"),
    [
        (ON_ITS_WAY, "wait", ""),
        (ON_ITS_WAY._replace(complete=True), "wait", ""),  # its last item is a return, which it flies
        (ON_ITS_WAY._replace(complete=True, lands=False), "start", "v1 has flown its mission"),
        (ON_ITS_WAY._replace(flying=False), "wait", ""),  # armed on the ground: it is about to take off
        (ENDING._replace(flying=False, armed=False), "start", "v1 has landed"),
        (ENDING._replace(mode="AUTO.RTL"), "wait", ""),
        (ENDING._replace(mode="AUTO.RTL", flying=False, armed=False), "start", "v1 has landed"),
        (ENDING._replace(mode="AUTO.LOITER", flying=False), "wait", ""),  # a PX4 that has landed
        # a plane that circles at home, and a rover that stands there armed
        (ENDING._replace(mode="RTL", lands=False, at_home=True), "start", "v1 has returned"),
        (ENDING._replace(mode="RTL", lands=False, at_home=True, flying=False), "start", "v1 has returned"),
        (ENDING._replace(mode="RTL", lands=False), "wait", ""),
        (ENDING._replace(mode="RTL", at_home=True), "wait", ""),
        (ON_ITS_WAY._replace(lands=False, at_home=True), "wait", ""),
        # a PX4 reports a return as reached when it begins
        (ENDING._replace(mode="AUTO.RTL", complete=True, lands=False), "wait", ""),
        (ENDING._replace(mode="AUTO.RTL", complete=True, lands=False, at_home=True), "start", "v1 has returned"),
        # it may begin above its home, and stand there before it climbs
        (ENDING._replace(mode="AUTO.RTL", complete=True, lands=False, at_home=True, home_s=4.9), "wait", ""),
        # a crash that disarms, and whoever else flies it
        (ENDING._replace(flying=False, armed=False, landed=CRASHED), "end", "v1 has not landed: it lies"),
        (ENDING._replace(landed=CRASHED), "end", "v1 has not landed: it lies"),
        (ENDING._replace(flying=False, armed=False, landed=UNKNOWN), "wait", ""),  # what shows a crash may still come
        # high ground, or a forged heartbeat: flying counts no more once it is disarmed
        (ENDING._replace(flying=True, armed=False), "start", "v1 has landed"),
        (ENDING._replace(flying=True, armed=False, landed=UNKNOWN), "wait", ""),
        (ENDING._replace(mode="AUTO.LOITER", flying=True, armed=False), "start", "v1 has landed"),
        (ON_ITS_WAY._replace(flying=False, armed=False), "end", EARLY),
        (ON_ITS_WAY._replace(lands=False, ending=True, flying=False, armed=False), "end", EARLY),
        (ON_ITS_WAY._replace(mode="POSCTL"), "end", "v1 was taken over (POSCTL)"),
        (ON_ITS_WAY._replace(mode="AUTO.RTL", returns=True), "end", "v1 was taken over (AUTO.RTL)"),
        (ENDING._replace(mode="AUTO.LOITER"), "end", "v1 was taken over (AUTO.LOITER)"),
        (ENDING._replace(mode="RTL", returns=False), "end", "v1 was taken over (RTL)"),
        (ENDING._replace(mode="LAND", flying=False, armed=False), "end", "v1 was taken over (LAND)"),
        (ON_ITS_WAY._replace(heard=False), "end", "v1 is not heard"),
        (ON_ITS_WAY._replace(failsafe=True), "end", "v1 is in failsafe"),
        (ON_ITS_WAY._replace(ordered=True), "end", "v1 was ordered something else"),
    ],
)
def test_each_row_of_the_table(flown: Turn, next_: str, why: str) -> None:
    assert next_turn(flown) == (next_, why)


def test_nobody_starts_while_the_one_before_is_taken_over_in_trouble_or_in_the_air_with_its_way_before_it() -> None:
    modes = ("AUTO.MISSION", "AUTO", "AUTO.RTL", "AUTO.LOITER", "AUTO.LAND", "POSCTL", "LAND", "GUIDED", "")
    for mode, *flags in itertools.product(modes, *([False, True],) * 10):
        flown = Turn("v1", *flags[:7], mode, *flags[7:], landed=DOWN)  # type: ignore[arg-type]
        assert next_turn(flown._replace(landed=CRASHED)).next == "end"
        assert flown.armed or next_turn(flown._replace(landed=UNKNOWN)).next != "start"
        assert next_turn(flown._replace(landed=UNKNOWN, waited_s=1e9)).next != "wait"
        if next_turn(flown).next == "start":
            assert flown.heard and not flown.failsafe and not flown.ordered
            over = flown.complete or (flown.ending and flown.returns and flown.at_home)
            assert not flown.armed or (over and not flown.lands and (flown.at_home or not flown.returns))
            assert mode in modes[:4] and (over or (flown.lands and flown.ending))


@each(
    ("flown", "phase"),
    [
        (ON_ITS_WAY, Phase.NEXT_ITEM),
        (ON_ITS_WAY._replace(flying=False), Phase.ON_GROUND),
        (ENDING, Phase.LAST_ITEM),
        (ENDING._replace(armed=False, landed=UNKNOWN), Phase.EVIDENCE),
    ],
)
def test_no_wait_is_without_end_and_the_end_names_what_was_missing(flown: Turn, phase: Phase) -> None:
    why, longest_s = phase.value
    assert flown.phase == (phase, 0)
    assert next_turn(flown._replace(waited_s=longest_s)).next == "wait"
    ended = next_turn(flown._replace(waited_s=longest_s + 1.0))
    assert ended.next == "end" and why in ended.why
    assert ("no attitude has come" in ended.why) == (phase is Phase.EVIDENCE)


def test_a_further_item_begins_the_wait_anew() -> None:
    assert ON_ITS_WAY._replace(furthest=2).phase != ON_ITS_WAY._replace(furthest=3).phase


def test_a_mission_ends_on_the_ground_by_its_last_item_that_moves() -> None:
    waypoint, home, land, speed = MissionItem(16), MissionItem(20), MissionItem(21), MissionItem(178)
    assert ends_on_ground([waypoint, home]) and ends_on_ground([waypoint, land, speed])
    assert not ends_on_ground([waypoint]) and not ends_on_ground([]) and not ends_on_ground([home, waypoint])
    assert last_moving([waypoint, land, speed]) == 2 and last_moving([speed]) is None


@each(
    ("family", "kind", "lands"),
    [
        ("px4", "copter", True),
        ("ardupilot", "copter", True),
        ("px4", "plane", True),  # its parameters are not known: it may land
        ("ardupilot", "plane", True),
        ("px4", "vtol", True),
        ("ardupilot", "vtol", True),
        ("ardupilot", "rover", False),
        ("px4", "rover", False),  # it disarms at home only with RTL_LAND_DELAY and COM_DISARM_LAND
    ],
)
def test_a_return_ends_on_the_ground_or_may_by_the_class(family: Family, kind: str, lands: bool) -> None:
    end = abilities_of(family, VehicleClass(kind)).return_rule(lambda name: None).with_mission({16, 20})
    assert ends_on_ground([MissionItem(16), MissionItem(20)], end) is lands
    assert ends_on_ground([MissionItem(16), MissionItem(21)], end)


@each(
    ("end", "lands"),
    [
        (ReturnEnd.LANDS_ON_ROTORS, True),
        (ReturnEnd.LANDS_AS_PLANE, True),
        (ReturnEnd.BY_MISSION, True),
        (ReturnEnd.NOT_KNOWN, True),  # it is waited for
        (ReturnEnd.CIRCLES, False),
        (ReturnEnd.HOLDS, False),
        (ReturnEnd.LANDS, True),
    ],
)
def test_a_return_ends_on_the_ground_by_its_end(end: ReturnEnd, lands: bool) -> None:
    assert ends_on_ground([MissionItem(16), MissionItem(20)], end) is lands


@each(
    ("up_mps", "north_mps", "away_m", "at_home"),
    [(0.0, 0.1, 0.0, True), (-1.0, 0.0, 0.0, False), (0.0, 2.0, 0.0, False), (0.0, 0.0, 20.0, False)],
)
def test_one_that_holds_at_its_home_stands_there_and_does_not_sink(
    up_mps: float, north_mps: float, away_m: float, at_home: bool
) -> None:
    """PX4: it sinks to RTL_DESCEND_ALT there."""
    vehicle, voice = Vehicle(1, 1, flight_dialect()), Voice()
    lat_deg, lon_deg, _ = EnuFrame(Origin(*HOME)).to_geodetic(0.0, away_m, 0.0)
    ned_cmps = (round(100 * north_mps), 0, round(-100 * up_mps))
    home = mav.MAVLink_home_position_message(
        round(HOME[0] * 1e7), round(HOME[1] * 1e7), 488_100, 0, 0, 0, [1.0, 0, 0, 0], 0, 0, 0
    )
    for frame in (voice.say(mav.MAVLink_heartbeat_message(2, 12, 0x81, 0, 4, 3)), voice.say(home)):
        vehicle.on_frame(frame, 1.0)
    vehicle.on_frame(voice.position(lat_deg, lon_deg, HOME[2] + 30, 30.0, velocity=ned_cmps), 1.0)
    assert is_at_home(vehicle, flying=True) is at_home
    assert is_at_home(vehicle, flying=False) is (at_home or up_mps < 0.0), "the noise of a receiver on the ground"


def test_it_is_at_home_for_as_long_as_it_has_stayed_there_without_a_break() -> None:
    vehicle, voice, watch = Vehicle(1, 1, flight_dialect()), Voice(), HomeWatch()
    home = mav.MAVLink_home_position_message(
        round(HOME[0] * 1e7), round(HOME[1] * 1e7), 488_100, 0, 0, 0, [1.0, 0, 0, 0], 0, 0, 0
    )
    for frame in (voice.say(mav.MAVLink_heartbeat_message(2, 12, 0x81, 0, 4, 3)), voice.say(home)):
        vehicle.on_frame(frame, 1.0)
    stays = []
    for now, up_cmps in ((1.0, 0), (3.0, 0), (4.0, 100), (5.0, 0), (9.5, 0)):
        vehicle.on_frame(voice.position(*HOME[:2], HOME[2] + 30, 30.0, velocity=(0, 0, -up_cmps)), now)
        stays.append(watch.stays_s(vehicle, now, flying=True))
    assert stays == [0.0, 2.0, 0.0, 0.0, 4.5]


def test_a_rover_that_has_disarmed_at_its_home_has_come_to_the_end_of_its_mission() -> None:
    home = ENDING._replace(mode="AUTO.RTL", lands=False, flying=False, armed=False, at_home=True, home_s=0.0)
    assert next_turn(home) == ("start", "v1 has landed")
    assert next_turn(home._replace(at_home=False)).next == "end"
