"""SET_GPS_GLOBAL_ORIGIN as either firmware takes it."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from support.sim_pilot import FIELD, Pilot, copter, px4

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
