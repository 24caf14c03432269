"""The constants of core/sim are pymavlink's; the mode numbers are those pymavlink knows."""

from __future__ import annotations

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.modes import copter_mode_number, px4_custom_mode
from skygcs.sim import protocol
from skygcs.sim.firmware_modes import CopterMode, Px4Mode


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
