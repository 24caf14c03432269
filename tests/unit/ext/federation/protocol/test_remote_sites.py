"""Other sites: the newest batch wins, and nothing old looks new."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import Origin, enu_from_geodetic
from skygcs.ext.federation.protocol import remote_sites
from skygcs.ext.federation.protocol.remote_sites import RemoteSites
from skygcs.ext.federation.protocol.state_batch import StateBatch, VehicleRow, row_from_state

AHEAD_S = 1.79e9
"""The other site's clock is so far ahead of ours in these tests."""

PLACE = {"lat_deg": 48.1, "lon_deg": 11.5, "alt_amsl_m": 530.0, "alt_rel_m": 10.0, "heading_deg": 90.0, "age_s": 0.2}


def row(name: str = "alpha", **more: Any) -> VehicleRow:
    state = {"name": name, "sysid": 1, "compid": 1, "connected": True, "last_heartbeat_age_s": 0.5, "armed": True}
    made = row_from_state(state | {"position": PLACE, "landed": "in_air"} | more)
    assert made is not None
    return made


def batch(seq: int, sent: float, *rows: VehicleRow, run: str = "r1", site: str = "south") -> StateBatch:
    """Sent at this time of our clock."""
    return StateBatch(site, run, seq, sent + AHEAD_S, 0.1, True, Origin(48.0, 11.4, 500.0), rows or (row(),))


def heard(*, at: float = 100.0) -> RemoteSites:
    """One site, heard now, with a comparison of clocks that is good to a millisecond."""
    sites = RemoteSites("north", "mine")
    assert sites.take(batch(1, at - 0.01), at)
    ping(sites, at)
    return sites


def ping(sites: RemoteSites, now: float, *, site: str = "south", run: str = "r1") -> bool:
    return sites.compare_clock(site, run, now - 0.002, now, now - 0.001 + AHEAD_S, unix_received=now + 5.0)


def alpha(sites: RemoteSites, now: float, ours: Origin | None = None) -> dict[str, Any]:
    found = sites.state("south", "alpha", now, ours)
    assert found is not None
    return found


def test_the_total_age_is_that_at_the_site_and_the_time_since_it_was_sent() -> None:
    sites = heard(at=100.0)
    state = alpha(sites, 100.3)
    assert state["age_s"] == state["last_heartbeat_age_s"] == pytest.approx(0.5 + 0.31, abs=2e-3)
    assert state["position"]["age_s"] == pytest.approx(0.2 + 0.31, abs=2e-3)
    assert (state["name"], state["site"], state["connected"]) == ("south/alpha", "south", True)


def test_a_silent_site_is_grey_and_its_ages_grow_for_ever() -> None:
    sites = heard(at=100.0)
    assert alpha(sites, 100.9)["connected"]
    for later in (101.1, 130.0):
        state = alpha(sites, later)
        assert not state["connected"]
        assert state["age_s"] == pytest.approx(later - 100 + 0.51, abs=0.05)
    (described,) = sites.sites(130.0)
    assert described["silent"] and described["vehicles"]["heard"] == 0 and described["vehicles"]["problems"] == 1
    assert alpha(sites, 5000.0)["age_s"] is None  # no ping was answered for a minute: the age is not known
    assert not alpha(sites, 5000.0)["connected"]


def test_what_waited_in_a_queue_is_as_old_as_it_is_however_lately_it_came() -> None:
    sites = heard(at=100.0)
    ping(sites, 159.0)
    for seq in range(2, 30):  # sent a minute ago, each of them comes now
        sites.take(batch(seq, 100.0 + seq / 10), 160.0)
    state = alpha(sites, 160.0)
    assert state["age_s"] == pytest.approx(0.5 + 160.0 - 102.9, abs=0.05)
    assert not state["connected"]


def test_without_a_comparison_of_clocks_the_age_is_not_known_and_nothing_is_fresh() -> None:
    sites = RemoteSites(None, "mine")
    sites.take(batch(1, 100.0), 100.0)
    assert alpha(sites, 100.0)["age_s"] is None and not alpha(sites, 100.0)["connected"]
    assert ping(sites, 100.1) and alpha(sites, 100.1)["connected"]


def test_an_age_is_never_less_than_the_time_since_it_came() -> None:
    """A comparison that is wrong by its whole error cannot make a state younger than that."""
    sites = RemoteSites("north", "mine")
    sites.take(batch(1, 100.0), 100.0)
    sites.compare_clock("south", "r1", 99.0, 99.4, 99.0 + AHEAD_S, unix_received=0.0)  # all of it on the way back
    assert alpha(sites, 100.2)["age_s"] >= 0.7


def test_the_newest_of_a_run_wins_and_gaps_are_counted() -> None:
    sites = heard()
    assert sites.take(batch(5, 100.4, row("bravo")), 100.4)
    assert not sites.take(batch(4, 100.3), 100.41)
    assert not sites.take(batch(5, 100.3), 100.42)
    assert [state["name"] for state in sites.states("south", 100.5, None)] == ["south/bravo"]
    assert sites.sites(100.5)[0]["batches"] == {"taken": 2, "lost": 3, "late": 2}


def test_a_bridge_that_restarts_is_taken_at_once_and_its_old_run_never_again() -> None:
    sites = heard()
    assert sites.take(batch(1, 100.2, row("bravo"), run="r2"), 100.2)
    assert not sites.take(batch(9, 100.1), 100.3)
    assert not sites.sites(100.3)[0]["contested"]
    assert alpha_names(sites) == ["south/bravo"]
    assert not ping(sites, 100.4, run="r1")
    assert sites.state("south", "bravo", 100.4, None)["connected"] is False  # type: ignore[index]  # a new clock
    assert ping(sites, 100.4, run="r2")


def alpha_names(sites: RemoteSites) -> list[str]:
    return [state["name"] for state in sites.states("south", 100.4, None)]


def test_two_bridges_under_one_name_are_shown() -> None:
    sites = heard()
    for tenth in range(1, 80):
        now = 100.0 + tenth / 10
        sites.take(batch(tenth + 1, now, run="r1" if tenth % 2 else "r2"), now)
    assert sites.sites(108.0)[0]["contested"]
    assert not sites.take(batch(1, 100.0, site="north", run="other"), 108.0)
    assert sites.own_contested_at == 108.0
    assert not sites.take(batch(1, 100.0, site="north", run="mine"), 109.0)
    assert sites.own_contested_at == 108.0 and "north" not in sites


def test_a_clock_that_was_set_is_measured_again() -> None:
    sites = heard()
    sites.take(batch(2, 160.0), 100.1)  # as if it had been sent in a minute
    assert sites.counters["clock_jumps"] == 1
    assert alpha(sites, 100.1)["age_s"] is None and not alpha(sites, 100.1)["connected"]


def test_positions_are_in_the_own_frame() -> None:
    ours = Origin(48.2, 11.6, 400.0, x_heading_deg=0.0)
    position = alpha(heard(), 100.0, ours)["position"]
    assert position["enu_m"] == pytest.approx(enu_from_geodetic(48.1, 11.5, 530.0, ours), abs=1e-3)
    assert position["heading_deg"] == 90.0
    assert position["yaw_world_deg"] == pytest.approx(-90.0, abs=0.2)
    assert alpha(heard(), 100.0)["position"]["enu_m"] is None


def test_a_vehicle_that_is_no_longer_sent_is_gone() -> None:
    sites = heard()
    sites.take(batch(2, 100.1, row("bravo")), 100.1)
    assert sites.state("south", "alpha", 100.1, None) is None


def test_sites_are_bounded_and_the_one_that_was_silent_for_an_hour_makes_room() -> None:
    sites = RemoteSites("north", "mine")
    for i in range(remote_sites.MAX_SITES):
        assert sites.take(batch(1, 0.0, site=f"s{i}"), float(i))
    assert not sites.take(batch(1, 0.0, site="late"), 100.0)
    assert sites.counters["sites_beyond_limit"] == 1
    assert sites.take(batch(1, 0.0, site="late"), 3601.0)
    assert "s0" not in sites and len(sites.names) == remote_sites.MAX_SITES
    assert sites.counters["sites_forgotten"] == 1


@given(st.lists(st.tuples(st.floats(0, 5), st.floats(0, 3), st.floats(0, 0.4)), min_size=1, max_size=20))
def test_no_order_of_arrival_makes_a_state_look_younger_than_it_is(packets: list[tuple[float, float, float]]) -> None:
    """Packets of (sent at, time on the way, way back of a ping): the age shown is at least the true one less the
    comparison's error, and what is shown as connected was sent in the last second or so."""
    sites = RemoteSites("north", "mine")
    arrivals = sorted((sent + way, sent, back, seq) for seq, (sent, way, back) in enumerate(sorted(packets), 1))
    for came, sent, back, seq in arrivals:
        sites.take(batch(seq, sent, row(last_heartbeat_age_s=0.0)), came)
        sites.compare_clock("south", "r1", came, came + back, came + AHEAD_S, unix_received=came)
    newest = max(sent for sent, _, _ in packets)
    now = max(came for came, *_ in arrivals) + 0.5
    state, offset = alpha(sites, now), sites.clock("south", now)
    assert offset is not None and state["age_s"] >= now - newest - offset.error_s - 2e-3
    if state["connected"]:
        assert now - newest <= remote_sites.SILENT_AFTER_S + offset.error_s + 2e-3
