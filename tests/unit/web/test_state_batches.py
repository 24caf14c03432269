"""Each page gets each vehicle's newest state once, however slowly it reads."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.web.fleet_digest import LARGE_FLEET, MAX_FULL, SMALL_AGAIN, View
from skygcs.web.state_batches import BRIEF_EVERY_S, MAX_REMOVED, MAX_ROUND_S, SETTLE_S, Batch, LatestStates, PageStates


@pytest.fixture
def states() -> LatestStates:
    return LatestStates()


def test_a_page_begins_with_the_whole_fleet_and_then_gets_what_changed(states: LatestStates) -> None:
    states.put("a", b"a1", 0.0)
    states.put("b", b"b1", 0.0)
    states.end_round()
    page = PageStates(states, 10.0)
    assert page.batch(0.0)[:3] == (True, [b"a1", b"b1"], [])
    assert page.due_at() is None
    states.put("a", b"a2", 0.1)
    assert page.batch(0.1)[:3] == (False, [b"a2"], [])
    assert page.seq == 2


def test_a_slow_page_gets_the_newest_state_of_each_once() -> None:
    states, page = LatestStates(), None
    page = PageStates(states, 10.0)
    page.batch(0.0)
    for n in range(1000):
        for name in ("a", "b", "c"):
            states.put(name, f"{name}{n}".encode(), n)
    assert page.batch(1000.0)[:3] == (False, [b"a999", b"b999", b"c999"], [])


def test_a_forgotten_vehicle_is_reported_as_gone_and_may_come_back(states: LatestStates) -> None:
    page = PageStates(states, 10.0)
    states.put("a", b"a", 0.0)
    page.batch(0.0)
    states.remove("a")
    states.remove("never seen")
    assert page.batch(0.1)[:3] == (False, [], ["a"])
    assert page.due_at() is None
    states.put("a", b"a2", 0.2)
    assert page.batch(0.2)[:3] == (False, [b"a2"], [])


def test_what_the_daemon_no_longer_sends_is_forgotten(states: LatestStates) -> None:
    states.put("old", b"o", 0.0)
    states.put("new", b"n", 5.0)
    states.remove_older(2.0)
    assert PageStates(states, 1.0).batch(5.0)[:3] == (True, [b"n"], [])


def test_after_a_reset_nothing_is_sent_until_the_fleet_is_known_and_then_all_of_it_at_once() -> None:
    states = LatestStates()
    page = PageStates(states, 0.2)
    states.put("a", b"a", 0.0)
    states.end_round()
    page.batch(0.0)
    states.reset()
    assert page.due_at() is None
    states.put("b", b"b", 0.0)
    assert page.due_at() is None
    states.end_round()
    assert page.due_at() == float("-inf")
    assert page.batch(0.0)[:3] == (True, [b"b"], [])


def test_a_fleet_without_a_vehicle_is_sent_when_that_is_known(states: LatestStates) -> None:
    page = PageStates(states, 0.2)
    assert page.due_at() is None
    states.settle()
    assert page.due_at() == float("-inf")
    assert page.batch(0.0)[:3] == (True, [], [])


def test_a_round_that_was_forgotten_completes_nothing(states: LatestStates) -> None:
    states.put("a", b"a", 1.0)
    states.reset()
    assert states.round_complete_at() is None


def test_the_list_of_forgotten_vehicles_is_bounded(states: LatestStates) -> None:
    page = PageStates(states, 1.0)
    page.batch(0.0)
    for n in range(MAX_REMOVED + 1):
        states.put(str(n), b"", 0.0)
        states.remove(str(n))
    assert page.batch(1.0)[:3] == (True, [], [])


def test_a_page_gets_no_more_batches_than_it_wants(states: LatestStates) -> None:
    states.settle()
    page = PageStates(states, 2.0)
    page.batch(0.0)
    states.put("a", b"a", 0.1)
    assert page.due_at() == 0.25


def test_a_round_whose_end_is_marked_is_sent_then_and_not_when_it_is_quiet(states: LatestStates) -> None:
    states.put("a", b"a", 1.0)
    states.complete_round()
    assert states.round_complete_at() == 1.0
    states.end_round()
    states.put("a", b"a", 2.0)
    assert states.round_complete_at() == 2.0 + MAX_ROUND_S
    states.put("b", b"b", 2.001)
    states.complete_round()
    assert states.round_complete_at() == 2.001
    states.reset()  # another daemon may mark none
    states.put("a", b"a", 3.0)
    assert states.round_complete_at() == 3.0 + SETTLE_S


def test_a_round_is_sent_when_it_is_complete_and_no_later_than_its_limit(states: LatestStates) -> None:
    assert states.round_complete_at() is None
    states.put("a", b"a", 1.0)
    assert states.round_complete_at() == 1.0 + SETTLE_S
    for n in range(100):
        states.put("b", b"b", 1.0 + n * 0.001)
    assert states.round_complete_at() == 1.0 + MAX_ROUND_S
    states.end_round()
    assert states.round_complete_at() is None


Change = st.tuples(st.sampled_from(["put", "remove", "reset", "read one", "read two"]), st.sampled_from("abcd"))


@given(st.lists(Change, max_size=80))
def test_pages_of_any_speed_end_up_with_the_same_fleet(changes: list[tuple[str, str]]) -> None:
    states = LatestStates()
    pages = [(PageStates(states, 10.0), {}), (PageStates(states, 1.0), {})]
    fleet: dict[str, bytes] = {}

    def read(page: PageStates, seen: dict[str, bytes]) -> None:
        full, changed, gone = page.batch(0.0)[:3]
        if full:
            seen.clear()
        for body in changed:
            seen[body.decode()[0]] = body
        for name in gone:
            seen.pop(name, None)

    for number, (what, name) in enumerate(changes):
        if what == "put":
            fleet[name] = f"{name}{number}".encode()
            states.put(name, fleet[name], float(number))
        elif what == "remove":
            fleet.pop(name, None)
            states.remove(name)
        elif what == "reset":
            fleet.clear()
            states.reset()
        else:
            read(*pages[what == "read two"])
    for page, seen in pages:
        read(page, seen)
        assert seen == fleet


def state(name: str, **more: Any) -> bytes:
    vehicle = {"name": name, "sysid": 1, "connected": True, "last_heartbeat_age_s": 0.1, "links": {}, "groups": []}
    return json.dumps(vehicle | more).encode()


def large_fleet(at: float = 0.0) -> LatestStates:
    """Two sites of 150 each, and one of ours."""
    states = LatestStates()
    for name in ("ours", *(f"{site}/v{n}" for site in ("north", "south") for n in range(150))):
        states.put(name, state(name), at)
    states.end_round()
    return states


def names_of(batch: Batch) -> tuple[set[str], set[str]]:
    """Those in full, those in brief."""
    return {json.loads(body)["name"] for body in batch.states}, {json.loads(row)[0] for row in batch.brief or ()}


def test_of_a_large_fleet_a_page_gets_in_full_what_it_shows_and_the_rest_in_brief_with_counts() -> None:
    page = PageStates(large_fleet(), 10.0)
    page.show(View(frozenset({"north"}), names=frozenset({"south/v7"})))
    batch = page.batch(0.0)
    full, brief = names_of(batch)
    assert full == {f"north/v{n}" for n in range(150)} | {"south/v7"}
    assert brief == {f"south/v{n}" for n in range(150)} - {"south/v7"} | {"ours"}
    expected = [("", 1, 1), ("north", 150, 150), ("south", 150, 150)]
    assert [(of["site"], of["vehicles"], of["heard"]) for of in batch.sites or ()] == expected


def test_what_leaves_the_view_is_sent_in_brief_at_once_and_what_enters_it_in_full() -> None:
    """Otherwise a page would keep its last state and show it as one that is not heard any more."""
    states = large_fleet()
    page = PageStates(states, 10.0)
    page.show(View(frozenset({"north"})))
    page.batch(0.0)
    page.show(View(frozenset({"south"})))
    assert page.due_at() == float("-inf")
    batch = page.batch(0.01)
    assert names_of(batch) == ({f"south/v{n}" for n in range(150)}, {f"north/v{n}" for n in range(150)})
    assert batch.sites is None and page.due_at() is None


def test_briefs_and_counts_come_once_a_second_and_only_of_what_has_changed() -> None:
    states = large_fleet()
    page = PageStates(states, 10.0)
    page.show(View(frozenset()))
    page.batch(0.0)
    states.put("north/v3", state("north/v3", armed=True), 0.5)
    states.remove("south/v1")
    batch = page.batch(0.5)
    assert names_of(batch) == (set(), set()) and batch.gone == ["south/v1"] and batch.sites is None
    states.put("north/v3", state("north/v3", armed=True), 1.1)
    batch = page.batch(BRIEF_EVERY_S + 0.1)
    assert names_of(batch) == (set(), {"north/v3"})
    assert [of["armed"] for of in batch.sites or ()] == [0, 1, 0]


def test_more_than_a_page_can_show_is_said_to_be_left_out_and_what_is_selected_is_not() -> None:
    page = PageStates(large_fleet(), 10.0)
    page.show(View(None, names=frozenset({"south/v149"})))
    batch = page.batch(0.0)
    full, _ = names_of(batch)
    assert len(full) == MAX_FULL and "south/v149" in full and batch.left_out == 301 - MAX_FULL


def test_a_fleet_that_grows_large_or_small_begins_every_page_anew(states: LatestStates) -> None:
    for n in range(LARGE_FLEET):
        states.put(f"v{n}", state(f"v{n}"), 0.0)
    states.end_round()
    page = PageStates(states, 10.0)
    assert page.batch(0.0).brief is None
    states.put("one more", state("one more"), 0.1)
    states.end_round()
    batch = page.batch(0.1)
    assert batch.full and batch.brief is not None
    states.remove("one more")
    states.end_round()
    assert not page.batch(0.2).full  # one that comes and goes changes nothing
    for n in range(LARGE_FLEET - SMALL_AGAIN):
        states.remove(f"v{n}")
    states.end_round()
    assert page.batch(0.3).brief is None


Level = st.sampled_from(["put", "put", "remove", "show one", "show none", "read"])


@given(st.lists(st.tuples(Level, st.integers(0, 205), st.floats(0.0, 0.7)), max_size=60))
def test_whatever_happens_a_page_knows_each_vehicle_once_and_none_in_full_that_it_is_not_sent(
    changes: list[tuple[str, int, float]],
) -> None:
    states = LatestStates()
    fleet: dict[str, int] = {}
    for n in range(206):
        states.put(f"v{n}", state(f"v{n}", sysid=n), 0.0)
        fleet[f"v{n}"] = 0
    states.end_round()
    page = PageStates(states, 10.0)
    page.show(View(frozenset()))
    seen: dict[str, str] = {}
    now, wanted = 0.0, set[str]()

    def read() -> None:
        batch = page.batch(now)
        if batch.full:
            seen.clear()
        assert batch.brief is not None
        full, brief = names_of(batch)
        assert not full & brief
        seen.update(dict.fromkeys(full, "full") | dict.fromkeys(brief, "brief"))
        for name in batch.gone:
            seen.pop(name, None)

    for what, n, passed_s in changes:
        now += passed_s
        name = f"v{n}"
        if what == "put":
            states.put(name, state(name), now)
            fleet[name] = 1
        elif what == "remove" and len(fleet) > SMALL_AGAIN + 1:
            fleet.pop(name, None)
            states.remove(name)
        elif what.startswith("show"):
            wanted = {name} if what == "show one" else set()
            page.show(View(frozenset(), names=frozenset(wanted)))
        else:
            read()
    now += BRIEF_EVERY_S
    read()
    assert set(seen) == set(fleet)
    assert {name for name, level in seen.items() if level == "full"} == wanted & set(fleet)
