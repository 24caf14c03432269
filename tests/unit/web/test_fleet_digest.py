"""What is read of a state for pages that show hundreds: briefs, searches, counts, and what hostile states do to it."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.errors import RpcError
from skygcs.web.fleet_digest import MAX_NAMES, VEHICLE_SILENT_S, Digest, View, count_sites, digest_of, view_of
from support.table import each


def digest(name: str = "south/alpha", at: float = 0.0, **more: Any) -> Digest:
    state = {
        "name": name,
        "sysid": 7,
        "compid": 1,
        "autopilot": "px4",
        "mode": "AUTO.LOITER",
        "groups": ["Scouts"],
        "connected": True,
        "last_heartbeat_age_s": 0.4,
        "links": {"radio": {"age_s": 0.2}},
        "armed": True,
        "landed": "in_air",
        "failsafe": False,
        "position": {"enu_m": [1.234, 2, 3], "yaw_world_deg": 45.678},
        "battery": {"percent": 80},
    }
    return digest_of(name, json.dumps(state | more).encode(), at)


def test_a_brief_says_who_it_is_where_and_whether_all_is_well() -> None:
    row = ["south/alpha", 7, "px4", True, "in_air", False, True, 0.2, 1.23, 2.0, 3.0, 45.68, 0.0]
    assert json.loads(digest().row) == row
    placed = digest(position={"enu_m": None, "lat_deg": 43.5, "lon_deg": -79.5})
    assert json.loads(placed.row)[8:] == [None, None, None, None, 0.0, 43.5, -79.5]


@each(
    ("search", "found"),
    [
        ("south", True),
        ("SCOUTS armed", True),
        ("in air px4", True),
        ("loiter heard", True),
        ("north", False),
        ("disarmed", False),
        ("problem", False),
        ("failsafe", False),
    ],
)
def test_a_search_finds_what_has_all_of_its_words(search: str, found: bool) -> None:
    view = view_of({"search": search})
    assert view.wanted([digest()], 0.0) == ({"south/alpha"} if found else set(), 0)


def test_what_is_disarmed_is_not_found_by_armed() -> None:
    standing = digest(armed=False, landed="on_ground")
    assert not standing.matches(["armed"], 0.0)
    assert standing.matches(["disarmed"], 0.0) and standing.matches(["ground", "dis"], 0.0)


def test_silence_is_a_problem_that_comes_with_time() -> None:
    assert not digest().matches(["problem"], VEHICLE_SILENT_S - 0.3)
    assert digest().matches(["problem", "silent"], VEHICLE_SILENT_S)


@each(
    "more",
    [
        {"failsafe": True},
        {"battery": {"percent": 9}},
        {"uplink": {"heard": False}},
        {"separation": {"level": "warning"}},
        {"connected": False},
        {"links": {}, "last_heartbeat_age_s": None},
    ],
)
def test_what_needs_a_person_is_a_problem(more: dict[str, Any]) -> None:
    assert digest(**more).matches(["problem"], 0.0)
    assert count_sites([digest(**more)], 0.0)[0]["problems"] == 1


def test_sites_are_counted_and_what_was_lost_in_the_air_stays_in_the_counts() -> None:
    on_ground = digest("south/b", armed=False, landed="on_ground")
    silent_on_ground = digest("south/d", -9.0, landed="on_ground")
    fleet = [digest("ours"), digest(), on_ground, digest("south/c", -9.0), silent_on_ground]
    ours, south = count_sites(fleet, 1.0)
    assert (ours["site"], ours["vehicles"], ours["problems"]) == ("", 1, 0)
    wanted = {"site": "south", "vehicles": 4, "heard": 2, "armed": 2, "in_air": 2, "problems": 2, "oldest_age_s": 10.2}
    assert south == wanted
    assert count_sites([digest(links={}, last_heartbeat_age_s=None)], 0.0)[0]["oldest_age_s"] is None


@each(
    "params",
    [
        {"sites": "north"},
        {"sites": [1]},
        {"sites": ["x"] * 65},
        {"search": None},
        {"search": "x" * 201},
        {"names": ["v"] * (MAX_NAMES + 1)},
        {"names": ["v" * 65]},
        {"names": {"v": 1}},
    ],
)
def test_a_view_that_cannot_be_is_refused(params: dict[str, Any]) -> None:
    with pytest.raises(RpcError):
        view_of(params)


def test_a_view_of_no_sites_is_not_one_of_all() -> None:
    assert view_of({}).wanted([digest()], 0.0)[0] == {"south/alpha"}
    assert view_of({"sites": []}).wanted([digest()], 0.0)[0] == set()
    assert view_of({"sites": [""]}).wanted([digest(), digest("ours")], 0.0)[0] == {"ours"}


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
KEYS = ("sysid", "compid", "autopilot", "mode", "groups", "connected", "last_heartbeat_age_s", "links", "armed")
KEYS += ("landed", "failsafe", "position", "battery", "uplink", "separation")


@given(st.one_of(st.binary(max_size=40), st.dictionaries(st.sampled_from(KEYS), json_values).map(json.dumps)))
def test_no_state_raises_and_every_row_is_json(body: bytes | str) -> None:
    read = digest_of("south/x", body.encode() if isinstance(body, str) else body, 0.0)
    assert len(json.loads(read.row)) in (13, 15)
    View(None, ("x",)).wanted([read], 1.0)
    count_sites([read], 1.0)
