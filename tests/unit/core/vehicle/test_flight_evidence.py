from __future__ import annotations

from collections.abc import Callable

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.fence_params import require_testable
from skygcs.core.vehicle.flight_evidence import (
    FRESH_S,
    contradiction,
    disarmed_since,
    why_maybe_flying,
    why_maybe_in_air,
    why_not_idle,
)
from skygcs.core.vehicle.orders import reboot, set_home
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from support.table import each
from support.vehicles import ARDUPILOT, PX4, Voice, flight_dialect

DECODER = Decoder(flight_dialect())
NOW = 100.0


def disarmed(armed_ago_s: float | None = None) -> tuple[Vehicle, Voice]:
    """A copter whose heartbeat says that it is disarmed."""
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    if armed_ago_s is not None:
        vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True, status=4), NOW - armed_ago_s)
    vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=False), NOW)
    return vehicle, voice


def throttle(voice: Voice, percent: int) -> Frame:
    return voice.say(mav.MAVLink_vfr_hud_message(0, 0, 0, percent, 0, 0))


EVIDENCE: dict[str, tuple[Callable[[Voice], Frame], str]] = {
    "in air": (lambda v: v.landed(2), "it reports itself in the air"),
    "takeoff": (lambda v: v.landed(3), "it reports itself in takeoff"),
    "landing": (lambda v: v.landed(4), "it reports itself in landing"),
    "high": (lambda v: v.position(rel_m=12.0), "it is 12 m above its home"),
    "climbs": (lambda v: v.position(velocity=(0, 0, -150)), "it climbs at 1.5 m/s"),
    "sinks": (lambda v: v.position(velocity=(0, 0, 150)), "it sinks at 1.5 m/s"),
    "moves": (lambda v: v.position(velocity=(300, 400, 0)), "it moves at 5.0 m/s"),
    "throttle": (lambda v: throttle(v, 38), "its throttle is at 38 %"),
}


@each(("landed", "why"), [(None, "it is armed, and may be in the air"), (1, None), (2, "it is in the air")])
def test_one_that_is_armed_is_on_the_ground_only_where_it_says_so(landed: int | None, why: str | None) -> None:
    """A fence test set a fence of 30 m on one in flight that had not said where it is."""
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    vehicle.on_frame(voice.beat(PX4, 4, armed=True, status=4), NOW)
    if landed is not None:
        vehicle.on_frame(voice.landed(landed), NOW)
    assert why_maybe_in_air(vehicle, NOW) == why
    if why is None:
        require_testable(vehicle, NOW, 30.0)
        return
    with pytest.raises(RefusedError, match=why):
        require_testable(vehicle, NOW, 30.0)
    with pytest.raises(RefusedError, match=why):
        set_home(vehicle, NOW)


@each("what", EVIDENCE)
def test_what_contradicts_a_disarmed_heartbeat_keeps_dangerous_orders_out(what: str) -> None:
    vehicle, voice = disarmed()
    assert why_not_idle(vehicle, NOW) is None
    frame, said = EVIDENCE[what]
    vehicle.on_frame(frame(voice), NOW)
    assert contradiction(vehicle, NOW) == said
    assert said in str(why_not_idle(vehicle, NOW)) and said in str(why_maybe_flying(vehicle, NOW))
    for order in (reboot, set_home):
        with pytest.raises(RefusedError, match=said):
            order(vehicle, NOW)
        order(vehicle, NOW, force=True)
    assert contradiction(vehicle, NOW + FRESH_S) == said
    vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=False), NOW + 4.0)
    assert why_not_idle(vehicle, NOW + 4.0) is None, "what is older says nothing about now"


def test_a_vehicle_on_the_ground_that_stands_is_idle() -> None:
    vehicle, voice = disarmed()
    for frame in (
        voice.landed(1),
        voice.position(rel_m=1.5, velocity=(40, 40, 20)),
        voice.position(rel_m=5.0, velocity=(300, 0, 100)),
        voice.landed(0),
        throttle(voice, 9),
    ):
        vehicle.on_frame(frame, NOW)
        assert why_not_idle(vehicle, NOW) is None


def test_motors_that_turn_are_evidence_of_what_lifts_by_them_only() -> None:
    for kind, percent, said in ((2, 10, "its throttle is at 10 %"), (2, 9, None), (1, 38, None)):
        vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
        vehicle.on_frame(voice.beat(ARDUPILOT, 4, kind=kind), NOW)
        vehicle.on_frame(throttle(voice, percent), NOW)
        assert contradiction(vehicle, NOW) == said, (kind, percent)


def test_one_that_was_armed_just_now_is_idle_once_it_is_seen_on_the_ground() -> None:
    vehicle, voice = disarmed(armed_ago_s=1.0)
    assert "it was armed 1.0 s ago" in str(why_not_idle(vehicle, NOW))
    assert why_maybe_flying(vehicle, NOW) is None
    vehicle.on_frame(voice.landed(1), NOW)
    assert why_not_idle(vehicle, NOW) is None
    for ago_s, said in ((0.0, "0.0 s ago"), (0.5, "0.5 s ago"), (3.0, "3.0 s ago"), (3.5, None)):
        vehicle, _ = disarmed(armed_ago_s=ago_s)
        why = why_not_idle(vehicle, NOW)
        assert why is None if said is None else said in str(why), ago_s


def test_one_that_is_being_armed_is_not_idle_until_heartbeats_have_followed() -> None:
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=False), NOW - 1.0)
    vehicle.on_frame(voice.landed(1), NOW)
    vehicle.arming_at, vehicle.arming_until = NOW, NOW + 3.0
    assert why_not_idle(vehicle, NOW + 3.0) == "it is being armed"
    assert why_not_idle(vehicle, NOW + 3.1) is None, "it was not armed by that"
    for armed, at in ((True, NOW + 0.5), (False, NOW + 1.0)):
        vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=armed), at)
    vehicle.on_frame(voice.landed(1), NOW + 1.1)
    assert why_not_idle(vehicle, NOW + 1.2) is None, "it was armed, and is seen disarmed on the ground again"


def test_what_was_armed_since_an_arming_was_ordered_is_not_armed_again_once_it_is_disarmed() -> None:
    for ordered_at, armed, why in (
        (NOW - 2.0, False, "it was armed since this was ordered, and is disarmed again"),
        (NOW - 2.0, True, None),
        (NOW, False, None),
    ):
        vehicle, voice = disarmed(armed_ago_s=1.0)
        vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=armed), NOW)
        assert disarmed_since(vehicle, ordered_at) == why


def test_what_was_on_the_ground_before_it_was_armed_may_have_left_it() -> None:
    for landed_ago_s in (2.0, 1.0):
        vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
        vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=False), NOW - 2.0)
        vehicle.on_frame(voice.landed(1), NOW - landed_ago_s)
        vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True), NOW - 1.0)
        vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=False), NOW)
        assert "it was armed 1.0 s ago" in str(why_not_idle(vehicle, NOW)), landed_ago_s


def test_a_duplicate_id_is_not_idle() -> None:
    vehicle, voice = disarmed()
    vehicle.ids.others = {vehicle.key: "on udp (10.0.0.5:14550) and on radio"}
    assert "10.0.0.5:14550" in str(why_not_idle(vehicle, NOW))
    assert contradiction(vehicle, NOW) is None, "what is known of it is its own"
    vehicle, voice = disarmed()
    vehicle.on_frame(voice.beat(PX4, armed=False), NOW)
    assert "two vehicles send with its ids on one link" in str(contradiction(vehicle, NOW))


def test_an_armed_one_needs_no_evidence() -> None:
    vehicle, voice = disarmed()
    vehicle.on_frame(voice.beat(ARDUPILOT, 4, armed=True), NOW)
    vehicle.on_frame(voice.landed(2), NOW)
    assert contradiction(vehicle, NOW) is None
    assert why_not_idle(vehicle, NOW) == "it is armed"
