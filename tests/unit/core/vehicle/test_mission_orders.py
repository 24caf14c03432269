"""The mission of a vehicle that flies its way of a plan by itself, and what it does without a ground station, judged
by the parameters that decide it (failsafe.cpp, events.cpp)."""

from __future__ import annotations

import math
import struct

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import GLOBAL
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.mission_orders import (
    ALONE,
    HOLD_S,
    RESUMED,
    WITHIN_M,
    MissionSetting,
    ask_mission_settings,
    mission_along,
    mission_settings,
)
from skygcs.core.vehicle.vehicle import Vehicle
from support.table import each
from support.vehicles import ARDUPILOT, PX4, PX4_LOITER, Voice, flight_dialect

NOW, GUIDED, INT32 = 100.0, 4, 6
FLIGHTS = [
    # autopilot, action and exceptions as they were read, does it go on, value to be set
    (PX4, 0, None, True, None),
    (PX4, 0, 0, True, None),
    (PX4, 2, 3, True, None),
    (PX4, 2, 7, True, None),
    (PX4, 2, 1, False, ("COM_DLL_EXCEPT", 3.0)),
    (PX4, 2, 6, False, ("COM_DLL_EXCEPT", 7.0)),
    (PX4, 1, 0, False, ("COM_DLL_EXCEPT", 3.0)),
    (PX4, None, 0, None, None),
    (PX4, 2, None, None, None),
    (ARDUPILOT, 0, None, True, None),
    (ARDUPILOT, 1, 18, True, None),
    (ARDUPILOT, 5, 2, True, None),
    (ARDUPILOT, 1, 16, False, ("FS_OPTIONS", 18.0)),
    (ARDUPILOT, 2, 1, False, ("FS_OPTIONS", 3.0)),
    (ARDUPILOT, None, None, None, None),
]
NAMES = {PX4: ("NAV_DLL_ACT", "COM_DLL_EXCEPT"), ARDUPILOT: ("FS_GCS_ENABLE", "FS_OPTIONS")}


def vehicle_with(autopilot: int, values: tuple[int | None, int | None], restart: int | None = None) -> Vehicle:
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=Decoder(flight_dialect())), Voice(1)
    vehicle.on_frame(voice.beat(autopilot, PX4_LOITER if autopilot == PX4 else GUIDED), NOW)
    for name, value in zip((*NAMES[autopilot], "MIS_RESTART"), (*values, restart), strict=True):
        if value is not None:
            wire = float(value) if autopilot == ARDUPILOT else struct.unpack("<f", struct.pack("<i", value))[0]
            vehicle.on_frame(voice.say(mav.MAVLink_param_value_message(name.encode(), wire, INT32, 1, 0)), NOW)
    return vehicle


def alone(vehicle: Vehicle) -> MissionSetting:
    return next(found for found in mission_settings(vehicle) if found.check == ALONE)


@each(("restart", "fits"), [(None, None), (0, True), (1, False)])
def test_a_mission_that_begins_anew_after_a_stop_is_found(restart: int | None, fits: bool | None) -> None:
    vehicle = vehicle_with(ARDUPILOT, (0, None), restart)
    (found,) = [found for found in mission_settings(vehicle) if found.check == RESUMED]
    assert found.fits is fits and (found.param, found.value) == (("MIS_RESTART", 0.0) if fits is False else ("", 0.0))
    px4 = vehicle_with(PX4, (0, None))
    assert [found.check for found in mission_settings(px4)] == [ALONE]


@each(("autopilot", "action", "exceptions", "goes_on", "remedy"), FLIGHTS)
def test_a_mission_goes_on_where_the_firmware_lets_it(
    autopilot: int, action: int | None, exceptions: int | None, goes_on: bool | None, remedy: tuple[str, float] | None
) -> None:
    vehicle = vehicle_with(autopilot, (action, exceptions))
    found = alone(vehicle)
    assert found.fits is goes_on
    assert (found.param, found.value) == (remedy or ("", 0.0))
    if remedy is not None:
        cured = tuple(int(remedy[1]) if name == remedy[0] else action for name in NAMES[autopilot])
        assert alone(vehicle_with(autopilot, (cured[0], cured[1]))).fits is True
    unknown = [name for name, v in zip(NAMES[autopilot], (action, exceptions), strict=True) if v is None]
    asked = [step.message[1]["param_id"] for step in ask_mission_settings(vehicle, NOW).steps if step.message]
    assert asked == unknown + (["MIS_RESTART"] if autopilot == ARDUPILOT else [])


def test_of_another_firmware_nothing_is_known() -> None:
    vehicle = Vehicle(1, 1, flight_dialect(), decoder=Decoder(flight_dialect()))
    vehicle.on_frame(Voice(1).beat(mav.MAV_AUTOPILOT_GENERIC, 0), NOW)
    assert alone(vehicle).fits is None and not ask_mission_settings(vehicle, NOW).steps


PLACES = [(43.78, -79.46, 190.0), (43.7801, -79.46, 190.0), (43.7801, -79.4601, 195.5)]


def test_it_rests_at_every_corner_but_the_one_where_it_stands() -> None:
    items = mission_along(PLACES).mission
    assert [item.position for item in items] == [(43.7801, -79.46), (43.7801, -79.4601)]
    for item, (_, _, alt_amsl_m) in zip(items, PLACES[1:], strict=True):
        assert (item.command, item.frame, item.z) == (mav_cmd.NAV_WAYPOINT, GLOBAL, alt_amsl_m)
        assert item.params[:2] == (HOLD_S, WITHIN_M) and item.autocontinue
        assert math.isnan(item.values()["param4"]), "the firmware turns the nose as it is set up to"


def test_one_that_stays_holds_its_place_by_a_mission_of_one_item() -> None:
    (item,) = mission_along(PLACES[:1]).mission
    assert item.position == PLACES[0][:2] and item.z == PLACES[0][2]
