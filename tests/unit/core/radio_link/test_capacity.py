"""The arithmetic of a shared radio, against the tables of the field notes (8.2, 10.1 and 10.2)."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.config.dialects import load_dialect
from skygcs.core.radio_link.capacity import (
    FLOWN_HZ,
    FRAME_BYTES,
    GOTO,
    MAX_NODES,
    PROFILES,
    SETPOINTS,
    LinkDemand,
    assumed_timing,
    plan_link,
    profile_bytes_per_s,
    round_s,
    setpoint_bytes_per_s,
    uplink_bytes_per_s,
)
from support.table import each


def demand(vehicles: int, profile: str = "nav", **changes: object) -> LinkDemand:
    return LinkDemand(vehicles, profile=profile, rates_hz=PROFILES[profile], **changes)  # type: ignore[arg-type]


@each(
    ("profile", "bytes_per_s", "vehicles"),
    [("monitor", 120.5, 23), ("nav", 200.5, 14), ("control", 245, 11), ("control-10", 445, 6), ("full", 845, 3)],
)
def test_half_of_57600_baud_carries_what_the_published_table_says(profile, bytes_per_s, vehicles) -> None:
    assert profile_bytes_per_s(PROFILES[profile]) == pytest.approx(bytes_per_s, abs=0.25)
    assert plan_link(demand(1, profile, air_kbps=None)).most_vehicles == vehicles


@each(
    ("air_kbps", "nodes", "published_ms"),
    [
        *((64, n, ms) for n, ms in ((2, 181), (3, 262), (5, 424), (9, 749), (16, 1318))),
        *((125, n, ms) for n, ms in ((2, 102), (3, 147), (5, 239), (9, 421), (16, 740))),
        *((250, n, ms) for n, ms in ((2, 63), (3, 90), (5, 146), (9, 257), (16, 451))),
    ],
)
def test_rounds_last_as_long_as_in_the_published_table(air_kbps: float, nodes: int, published_ms: float) -> None:
    assert round_s(air_kbps, nodes) * 1000 == pytest.approx(published_ms, rel=0.02)


def test_frame_sizes_are_those_of_the_dialect() -> None:
    dialect = load_dialect(["ardupilotmega"])
    for name, size in FRAME_BYTES.items():
        assert dialect.by_name[name].length + 12 == size


def test_ten_vehicles_at_64_kbit_fit_with_their_positions_and_single_orders() -> None:
    plan = plan_link(demand(10))
    assert plan.fits
    assert plan.rates_hz == PROFILES["nav"]
    up = next(way for way in plan.directions if way.name == "up, the ground's slot")
    assert up.capacity == pytest.approx(550, rel=0.01)


def test_offboard_for_ten_is_refused_with_its_figures_and_goto_is_proposed() -> None:
    plan = plan_link(demand(10, setpoint="position", setpoint_hz=2.0))
    assert not plan.fits
    assert plan.problems == (
        "up, the ground's slot carries 553 B/s, of which 259 may be planned with; 1,321 are wanted",
        "setpoints: the ground sends once a round, every 0.91 s; PX4 wants 2 Hz, and leaves OFFBOARD after 1 s "
        "without: one lost slot makes 1.82 s",
    )
    assert plan.proposals == (
        GOTO,
        "4 vehicles instead of 10, the others on a second radio or on Wi-Fi",
        "air speed 125 kbit/s for up to 5 vehicles",
        "air speed 250 kbit/s for up to 7 vehicles",
    )
    assert plan.most_vehicles == 4


def test_the_vehicles_that_are_flown_by_setpoints_are_those_whose_share_carries_them() -> None:
    """The same arithmetic as a vehicle's share under way: half of 90 % of the slot, less our heartbeat."""
    for air, most in ((64.0, 2), (125.0, 3), (250.0, 4)):
        assert plan_link(demand(4, air_kbps=air)).most_streamed == most
        for vehicles in (most, most + 1):
            uplink = uplink_bytes_per_s(57600, assumed_timing(air), vehicles + 1)
            share = setpoint_bytes_per_s(uplink, FRAME_BYTES["HEARTBEAT"], vehicles)
            needed = FLOWN_HZ["position"] * FRAME_BYTES["SET_POSITION_TARGET_LOCAL_NED"]
            assert (share >= needed) == (vehicles == most), (air, vehicles, share)


def test_a_round_longer_than_a_second_cannot_hold_offboard_at_all() -> None:
    plan = plan_link(demand(15, "monitor", setpoint="attitude", setpoint_hz=1.0))
    assert any(problem.endswith("after 1 s without: a round is longer") for problem in plan.problems)


def test_more_nodes_than_the_firmware_has_ids_do_not_fit_however_little_they_send() -> None:
    plan = plan_link(demand(MAX_NODES, "monitor", air_kbps=250.0, baud=115200))
    assert plan.problems == ("17 nodes: RFD900x multipoint has 16 node ids, one of them the ground's",)
    assert plan.proposals == ("15 vehicles instead of 16, the others on a second radio or on Wi-Fi",)


def test_faster_serial_ports_and_smaller_profiles_are_proposed_where_they_help() -> None:
    plan = plan_link(demand(15, air_kbps=125.0))
    assert plan.proposals == (
        "profile monitor",
        "115200 baud",
        "230400 baud",
        "14 vehicles instead of 15, the others on a second radio or on Wi-Fi",
    )
    for baud in (115200, 230400):
        assert plan_link(demand(15, air_kbps=125.0, baud=baud)).fits


def test_where_no_single_change_is_enough_one_is_proposed_beside_goto() -> None:
    plan = plan_link(demand(10, "full", setpoint="position", setpoint_hz=2.0))
    assert plan.proposals == (
        f"{GOTO}, and profile control",
        f"{GOTO}, and profile nav",
        f"{GOTO}, and profile monitor",
        "2 vehicles instead of 10, the others on a second radio or on Wi-Fi",
        "profile control-10 for up to 4 vehicles",
    )
    assert plan_link(demand(10, "control")).fits


@given(
    st.integers(1, 40),
    st.sampled_from(sorted(PROFILES)),
    st.sampled_from([None, 64.0, 125.0]),
    st.sampled_from([9600, 57600]),
    st.sampled_from(sorted(SETPOINTS)),
)
def test_fewer_vehicles_are_proposed_only_where_they_fit(vehicles, profile, air, baud, setpoint) -> None:
    wish = demand(vehicles, profile, air_kbps=air, baud=baud, setpoint=setpoint, setpoint_hz=2.0)
    plan = plan_link(wish)
    reported = [text for text in plan.proposals if "instead of" in text and text[0].isdigit()]
    assert len(reported) == (not plan.fits and plan.most_vehicles > 0)
    for text in reported:
        assert plan_link(replace(wish, vehicles=int(text.split()[0]))).fits
        assert not plan_link(replace(wish, vehicles=int(text.split()[0]) + 1)).fits


@given(
    st.integers(1, 60),
    st.sampled_from(sorted(PROFILES)),
    st.sampled_from([None, 12.0, 64.0, 125.0, 250.0]),
    st.sampled_from([9600, 57600, 115200]),
    st.sampled_from(sorted(SETPOINTS)),
    st.floats(0.1, 50),
)
def test_what_each_vehicle_gets_fits_but_for_heartbeats(vehicles, profile, air, baud, setpoint, hz) -> None:
    wanted = demand(vehicles, profile, air_kbps=air, baud=baud, setpoint=setpoint, setpoint_hz=hz)
    plan = plan_link(wanted)
    assert plan.fits == (vehicles <= plan.most_vehicles)
    assert bool(plan.proposals) == (not plan.fits)
    assert all(plan.rates_hz[name] <= rate for name, rate in PROFILES[profile].items())
    assert plan.rates_hz["HEARTBEAT"] == 1
    got = profile_bytes_per_s(plan.rates_hz)
    for way in plan.directions:
        assert (way.needed <= way.usable + 1e-6) == way.fits
        if way.name.startswith("down"):
            one = way.usable / (vehicles if "serial" in way.name else 1)
            assert got <= max(one, FRAME_BYTES["HEARTBEAT"]) + 1e-6
