"""Each page gets each vehicle's newest state once, however slowly it reads."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from skygcs.web.state_batches import MAX_REMOVED, MAX_ROUND_S, SETTLE_S, LatestStates, PageStates


def test_a_page_begins_with_the_whole_fleet_and_then_gets_what_changed() -> None:
    states = LatestStates()
    states.put("a", b"a1", 0.0)
    states.put("b", b"b1", 0.0)
    states.end_round()
    page = PageStates(states, 10.0)
    assert page.batch(0.0) == (True, [b"a1", b"b1"], ())
    assert page.due_at() is None
    states.put("a", b"a2", 0.1)
    assert page.batch(0.1) == (False, [b"a2"], [])
    assert page.seq == 2


def test_a_slow_page_gets_the_newest_state_of_each_once() -> None:
    states, page = LatestStates(), None
    page = PageStates(states, 10.0)
    page.batch(0.0)
    for n in range(1000):
        for name in ("a", "b", "c"):
            states.put(name, f"{name}{n}".encode(), n)
    assert page.batch(1000.0) == (False, [b"a999", b"b999", b"c999"], [])


def test_a_forgotten_vehicle_is_reported_as_gone_and_may_come_back() -> None:
    states = LatestStates()
    page = PageStates(states, 10.0)
    states.put("a", b"a", 0.0)
    page.batch(0.0)
    states.remove("a")
    states.remove("never seen")
    assert page.batch(0.1) == (False, [], ["a"])
    assert page.due_at() is None
    states.put("a", b"a2", 0.2)
    assert page.batch(0.2) == (False, [b"a2"], [])


def test_what_the_daemon_no_longer_sends_is_forgotten() -> None:
    states = LatestStates()
    states.put("old", b"o", 0.0)
    states.put("new", b"n", 5.0)
    states.remove_older(2.0)
    assert PageStates(states, 1.0).batch(5.0) == (True, [b"n"], ())


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
    assert page.batch(0.0) == (True, [b"b"], ())


def test_a_fleet_without_a_vehicle_is_sent_when_that_is_known() -> None:
    states = LatestStates()
    page = PageStates(states, 0.2)
    assert page.due_at() is None
    states.settle()
    assert page.due_at() == float("-inf")
    assert page.batch(0.0) == (True, [], ())


def test_a_round_that_was_forgotten_completes_nothing() -> None:
    states = LatestStates()
    states.put("a", b"a", 1.0)
    states.reset()
    assert states.round_complete_at() is None


def test_the_list_of_forgotten_vehicles_is_bounded() -> None:
    states = LatestStates()
    page = PageStates(states, 1.0)
    page.batch(0.0)
    for n in range(MAX_REMOVED + 1):
        states.put(str(n), b"", 0.0)
        states.remove(str(n))
    full, changed, gone = page.batch(1.0)
    assert (full, changed, gone) == (True, [], ())


def test_a_page_gets_no_more_batches_than_it_wants() -> None:
    states = LatestStates()
    states.settle()
    page = PageStates(states, 2.0)
    page.batch(0.0)
    states.put("a", b"a", 0.1)
    assert page.due_at() == 0.25


def test_a_round_whose_end_is_marked_is_sent_then_and_not_when_it_is_quiet() -> None:
    states = LatestStates()
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


def test_a_round_is_sent_when_it_is_complete_and_no_later_than_its_limit() -> None:
    states = LatestStates()
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
        full, changed, gone = page.batch(0.0)
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
