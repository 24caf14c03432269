"""How one vehicle is brought to the wanted rates: with a radio's plan exactly, without one only what is missing."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest

from skygcs.core.radio_link.capacity import FRAME_BYTES
from skygcs.core.radio_link.rate_controller import (
    GRACE_S,
    HINT_AFTER,
    KEPT_MESSAGES,
    LISTEN_S,
    MAX_PAUSE_S,
    MIN_WINDOW_S,
    SETTLE_S,
    SILENCES,
    RateController,
    RateRequest,
)
from skygcs.core.radio_link.stream_rates import DEFAULT_RATES_HZ, POSITION, STREAM_GROUPS, profile_rates

SIZES = dict(FRAME_BYTES) | {"VFR_HUD": 32, "RAW_IMU": 41, "EXTENDED_SYS_STATE": 14, "ALTITUDE": 44}
NAV = profile_rates("nav")


class Vehicle:
    """Sends at its rates, obeys after a delay, and may not."""

    def __init__(self, controller: RateController, rates: dict[str, float], *, ardupilot: bool = False) -> None:
        self.controller = controller
        self.rates = {"HEARTBEAT": 1.0, **rates}
        self.ardupilot = ardupilot
        self.counts: dict[str, float] = {}
        self.asked: list[tuple[float, RateRequest]] = []
        self.obeys: Callable[[RateRequest], bool] = lambda ask: True
        self.now = 0.0
        self._obeyed: list[tuple[float, RateRequest]] = []

    def live(self, seconds: float) -> list[tuple[float, RateRequest]]:
        """What it was asked meanwhile."""
        before = len(self.asked)
        for _ in range(int(seconds * 10)):
            self.now = round(self.now + 0.1, 6)
            for name, hz in self.rates.items():
                self.counts[name] = self.counts.get(name, 0.0) + hz / 10
            counts = {name: int(count + 1e-9) for name, count in self.counts.items() if count >= 1}
            ask = self.controller.due(counts, self.now, ardupilot=self.ardupilot, frame_bytes=SIZES)
            if ask is not None:
                self.asked.append((self.now, ask))
                if self.obeys(ask):
                    self._obeyed.append((self.now + 1.0, ask))
            for at, done in [o for o in self._obeyed if o[0] <= self.now]:
                self._obeyed.remove((at, done))
                if done.stream == 0:
                    self.rates = {"HEARTBEAT": 1.0}
                elif done.message is not None and not done.read:
                    self.rates[done.message] = done.rate_hz
        return self.asked[before:]


PX4 = {"ATTITUDE": 4.0, POSITION: 2.0, "VFR_HUD": 1.0, "ALTITUDE": 0.5, "SYS_STATUS": 1.0}
ALL_AT_4_HZ = {n: 4.0 for n in SIZES if n != "HEARTBEAT"}


def messages(asked: list[tuple[float, RateRequest]]) -> list[RateRequest]:
    return [ask for _, ask in asked]


def pauses_s(asked: list[tuple[float, RateRequest]]) -> list[float]:
    return [b - a for (a, _), (b, _) in itertools.pairwise(asked)]


def planned(rates: dict[str, float], **old: bool) -> RateController:
    controller = RateController(**old)
    controller.plan(rates)
    return controller


def test_a_px4_is_brought_to_its_plan_and_then_left_alone() -> None:
    vehicle = Vehicle(planned(NAV), dict(PX4))
    asked = vehicle.live(40)
    assert {n: hz for n, hz in vehicle.rates.items() if hz} == {"HEARTBEAT": 1.0, **NAV}
    assert {ask.message for _, ask in asked if ask.rate_hz == 0} == {"VFR_HUD", "ALTITUDE"}
    assert vehicle.controller.settled
    assert len(asked) <= 8, "each once, and not again"
    assert vehicle.live(120) == []


def test_an_ardupilot_is_silenced_by_one_frame_before_anything_is_asked() -> None:
    vehicle = Vehicle(planned(NAV), ALL_AT_4_HZ, ardupilot=True)
    asked = messages(vehicle.live(60))
    assert asked[:2] == [RateRequest(None, 0.0, 0), RateRequest(POSITION, 2.0)]
    assert [ask.stream for ask in asked].count(0) == 1
    assert not [ask for ask in asked if ask.message is not None and ask.rate_hz == 0]
    assert {n: hz for n, hz in vehicle.rates.items() if hz} == {"HEARTBEAT": 1.0, **NAV}
    assert vehicle.live(120) == []


def test_a_silencing_that_was_lost_is_repeated_a_few_times_at_most() -> None:
    vehicle = Vehicle(planned(NAV), ALL_AT_4_HZ, ardupilot=True)
    vehicle.obeys = lambda ask: False
    assert [ask.stream for ask in messages(vehicle.live(120))].count(0) == SILENCES


def test_nothing_is_asked_at_once_nor_in_one_burst() -> None:
    asked = Vehicle(planned(NAV), dict(PX4)).live(20)
    assert asked[0][0] >= GRACE_S and min(pauses_s(asked)) >= 0.1 - 1e-6


def test_a_request_that_was_lost_is_repeated_ever_more_rarely() -> None:
    vehicle = Vehicle(planned({POSITION: 2.0}), {})
    vehicle.obeys = lambda ask: False
    pauses = pauses_s(vehicle.live(400))
    assert 5 <= pauses[0] <= 10 and pauses[-1] >= 55 and len(pauses) <= 13


def test_half_of_what_is_wanted_is_a_lossy_radio_and_twice_is_not() -> None:
    lossy, fast = Vehicle(planned({POSITION: 2.0}), {}), Vehicle(planned({POSITION: 2.0}), {})
    for vehicle in (lossy, fast):
        vehicle.live(20)
    lossy.rates[POSITION], fast.rates[POSITION] = 1.3, 5.0
    assert lossy.live(60) == []
    asked = fast.live(30)
    assert {ask for _, ask in asked} == {RateRequest(POSITION, 2.0)} and fast.rates[POSITION] == 2.0


def test_answers_and_events_are_never_turned_off() -> None:
    assert Vehicle(planned({}), dict.fromkeys(KEPT_MESSAGES - {"HEARTBEAT"}, 5.0)).live(60) == []


def test_what_came_once_or_twice_by_request_is_no_stream() -> None:
    vehicle = Vehicle(planned({POSITION: 2.0}), {})
    vehicle.live(10)
    for times in (1.0, 2.0):
        vehicle.counts["HOME_POSITION"] = times
        vehicle.live(20)
    assert {ask.message for ask in messages(vehicle.asked)} == {POSITION}


def test_the_worst_flood_is_stopped_first() -> None:
    vehicle = Vehicle(planned({}), {"VFR_HUD": 1.0, "RAW_IMU": 50.0, "ALTITUDE": 2.0})
    assert [ask.message for ask in messages(vehicle.live(30))] == ["RAW_IMU", "ALTITUDE", "VFR_HUD"]


def test_a_new_plan_asks_for_what_changed_only() -> None:
    vehicle = Vehicle(planned(NAV), dict(PX4))
    vehicle.live(60)
    assert vehicle.controller.plan({**NAV, "ATTITUDE": 0.5})
    assert not vehicle.controller.plan({**NAV, "ATTITUDE": 0.5})
    assert {ask for _, ask in vehicle.live(30)} == {RateRequest("ATTITUDE", 0.5)}


def test_after_a_reboot_everything_is_asked_for_again() -> None:
    vehicle = Vehicle(planned(NAV), dict(PX4))
    vehicle.live(60)
    vehicle.rates = {"HEARTBEAT": 1.0, **PX4}
    vehicle.controller.restart()
    vehicle.live(60)
    assert {n: hz for n, hz in vehicle.rates.items() if hz} == {"HEARTBEAT": 1.0, **NAV}


def test_what_a_person_took_in_hand_is_left_alone() -> None:
    vehicle = Vehicle(planned(NAV), dict(PX4))
    vehicle.controller.leave("VFR_HUD")
    vehicle.controller.leave("ATTITUDE")
    asked = {ask.message for _, ask in vehicle.live(60)}
    assert not asked & {"VFR_HUD", "ATTITUDE"} and vehicle.controller.settled


def test_what_does_not_stop_is_reported() -> None:
    vehicle = Vehicle(planned({POSITION: 2.0}), {"VFR_HUD": 10.0})
    vehicle.obeys = lambda ask: ask.message == POSITION
    vehicle.live(200)
    assert [name for name, _ in vehicle.controller.unresponsive()] == ["VFR_HUD"]
    assert vehicle.controller.unresponsive()[0][1] == pytest.approx(10, rel=0.2)
    assert len([ask for _, ask in vehicle.asked if ask.rate_hz == 0]) >= HINT_AFTER


def test_old_firmware_is_asked_by_groups_at_whole_rates() -> None:
    vehicle = Vehicle(planned({POSITION: 2.0, "SYS_STATUS": 0.5}, old=True), {}, ardupilot=True)
    asked = [ask for _, ask in vehicle.live(10)]
    assert asked[:3] == [RateRequest(None, 0.0, 0), RateRequest(None, 2.0, 6), RateRequest(None, 1.0, 2)]
    assert SETTLE_S > 0


def test_old_firmware_is_asked_again_for_a_group_that_does_not_come_ever_more_rarely() -> None:
    vehicle = Vehicle(planned({POSITION: 2.0}, old=True), {}, ardupilot=True)
    times = [at for at, ask in vehicle.live(400) if ask == RateRequest(None, 2.0, 6)]
    assert 5 <= len(times) <= 14 and times[-1] - times[-2] >= 55


# -- without a plan


def wanting(rates: dict[str, float]) -> RateController:
    controller = RateController()
    controller.plan(rates, planned=False)
    return controller


def test_without_a_plan_nothing_is_asked_while_the_vehicle_s_own_streams_may_still_arrive() -> None:
    assert Vehicle(wanting({POSITION: 2.0, "ATTITUDE": 1.0}), {}, ardupilot=True).live(LISTEN_S) == []


def test_without_a_plan_what_is_missing_is_asked_for_and_the_rest_is_left_as_it_is() -> None:
    streams = {"VFR_HUD": 10.0, "ATTITUDE": 0.6, "SYS_STATUS": 8.0}
    vehicle = Vehicle(wanting({POSITION: 2.0, "ATTITUDE": 1.0, "SYS_STATUS": 0.5}), streams, ardupilot=True)
    assert [ask for _, ask in vehicle.live(120)] == [RateRequest(POSITION, 2.0)]
    assert vehicle.rates == {"HEARTBEAT": 1.0, **streams, POSITION: 2.0}


def test_without_a_plan_what_never_comes_is_asked_for_ever_more_rarely() -> None:
    vehicle = Vehicle(wanting({"ATTITUDE": 1.0}), {}, ardupilot=True)
    vehicle.obeys = lambda ask: False
    asked = vehicle.live(1000)
    pauses = pauses_s(asked)
    assert asked[0][0] <= LISTEN_S + 0.2 and pauses[0] < MIN_WINDOW_S + SETTLE_S + 0.2
    assert all(b >= a - 0.11 for a, b in itertools.pairwise(pauses))
    assert abs(pauses[-1] - MAX_PAUSE_S) < 0.2


def test_without_a_plan_a_message_that_stops_is_asked_for_again_soon() -> None:
    vehicle = Vehicle(wanting({"ATTITUDE": 1.0}), {"ATTITUDE": 1.0}, ardupilot=True)
    assert vehicle.live(60) == []
    vehicle.rates["ATTITUDE"] = 0.0
    assert [ask for _, ask in vehicle.live(2 * MIN_WINDOW_S)] == [RateRequest("ATTITUDE", 1.0)]


def test_without_a_plan_a_refused_message_is_left_alone_until_a_reboot() -> None:
    vehicle = Vehicle(wanting({"ATTITUDE": 1.0}), {}, ardupilot=True)
    vehicle.controller.leave("ATTITUDE")
    assert vehicle.live(100) == [] and vehicle.controller.is_left("ATTITUDE")
    vehicle.controller.restart()
    assert vehicle.live(4) and not vehicle.controller.is_left("ATTITUDE")


def test_without_a_plan_a_px4_is_asked_first_how_often_it_streams_a_message() -> None:
    def asked(answer_us: float | None) -> list[RateRequest]:
        vehicle = Vehicle(wanting({POSITION: 2.0}), {})
        for _ in range(60):
            for _, ask in vehicle.live(0.1):
                if ask.read and answer_us is not None:
                    vehicle.controller.on_interval(POSITION, answer_us, vehicle.now)
        return [ask for _, ask in vehicle.asked]

    read, wanted = RateRequest(POSITION, 2.0, read=True), RateRequest(POSITION, 2.0)
    assert asked(200_000.0) == [read], "it streams 5 Hz as soon as it has a position"
    assert asked(1_000_000.0) == asked(-1.0) == asked(0.0) == [read, wanted]
    assert asked(None) == [read, wanted], "it does not answer"


def test_an_interval_that_nobody_asked_for_changes_nothing() -> None:
    vehicle = Vehicle(wanting({POSITION: 2.0}), {}, ardupilot=True)
    vehicle.live(1)
    vehicle.controller.on_interval(POSITION, 200_000.0, vehicle.now)
    vehicle.controller.on_interval("VFR_HUD", 200_000.0, vehicle.now)
    assert [ask for _, ask in vehicle.live(2)] == [RateRequest(POSITION, 2.0)]


def test_without_a_plan_what_only_ardupilot_has_is_asked_of_no_other() -> None:
    for ardupilot, wanted in ((True, {"EKF_STATUS_REPORT"}), (False, set())):
        vehicle = Vehicle(wanting({"EKF_STATUS_REPORT": 0.2}), {}, ardupilot=ardupilot)
        assert {ask.message for _, ask in vehicle.live(6)} == wanted


def test_the_estimator_is_among_what_is_asked_for_and_known_by_a_stream_of_old_firmware() -> None:
    assert DEFAULT_RATES_HZ["EKF_STATUS_REPORT"] == 0.2
    assert set(STREAM_GROUPS) >= set(DEFAULT_RATES_HZ) - {"EXTENDED_SYS_STATE"}


def test_without_rates_nothing_is_asked() -> None:
    for rates in ({}, {"ATTITUDE": 0.0}):
        assert Vehicle(wanting(rates), {"VFR_HUD": 4.0}).live(100) == []


def test_the_end_of_a_plan_leaves_the_streams_that_come_as_they_are() -> None:
    vehicle = Vehicle(planned(NAV), dict(PX4))
    vehicle.live(60)
    vehicle.controller.plan(DEFAULT_RATES_HZ, planned=False)
    streams = {n: hz for n, hz in vehicle.rates.items() if hz}
    vehicle.live(120)
    assert {n: hz for n, hz in vehicle.rates.items() if n in streams} == streams
    assert not {ask.message for _, ask in vehicle.asked[-10:] if ask.rate_hz == 0 and ask.read}
