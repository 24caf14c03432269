"""Other sites: the newest batch wins, and nothing old looks new."""

from __future__ import annotations

import json
import math
from typing import Any

import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic_core import from_json

from skygcs.core.geo import Origin, enu_from_geodetic
from skygcs.errors import TargetError
from skygcs.ext.federation.protocol import remote_sites
from skygcs.ext.federation.protocol.origin_shift import velocity_in, yaw_in
from skygcs.ext.federation.protocol.received_json import MAX_INTEGER, MAX_TEXT_CHARS, cleaned, printable
from skygcs.ext.federation.protocol.remote_sites import RemoteSites
from skygcs.ext.federation.protocol.site_names import name_of_token, select_at, split_by_site, subject_token
from skygcs.ext.federation.protocol.state_batch import StateBatch, VehicleRow, row_from_state
from support.table import each

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


# -- Targets of several sites: which part goes to which site, and what is refused.


SITES = ("south", "east")


def site_row(sysid: int, name: str, *groups: str) -> VehicleRow:
    made = row_from_state({"name": name, "sysid": sysid, "compid": 1, "groups": list(groups)})
    assert made is not None
    return made


@each(
    ("expression", "own", "others", "changed"),
    [
        ("all", ("all",), {}, False),
        ("alpha, 2-5", ("alpha", "2-5"), {}, False),
        (7, ("7",), {}, False),
        ("7/191,alpha/191,all/100", ("7/191", "alpha/191", "all/100"), {}, False),
        ("south/alpha", (), {"south": ("alpha",)}, True),
        (["south/1-5", "bravo", "south/all"], ("bravo",), {"south": ("1-5", "all")}, True),
        ("north/alpha", ("alpha",), {}, True),
        ("south/7/191", (), {"south": ("7/191",)}, True),
        ("south/3", (), {"south": ("3",)}, True),
    ],
)
def test_each_part_goes_to_its_site(
    expression: str, own: tuple[str, ...], others: dict[str, tuple[str, ...]], changed: bool
) -> None:
    found = split_by_site(expression, "north", SITES)
    assert (found.own, dict(found.others), found.changed, found.every) == (own, others, changed, False)


@each("expression", ["*/all", "all sites", ["alpha", "*/all"]])
def test_every_site_means_the_own_one_and_those_that_come_later_too(expression: str) -> None:
    found = split_by_site(expression, "north", SITES)
    assert "all" in found.own
    assert found.others == {"south": ("all",), "east": ("all",)}
    assert found.every and found.changed


@each(
    ("expression", "words"),
    [
        ("west/alpha", "no site 'west' has been heard; there are: east, north, south"),
        ("*/alpha", "only */all names every site"),
        ("south/", "all vehicles of a site: south/all"),
        ("", "no target given"),
    ],
)
def test_what_names_nothing_is_refused_with_what_there_is(expression: str, words: str) -> None:
    with pytest.raises(TargetError) as error:
        split_by_site(expression, "north", SITES)
    assert words in str(error.value)


def test_a_part_is_read_at_its_site_as_a_daemon_reads_it() -> None:
    rows = [site_row(3, "carol"), site_row(1, "alpha", "red"), site_row(2, "bravo", "red")]
    assert [v.name for v in select_at("south", ["red"], rows)] == ["alpha", "bravo"]
    assert [v.name for v in select_at("south", ["2-9"], rows)] == ["bravo", "carol"]
    assert [v.name for v in select_at("south", ["all"], rows)] == ["alpha", "bravo", "carol"]
    assert select_at("south", ["all"], []) == []
    with pytest.raises(TargetError, match="south: no vehicle 'delta'"):
        select_at("south", ["delta"], rows)


@given(st.text(min_size=1, max_size=40))
def test_a_name_becomes_one_token_of_a_subject_and_comes_back(name: str) -> None:
    try:
        name.encode()
    except UnicodeEncodeError:
        return
    token = subject_token(name)
    assert token.isascii() and not set(token) & set(" .*>/\r\n\t")
    assert name_of_token(token) == name


@given(st.text(alphabet="ab=4F2e0.é", max_size=8))
def test_only_what_is_written_so_is_read_as_a_name(token: str) -> None:
    try:
        name = name_of_token(token)
    except ValueError:
        return
    assert subject_token(name) == token


# -- Velocities and headings of another site in the own frame, against pymap3d.


latitudes, longitudes = st.floats(-75, 75), st.floats(-170, 170)
apart_deg = st.floats(-0.9, 0.9)
velocities = st.tuples(*[st.floats(-30, 30)] * 3)


@given(latitudes, longitudes, apart_deg, apart_deg, velocities)
def test_a_velocity_is_the_derivative_of_the_place_in_the_own_frame(
    lat: float, lon: float, d_lat: float, d_lon: float, velocity: tuple[float, float, float]
) -> None:
    """Moved along its own true east, north, up for a second, by pymap3d."""
    ours = Origin(lat + d_lat, lon + d_lon, 0.0)
    moved = pymap3d.enu2geodetic(*velocity, lat, lon, 100.0)
    before = pymap3d.geodetic2enu(lat, lon, 100.0, ours.lat_deg, ours.lon_deg, 0.0)
    after = pymap3d.geodetic2enu(*moved, ours.lat_deg, ours.lon_deg, 0.0)
    expected = [float(b - a) for a, b in zip(before, after, strict=True)]
    assert list(velocity_in(ours, velocity, lat, lon)) == pytest.approx(expected, abs=1e-4)


def test_meridians_converge_by_a_degree_and_a_half_over_a_hundred_kilometres_at_sixty_north() -> None:
    ours = Origin(60.0, 10.0, 0.0)
    east_100_km_deg = math.degrees(100_000.0 / (6_378_137.0 * math.cos(math.radians(60.0))))
    turned = math.degrees(yaw_in(ours, 0.0, 60.0, 10.0 + east_100_km_deg))
    assert turned == pytest.approx(math.degrees(100_000.0 / 6_378_137.0) * math.tan(math.radians(60.0)), abs=0.02)


def test_a_heading_at_the_origin_is_turned_by_its_axes_only() -> None:
    ours = Origin(48.0, 11.0, 500.0, x_heading_deg=0.0)
    assert yaw_in(ours, math.pi / 2, 48.0, 11.0) == pytest.approx(0.0, abs=1e-9)


# -- What any site may have written as JSON can be shown and encoded after it is decoded.


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
)


@given(values)
def test_whatever_came_can_be_shown_and_encoded(value: object) -> None:
    text = json.dumps(cleaned(value), ensure_ascii=False, allow_nan=False)
    assert text.isprintable()
    assert cleaned(cleaned(value)) == cleaned(value)


def test_numbers_that_pydantic_reads_as_infinity_or_without_bounds_are_dropped() -> None:
    found = from_json(b'{"a":1e999,"b":[-1e999,1.5],"c":1' + 400 * b"0" + b',"d":true,"e":7}', allow_inf_nan=False)
    assert cleaned(found) == {"a": None, "b": [None, 1.5], "c": None, "d": True, "e": 7}
    assert cleaned([MAX_INTEGER, MAX_INTEGER + 1, -MAX_INTEGER - 1]) == [MAX_INTEGER, None, None]


def test_texts_are_cut_and_their_control_characters_replaced() -> None:
    assert cleaned({"\x1b[2J": ["a\nb\u202e", "x" * 5000]}) == {"?[2J": ["a?b?", "x" * MAX_TEXT_CHARS]}
    assert printable("Öl", 1) == "Ö"
