"""Which origins are refused, which vehicle can give one, and what a vehicle's own origin says."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.geo import Origin
from skygcs.core.vehicle import origin as origins
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from support.table import each
from support.vehicles import ARDUPILOT, HOME, PX4, Voice, flight_dialect

DECODER = Decoder(flight_dialect())
HERE = Origin(*HOME)


def heard(
    autopilot: int = PX4, *, armed: bool = False, fix: int | None = 3, heading: int = 12345, place: Any = HOME
) -> tuple[Vehicle, Voice]:
    vehicle, voice = Vehicle(1, 1, flight_dialect(), name="alpha", decoder=DECODER), Voice(1)
    frames = [voice.beat(autopilot, armed=armed), voice.position(*place, heading=heading)]
    if fix is not None:
        frames.append(voice.say(mav.MAVLink_gps_raw_int_message(0, fix, 1, 1, 0, 0, 0, 0, 0, 9)))
    for frame in frames:
        vehicle.on_frame(frame, 100.0)
    return vehicle, voice


def its_origin(vehicle: Vehicle, voice: Voice, lat: float = HOME[0], alt: float = HOME[2], now: float = 101.0) -> None:
    message = mav.MAVLink_gps_global_origin_message(round(lat * 1e7), round(HOME[1] * 1e7), round(alt * 1000))
    vehicle.on_frame(voice.say(message), now)


@each(
    ("origin", "why"),
    [
        (Origin(0.0, 0.0, 100.0), "zero coordinate"),
        (Origin(47.0, 0.0, 100.0), "zero coordinate"),
        (Origin(91.0, 8.0, 100.0), "not a position on earth"),
        (Origin(math.nan, 8.0, 100.0), "not a position on earth"),
        (Origin(47.0, 8.0, math.nan), "altitude of nan"),
        (Origin(47.0, 8.0, math.inf), "altitude of inf"),
        (Origin(47.0, 8.0, 480_000.0), "between -500 and 9000"),
        (Origin(47.0, 8.0, 480.0, math.nan), "heading of nan"),
    ],
)
def test_what_can_be_no_origin_is_refused(origin: Origin, why: str) -> None:
    with pytest.raises(RefusedError, match=why):
        origins.checked(origin)


def test_a_heading_comes_into_the_circle() -> None:
    assert origins.checked(Origin(47.0, 8.0, 480.0, -30.0)).x_heading_deg == 330.0
    assert origins.checked(HERE) == HERE


def test_an_origin_is_near_every_vehicle_that_is_here() -> None:
    far = Origin(HOME[0] + 0.2, HOME[1], HOME[2])
    vehicle, _ = heard()
    with pytest.raises(RefusedError, match=r"22 km from alpha.*20 km.*force"):
        origins.require_near(far, [vehicle])
    origins.require_near(Origin(HOME[0] + 0.17, HOME[1], HOME[2]), [vehicle])
    vehicle.tick(200.0)
    assert not vehicle.connected
    origins.require_near(far, [vehicle, Vehicle(2, 1, flight_dialect(), decoder=DECODER)])
    recorded, _ = heard()
    recorded.replayed = True
    origins.require_near(far, [recorded])


def test_a_vehicle_gives_its_place_and_if_wanted_its_heading() -> None:
    vehicle, _ = heard()
    origin = origins.from_vehicle(vehicle, 101.0, heading=False)
    assert (origin.lat_deg, origin.lon_deg, origin.alt_amsl_m) == pytest.approx(HOME, abs=1e-7)
    assert origin.x_heading_deg == 90.0
    assert origins.from_vehicle(vehicle, 101.0, heading=True).x_heading_deg == 123.45


@each(
    ("changes", "now", "force", "why"),
    [
        ({}, 103.5, True, r"3\.5 s old; 3 s is the limit"),
        ({"place": (0.0, 0.0, 0.0)}, 101.0, True, "not reported its position"),
        ({"fix": 2}, 101.0, False, r"no 3D fix \(2d\).*force"),
        ({"fix": None}, 101.0, False, "not known.*force"),
        ({"heading": 65535}, 101.0, True, "does not report its heading"),
    ],
)
def test_a_vehicle_that_does_not_know_well_where_it_is_gives_none(
    changes: dict[str, Any], now: float, force: bool, why: str
) -> None:
    vehicle, _ = heard(**changes)
    with pytest.raises(RefusedError, match=why):
        origins.from_vehicle(vehicle, now, heading=True, force=force)


def test_a_place_without_a_fix_takes_force_and_a_lost_vehicle_gives_none() -> None:
    vehicle, _ = heard(fix=0)
    assert origins.from_vehicle(vehicle, 101.0, heading=False, force=True).lat_deg == pytest.approx(HOME[0], abs=1e-7)
    vehicle.tick(200.0)
    with pytest.raises(RefusedError, match="lost"):
        origins.from_vehicle(vehicle, 200.0, heading=False, force=True)


def test_telling_is_one_message_and_the_question_what_it_has() -> None:
    vehicle, voice = heard()
    its_origin(vehicle, voice)
    plan = origins.announce(vehicle, 101.0, flight_dialect(), HERE)
    message, question = plan.steps
    assert message.message == (
        "SET_GPS_GLOBAL_ORIGIN",
        {"latitude": round(HOME[0] * 1e7), "longitude": round(HOME[1] * 1e7), "altitude": 488_100},
    )
    assert question.command is not None
    assert (question.command.command, question.command.params[0]) == (512, 49.0)
    expect = question.expect
    assert expect is not None
    assert not expect.met(vehicle, 101.0), "what it told before says nothing"
    assert expect.unmet(vehicle, 101.0) == "no GPS_GLOBAL_ORIGIN came"
    its_origin(vehicle, voice, alt=HOME[2] + 3)
    assert not expect.met(vehicle, 101.0), "PX4's first answer may be the old one"
    assert "3.0 m away" in expect.unmet(vehicle, 101.0)
    its_origin(vehicle, voice)
    assert expect.met(vehicle, 101.0)


def test_ardupilots_first_answer_is_its_last_word() -> None:
    vehicle, voice = heard(ARDUPILOT)
    expect = origins.announce(vehicle, 101.0, flight_dialect(), HERE).steps[1].expect
    its_origin(vehicle, voice, lat=HOME[0] + 1e-3)
    assert expect is not None and expect.met(vehicle, 101.0)
    assert "ArduPilot has an origin already" in origins.kept(vehicle, HERE)


def test_an_armed_vehicle_is_told_only_with_force() -> None:
    vehicle, _ = heard(armed=True)
    with pytest.raises(RefusedError, match=r"armed.*force"):
        origins.announce(vehicle, 101.0, flight_dialect(), HERE)
    assert origins.announce(vehicle, 101.0, flight_dialect(), HERE, force=True).steps
