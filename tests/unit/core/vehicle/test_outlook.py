"""What a pilot sees: of the newest message only, worked out once for each, and nothing that is too old to count."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.control.cascade import Reference
from skygcs.core.control.fence import Fence
from skygcs.core.geo import Origin
from skygcs.core.vehicle.decoder import Decoder
from skygcs.core.vehicle.goals import Place
from skygcs.core.vehicle.outlook import JUDGE_S, TOLD_FRESH_S, Outlook
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from support.vehicles import HOME, PX4, PX4_LOITER, Voice, flight_dialect

DECODER = Decoder(flight_dialect())
NORTH_DEG = 9e-5
"""10 m of latitude."""


class Seen:
    """A vehicle that has told where it is at time 0, and the outlook on it."""

    def __init__(self, fence: Fence | None = None) -> None:
        self.voice = Voice(1)
        self.vehicle = Vehicle(1, 1, flight_dialect(), decoder=DECODER)
        self.vehicle.on_frame(self.voice.beat(PX4, PX4_LOITER, armed=True, status=4), 0.0)
        self.tell(0.0)
        self.outlook = Outlook(self.vehicle)
        self.outlook.anchor(fence)
        self.outlook.estimate()

    def tell(self, now: float, north_deg: float = 0.0) -> None:
        frame = self.voice.position(HOME[0] + north_deg, HOME[1], HOME[2] + 10.0, 10.0)
        self.vehicle.on_frame(frame, now)


def test_without_a_position_there_is_no_anchor() -> None:
    outlook = Outlook(Vehicle(1, 1, flight_dialect(), decoder=DECODER))
    with pytest.raises(RefusedError, match="position is not known"):
        outlook.anchor(None)
    assert outlook.frame is None and outlook.estimate() is None and outlook.age_s(1.0) is None


def test_the_estimate_is_about_the_anchor_and_made_once_for_each_position() -> None:
    seen = Seen()
    first = seen.outlook.estimate()
    assert first is not None and first.pos_enu_m == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert seen.outlook.estimate() is first and seen.outlook.age_s(0.7) == pytest.approx(0.7)
    seen.tell(1.0, NORTH_DEG)
    second = seen.outlook.estimate()
    assert second is not None and second.pos_enu_m == pytest.approx((0.0, 10.0, 0.0), abs=0.05)
    seen.outlook.anchor(None)
    here = seen.outlook.estimate()
    assert here is not None and here.pos_enu_m == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_a_reference_is_one_place_and_comes_back_to_where_it_is() -> None:
    seen = Seen()
    place = Place(HOME[0] + NORTH_DEG, HOME[1], HOME[2] + 12.0)
    reference = Reference(seen.outlook.in_anchor(place))
    told = seen.outlook.place_of(reference)
    assert (told.lat_deg, told.lon_deg) == pytest.approx((place.lat_deg, place.lon_deg), abs=1e-9)
    assert seen.outlook.place_of(reference) is told
    assert seen.outlook.place_of(Reference((0.0, 0.0, 0.0))) is not told


def test_the_vehicle_and_the_place_it_is_sent_to_are_outside_the_fence_apart_from_each_other() -> None:
    seen = Seen(Fence(Origin(*HOME)))
    near, far = Reference((0.0, 5.0, 0.0)), Reference((0.0, 80.0, 0.0))
    assert seen.outlook.breach() is None and seen.outlook.reference_breach(near) is None
    told = seen.outlook.reference_breach(far)
    assert told is not None and "the place to go to" in told
    assert seen.outlook.reference_breach(near) is None
    seen.tell(1.0, 8 * NORTH_DEG)
    seen.outlook.estimate()
    assert seen.outlook.breach() is not None and seen.outlook.reference_breach(near) is None


FIX_LOST = mav.MAVLink_gps_raw_int_message(0, 1, 0, 0, 0, 80, 120, 100, 9000, 12)
BATTERY_LOW = mav.MAVLink_sys_status_message(0, 0, 0, 0, 15800, 1200, 7, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("message", "value", "seen_now", "otherwise"),
    [
        (FIX_LOST, lambda outlook: outlook.fix_ok, False, True),
        (BATTERY_LOW, lambda outlook: outlook.battery_percent, 7, None),
    ],
    ids=["fix", "battery"],
)
def test_what_moves_slowly_is_looked_at_now_and_then_and_counts_while_it_is_fresh(
    message: mav.MAVLink_message, value: Callable[[Outlook], object], seen_now: object, otherwise: object
) -> None:
    seen = Seen()
    outlook = seen.outlook
    outlook.measure(0.0, 10.0)
    seen.vehicle.on_frame(seen.voice.say(message), 10.0)
    outlook.measure(0.0, 10.0 + 0.5 * JUDGE_S)
    assert value(outlook) == otherwise
    outlook.measure(0.0, 10.0 + 1.5 * JUDGE_S)
    assert value(outlook) == seen_now
    outlook.measure(0.0, 10.0 + TOLD_FRESH_S + 1.0)
    assert value(outlook) == otherwise


def test_a_new_anchor_forgets_what_was_measured() -> None:
    seen = Seen()
    outlook = seen.outlook
    outlook.delay.on_pong(outlook.delay.ping(0.0), 0.02)
    outlook.measure(0.1, 0.1)
    assert outlook.delay_p95_s is not None and outlook.delay.rtt_p95_s is not None
    outlook.anchor(None)
    assert outlook.delay_p95_s is None and outlook.delay.rtt_p95_s is None
