"""The plan of a radio's downlink, and how one vehicle is brought to follow its part of it."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.radio_link.capacity import FRAME_BYTES, PROFILES
from skygcs.core.radio_link.stream_rates import (
    BETTER_AFTER_S,
    CONTROLLED,
    GRACE_S,
    GRID_HZ,
    HINT_AFTER,
    KEPT,
    LEAST,
    LOSS_HIGH,
    NORMAL,
    POSITION,
    SELECTED,
    SETTLE_S,
    SILENCES,
    WORSE_AFTER_S,
    Downlink,
    RateController,
    RateDemand,
    RateRequest,
    fit,
    on_grid,
    plan_bytes_per_s,
    profile_rates,
)

SIZES = dict(FRAME_BYTES) | {"VFR_HUD": 32, "RAW_IMU": 41, "EXTENDED_SYS_STATE": 14, "ALTITUDE": 44}
NAV = profile_rates("nav")


def total(plans: dict[int, dict[str, float]]) -> float:
    return sum(plan_bytes_per_s(rates, SIZES) for rates in plans.values())


def test_where_there_is_room_everybody_gets_all() -> None:
    plans = fit({n: RateDemand(NAV) for n in range(10)}, 2880, 276, SIZES)
    assert all(rates == NAV for rates in plans.values())


def test_where_there_is_none_the_position_is_the_last_to_suffer() -> None:
    plans = fit({n: RateDemand(NAV) for n in range(15)}, 2250, 500, SIZES)
    assert total(plans) <= 2250
    for rates in plans.values():
        assert rates[POSITION] == NAV[POSITION]
        assert rates["ATTITUDE"] < NAV["ATTITUDE"]
    poorer = fit({n: RateDemand(NAV) for n in range(15)}, 1200, 500, SIZES)
    assert 0.2 <= poorer[0][POSITION] < NAV[POSITION]


def test_a_timeslot_bounds_one_vehicle_however_much_is_free() -> None:
    (rates,) = fit({1: RateDemand(profile_rates("full"))}, 2880, 300, SIZES).values()
    assert 200 < plan_bytes_per_s(rates, SIZES) <= 300


def test_who_is_flown_or_looked_at_gets_more_and_the_others_less() -> None:
    full = profile_rates("full")
    weights = {1: CONTROLLED, 2: SELECTED, **dict.fromkeys(range(3, 9), NORMAL)}
    plans = fit({n: RateDemand(full, weight) for n, weight in weights.items()}, 2000, 2000, SIZES)
    gets = {n: plan_bytes_per_s(rates, SIZES) - FRAME_BYTES["HEARTBEAT"] for n, rates in plans.items()}
    assert gets[1] > gets[2] > gets[3] == gets[8]
    assert gets[1] == pytest.approx(4 * gets[3], rel=0.35), "as far as the grid of rates lets it"
    assert total(plans) <= 2000


def test_who_wants_little_leaves_the_rest_to_the_others() -> None:
    plans = fit({1: RateDemand({"SYS_STATUS": 0.1}), 2: RateDemand(profile_rates("full"))}, 600, 600, SIZES)
    assert plans[1] == {"SYS_STATUS": 0.1}
    assert plan_bytes_per_s(plans[2], SIZES) > 400


RATES = st.dictionaries(st.sampled_from(sorted(set(SIZES) - {"HEARTBEAT"})), st.floats(0.1, 50), max_size=6)


@given(
    st.lists(st.tuples(RATES, st.sampled_from([NORMAL, SELECTED, CONTROLLED])), max_size=16),
    st.floats(0, 6000),
    st.floats(0, 3000),
)
@settings(max_examples=60, deadline=None)
def test_no_plan_is_above_what_is_wanted_or_what_there_is(
    wanted: list[tuple[dict[str, float], float]], room: float, each: float
) -> None:
    demands = {n: RateDemand(rates, weight) for n, (rates, weight) in enumerate(wanted)}
    plans = fit(demands, room, each, SIZES)
    assert plans.keys() == demands.keys()
    floors = 0.0
    for n, rates in plans.items():
        assert rates.keys() == demands[n].rates_hz.keys(), "slowed down, never dropped"
        for name, hz in rates.items():
            assert 0 < hz <= max(demands[n].rates_hz[name], GRID_HZ[0]) + 1e-9
            floors += max(0.2 * demands[n].rates_hz[name], 0.2 if name == POSITION else GRID_HZ[0]) * SIZES[name]
        floor = sum(max(0.2 * hz, 0.2 if m == POSITION else 0.05) * SIZES[m] for m, hz in demands[n].rates_hz.items())
        assert plan_bytes_per_s(rates, SIZES) <= max(each, FRAME_BYTES["HEARTBEAT"]) + floor + 1e-6
    assert total(plans) <= max(room, FRAME_BYTES["HEARTBEAT"] * len(demands)) + floors + 1e-6


def test_every_profile_is_asked_for_without_the_heartbeat() -> None:
    for name, rates in PROFILES.items():
        assert profile_rates(name) == {m: hz for m, hz in rates.items() if m != "HEARTBEAT"}


@pytest.mark.parametrize(("hz", "below"), [(2.0, 2.0), (1.9, 1.33), (0.01, 0.05), (100.0, 50.0)])
def test_rates_are_rounded_down_to_a_grid(hz: float, below: float) -> None:
    assert on_grid(hz) == below


# -- how much the streams get


def test_losses_that_last_cut_the_streams_and_a_well_radio_gives_them_back_more_slowly() -> None:
    downlink, cut, back = Downlink(), [], []
    for now in range(30):
        if downlink.look(0.3, 0.9, now):
            cut.append(now)
    least = downlink.factor
    for now in range(30, 300):
        if downlink.look(0.0, 0.9, now):
            back.append(now)
    assert cut[0] == WORSE_AFTER_S and back[0] - 30 == BETTER_AFTER_S
    assert LEAST <= least < 0.5 and downlink.factor == 1.0


def test_a_short_burst_or_a_loss_between_the_marks_changes_nothing() -> None:
    downlink = Downlink()
    changed = [downlink.look(0.5 if now % 10 < 5 else 0.1, None, now) for now in range(200)]
    assert not any(changed) and downlink.factor == 1.0


def test_a_full_buffer_at_the_ground_cuts_the_streams_too_and_ignorance_does_not() -> None:
    full, ignorant = Downlink(), Downlink()
    for now in range(20):
        full.look(None, 0.05, now)
        ignorant.look(None, None, now)
    assert full.factor < 1.0 and ignorant.factor == 1.0


@given(st.lists(st.tuples(st.none() | st.floats(0, 1), st.none() | st.floats(0, 1)), max_size=100))
def test_the_factor_is_never_below_its_least_nor_above_one(looks: list[tuple[float | None, float | None]]) -> None:
    downlink = Downlink()
    for now, (loss, free) in enumerate(looks):
        downlink.look(loss, free, now * 7)
        assert LEAST <= downlink.factor <= 1
    assert LOSS_HIGH > 0.1


# -- one vehicle


class Vehicle:
    """Sends at its rates, obeys after a delay, and may not."""

    def __init__(self, keeper: RateController, rates: dict[str, float], *, ardupilot: bool = False) -> None:
        self.keeper = keeper
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
            ask = self.keeper.due(counts, self.now, ardupilot=self.ardupilot, frame_bytes=SIZES)
            if ask is not None:
                self.asked.append((self.now, ask))
                if self.obeys(ask):
                    self._obeyed.append((self.now + 1.0, ask))
            for at, done in [o for o in self._obeyed if o[0] <= self.now]:
                self._obeyed.remove((at, done))
                if done.stream == 0:
                    self.rates = {"HEARTBEAT": 1.0}
                elif done.message is not None:
                    self.rates[done.message] = done.rate_hz
        return self.asked[before:]


PX4 = {"ATTITUDE": 4.0, POSITION: 2.0, "VFR_HUD": 1.0, "ALTITUDE": 0.5, "SYS_STATUS": 1.0}


def planned(rates: dict[str, float], **old: bool) -> RateController:
    keeper = RateController(**old)
    keeper.plan(rates)
    return keeper


def test_a_px4_is_brought_to_its_plan_and_then_left_alone() -> None:
    vehicle = Vehicle(planned(NAV), dict(PX4))
    asked = vehicle.live(40)
    assert {n: hz for n, hz in vehicle.rates.items() if hz} == {"HEARTBEAT": 1.0, **NAV}
    assert {ask.message for _, ask in asked if ask.rate_hz == 0} == {"VFR_HUD", "ALTITUDE"}
    assert vehicle.keeper.settled
    assert len(asked) <= 8, "each once, and not again"
    assert vehicle.live(120) == []


def test_an_ardupilot_is_silenced_by_one_frame_before_anything_is_asked() -> None:
    vehicle = Vehicle(planned(NAV), {n: 4.0 for n in SIZES if n != "HEARTBEAT"}, ardupilot=True)
    asked = vehicle.live(60)
    assert asked[0][1] == RateRequest(None, 0.0, 0)
    assert asked[1][1] == RateRequest(POSITION, 2.0)
    assert [ask.stream for _, ask in asked].count(0) == 1
    assert not [ask for _, ask in asked if ask.message is not None and ask.rate_hz == 0]
    assert {n: hz for n, hz in vehicle.rates.items() if hz} == {"HEARTBEAT": 1.0, **NAV}
    assert vehicle.live(120) == []


def test_a_silencing_that_was_lost_is_repeated_a_few_times_at_most() -> None:
    vehicle = Vehicle(planned(NAV), {n: 4.0 for n in SIZES if n != "HEARTBEAT"}, ardupilot=True)
    vehicle.obeys = lambda ask: False
    vehicle.live(120)
    assert [ask.stream for _, ask in vehicle.asked].count(0) == SILENCES


def test_nothing_is_asked_at_once_nor_in_one_burst() -> None:
    asked = Vehicle(planned(NAV), dict(PX4)).live(20)
    assert asked[0][0] >= GRACE_S
    assert all(b[0] - a[0] >= 0.1 - 1e-6 for a, b in itertools.pairwise(asked))


def test_a_request_that_was_lost_is_repeated_ever_more_rarely() -> None:
    vehicle = Vehicle(planned({POSITION: 2.0}), {})
    vehicle.obeys = lambda ask: False
    times = [at for at, _ in vehicle.live(400)]
    pauses = [b - a for a, b in itertools.pairwise(times)]
    assert 5 <= pauses[0] <= 10 and pauses[-1] >= 55
    assert len(times) <= 14


def test_half_of_what_is_wanted_is_a_lossy_radio_and_twice_is_not() -> None:
    lossy, fast = Vehicle(planned({POSITION: 2.0}), {}), Vehicle(planned({POSITION: 2.0}), {})
    for vehicle in (lossy, fast):
        vehicle.live(20)
    lossy.rates[POSITION], fast.rates[POSITION] = 1.3, 5.0
    assert lossy.live(60) == []
    asked = fast.live(30)
    assert {ask for _, ask in asked} == {RateRequest(POSITION, 2.0)} and fast.rates[POSITION] == 2.0


def test_answers_and_events_are_never_turned_off() -> None:
    vehicle = Vehicle(planned({}), dict.fromkeys(KEPT - {"HEARTBEAT"}, 5.0))
    assert vehicle.live(60) == []


def test_what_came_once_or_twice_by_request_is_no_stream() -> None:
    vehicle = Vehicle(planned({POSITION: 2.0}), {})
    vehicle.live(10)
    vehicle.counts["HOME_POSITION"] = 1.0
    vehicle.live(20)
    vehicle.counts["HOME_POSITION"] = 2.0
    vehicle.live(20)
    assert all(ask.message == POSITION for _, ask in vehicle.asked)


def test_the_worst_flood_is_stopped_first() -> None:
    vehicle = Vehicle(planned({}), {"VFR_HUD": 1.0, "RAW_IMU": 50.0, "ALTITUDE": 2.0})
    offs = [ask.message for _, ask in vehicle.live(30)]
    assert offs == ["RAW_IMU", "ALTITUDE", "VFR_HUD"]


def test_a_new_plan_asks_for_what_changed_only() -> None:
    vehicle = Vehicle(planned(NAV), dict(PX4))
    vehicle.live(60)
    assert vehicle.keeper.plan({**NAV, "ATTITUDE": 0.5})
    assert not vehicle.keeper.plan({**NAV, "ATTITUDE": 0.5})
    assert {ask for _, ask in vehicle.live(30)} == {RateRequest("ATTITUDE", 0.5)}


def test_after_a_reboot_everything_is_asked_for_again() -> None:
    vehicle = Vehicle(planned(NAV), dict(PX4))
    vehicle.live(60)
    vehicle.rates = {"HEARTBEAT": 1.0, **PX4}
    vehicle.keeper.restart()
    vehicle.live(60)
    assert {n: hz for n, hz in vehicle.rates.items() if hz} == {"HEARTBEAT": 1.0, **NAV}


def test_what_a_person_took_in_hand_is_left_alone() -> None:
    vehicle = Vehicle(planned(NAV), dict(PX4))
    vehicle.keeper.leave("VFR_HUD")
    vehicle.keeper.leave("ATTITUDE")
    asked = {ask.message for _, ask in vehicle.live(60)}
    assert not asked & {"VFR_HUD", "ATTITUDE"} and vehicle.keeper.settled


def test_what_will_not_stop_is_told_of() -> None:
    vehicle = Vehicle(planned({POSITION: 2.0}), {"VFR_HUD": 10.0})
    vehicle.obeys = lambda ask: ask.message == POSITION
    vehicle.live(200)
    assert [name for name, _ in vehicle.keeper.unresponsive()] == ["VFR_HUD"]
    assert vehicle.keeper.unresponsive()[0][1] == pytest.approx(10, rel=0.2)
    assert len([ask for _, ask in vehicle.asked if ask.rate_hz == 0]) >= HINT_AFTER


def test_old_firmware_is_asked_by_groups_at_whole_rates() -> None:
    vehicle = Vehicle(planned({POSITION: 2.0, "SYS_STATUS": 0.5}, old=True), {}, ardupilot=True)
    asked = [ask for _, ask in vehicle.live(10)]
    assert asked[:3] == [RateRequest(None, 0.0, 0), RateRequest(None, 2.0, 6), RateRequest(None, 1.0, 2)]
    assert SETTLE_S > 0
