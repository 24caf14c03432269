"""The constants of core/sim are pymavlink's; the mode numbers are those pymavlink knows."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.modes import copter_mode_number, px4_custom_mode
from skygcs.sim import protocol
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.sim_pilot import FIELD, Pilot, copter, px4


def test_every_constant_has_the_value_pymavlink_gives_its_name() -> None:
    ours = {name: value for name, value in vars(protocol).items() if name.isupper()}
    assert len(ours) > 100
    assert ours == {name: getattr(mav, name) for name in ours}


def test_copter_mode_numbers_are_pymavlinks() -> None:
    theirs = {number: name for number, name in mavutil.mode_mapping_acm.items() if number in set(CopterMode)}
    renamed = {16: "POSHOLD", 19: "AVOID_ADSB"}
    assert {int(mode): mode.name for mode in CopterMode} == theirs | renamed


def test_px4_modes_are_those_mavutil_reads_from_a_heartbeat() -> None:
    names = {
        Px4Mode.MANUAL: "MANUAL",
        Px4Mode.ALTCTL: "ALTCTL",
        Px4Mode.POSCTL: "POSCTL",
        Px4Mode.TAKEOFF: "TAKEOFF",
        Px4Mode.LOITER: "LOITER",
        Px4Mode.MISSION: "MISSION",
        Px4Mode.RTL: "RTL",
        Px4Mode.LAND: "LAND",
        Px4Mode.FOLLOW_TARGET: "FOLLOWME",
        Px4Mode.OFFBOARD: "OFFBOARD",
        Px4Mode.ACRO: "ACRO",
        Px4Mode.STABILIZED: "STABILIZED",
    }
    for mode, name in names.items():
        main, sub = mode >> 16 & 0xFF, mode >> 24 & 0xFF
        assert mavutil.px4_map[name][1:] == (main, sub)


def test_the_ground_stations_mode_tables_agree_with_the_vehicles() -> None:
    assert px4_custom_mode("AUTO.TAKEOFF") == Px4Mode.TAKEOFF
    assert px4_custom_mode("AUTO.LOITER") == Px4Mode.LOITER
    assert px4_custom_mode("OFFBOARD") == Px4Mode.OFFBOARD
    assert copter_mode_number("GUIDED") == CopterMode.GUIDED
    assert copter_mode_number("SMART_RTL") == CopterMode.SMART_RTL


# -- SET_GPS_GLOBAL_ORIGIN as either firmware takes it.


LAT, LON, ALT = round((FIELD.lat_deg + 1e-3) * 1e7), round(FIELD.lon_deg * 1e7), round((FIELD.alt_amsl_m + 5) * 1000)
NORTH_M = 111.1


def origins(heard: list[Any]) -> list[tuple[int, int, int]]:
    return [(o.latitude, o.longitude, o.altitude) for o in heard if o.get_type() == "GPS_GLOBAL_ORIGIN"]


def tell(pilot: Pilot, system: int = 1) -> list[tuple[int, int, int]]:
    answers = pilot.send(mav.MAVLink_set_gps_global_origin_message(system, LAT, LON, ALT))
    return origins([*answers, *pilot.run(1.0)])


def test_px4_takes_it_at_any_time_and_answers_first_with_the_one_it_had() -> None:
    pilot = Pilot(px4())
    pilot.run(20.0)
    first, *_, last = tell(pilot)
    assert first[0] == round(FIELD.lat_deg * 1e7)
    assert last == (LAT, LON, ALT)


def test_px4_is_deaf_to_one_for_everybody() -> None:
    pilot = Pilot(px4())
    pilot.run(20.0)
    assert (LAT, LON, ALT) not in tell(pilot, system=0)


def test_a_local_frame_moves_with_its_origin_and_the_vehicle_does_not() -> None:
    vehicle = px4()
    pilot = Pilot(vehicle)
    pilot.run(20.0)
    place = (vehicle.motion.east_m, vehicle.motion.north_m, vehicle.motion.up_m)
    tell(pilot)
    local = [h for h in pilot.run(2.0) if h.get_type() == "LOCAL_POSITION_NED"][-1]
    assert local.x == pytest.approx(-NORTH_M, abs=1.0)
    assert local.z == pytest.approx(5.0, abs=1.0)
    assert (vehicle.motion.east_m, vehicle.motion.north_m, vehicle.motion.up_m) == place


def test_ardupilot_keeps_the_origin_it_has_without_a_word() -> None:
    pilot = Pilot(copter())
    pilot.run(60.0)
    assert (LAT, LON, ALT) not in tell(pilot)


def test_ardupilot_takes_one_while_it_has_none_until_the_next_start() -> None:
    vehicle = copter()
    pilot = Pilot(vehicle)
    pilot.run(1.0)
    assert vehicle.home is None
    assert tell(pilot)[-1] == (LAT, LON, ALT)
    vehicle.reboot(pilot.now)
    pilot.run(60.0)
    assert vehicle.local_zero is None
