from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.discovery import discovers, is_vehicle
from support.vehicles import Voice


def heartbeat(sysid: int, compid: int, kind: int, autopilot: int) -> Frame:
    return Voice(sysid, compid).say(mav.MAVLink_heartbeat_message(kind, autopilot, 1, 0, 3, 3))


@pytest.mark.parametrize(
    ("sysid", "compid", "kind", "autopilot"),
    [
        (1, 1, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4),
        (1, 1, mav.MAV_TYPE_HEXAROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (7, 3, mav.MAV_TYPE_FIXED_WING, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (1, 1, mav.MAV_TYPE_SUBMARINE, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (1, 1, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_PX4),
        (1, 1, mav.MAV_TYPE_GROUND_ROVER, mav.MAV_AUTOPILOT_GENERIC),
        (1, 1, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PPZ),
    ],
)
def test_an_autopilot_is_a_vehicle(sysid: int, compid: int, kind: int, autopilot: int) -> None:
    assert discovers(heartbeat(sysid, compid, kind, autopilot))


@pytest.mark.parametrize(
    ("sysid", "compid", "kind", "autopilot"),
    [
        (255, 190, mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID),
        (255, 190, mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (2, 2, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_INVALID),
        (1, 0, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_INVALID),
        (1, 0, mav.MAV_TYPE_ADSB, mav.MAV_AUTOPILOT_INVALID),
        (1, 100, mav.MAV_TYPE_CAMERA, mav.MAV_AUTOPILOT_INVALID),
        (1, 154, mav.MAV_TYPE_GIMBAL, mav.MAV_AUTOPILOT_GENERIC),
        (1, 194, mav.MAV_TYPE_ONBOARD_CONTROLLER, mav.MAV_AUTOPILOT_GENERIC),
        (1, 1, mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_GENERIC),
        (0, 1, mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_PX4),
    ],
)
def test_what_is_no_autopilot_is_no_vehicle(sysid: int, compid: int, kind: int, autopilot: int) -> None:
    assert not discovers(heartbeat(sysid, compid, kind, autopilot))


def test_no_message_but_a_verified_heartbeat_makes_a_vehicle() -> None:
    voice = Voice()
    assert not discovers(voice.text("hello"))
    assert not discovers(voice.say(mav.MAVLink_radio_status_message(1, 1, 100, 1, 1, 0, 0)))
    beat = voice.beat()
    assert not discovers(Frame(beat.raw, 0, 1, 1, 0, None))


def test_every_type_and_autopilot_is_decided() -> None:
    yes = [(t, a) for t in range(256) for a in range(256) if is_vehicle(t, a)]
    assert not [pair for pair in yes if pair[1] == mav.MAV_AUTOPILOT_INVALID or pair[0] == mav.MAV_TYPE_GCS]
