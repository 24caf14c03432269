"""The plan of a radio's downlink, and how one vehicle is brought to follow its part of it."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.radio_link.capacity import FRAME_BYTES, PROFILES
from skygcs.core.radio_link.stream_rates import (
    BETTER_AFTER_S,
    CONTROLLED,
    GRID_HZ,
    LEAST,
    LOSS_HIGH,
    NORMAL,
    POSITION,
    SELECTED,
    WORSE_AFTER_S,
    Downlink,
    RateDemand,
    fit,
    on_grid,
    plan_bytes_per_s,
    profile_rates,
)
from support.examples import examples
from support.table import each

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
@settings(max_examples=examples(60), deadline=None)
def test_no_plan_is_above_what_is_wanted_or_what_there_is(wanted, room, each) -> None:
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


@each(("hz", "below"), [(2.0, 2.0), (1.9, 1.33), (0.01, 0.05), (100.0, 50.0)])
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
