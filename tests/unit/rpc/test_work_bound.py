"""The bound of orders to single vehicles that clients have in flight."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from skygcs.rpc.work_gate import JOIN_S, MAX_ITEMS, MAX_ITEMS_OF_A_CLIENT, MAX_SAME, TooMuchWork, Work, WorkBound

LARGEST_FLEET = 8160
CLIENTS = st.sampled_from(["greedy", "page", "script"])


class Calls(RuleBasedStateMachine):
    """Clients that order and get their answers in any order, beside an account that only adds up what is in flight."""

    @initialize()
    def start(self) -> None:
        self.bound = WorkBound()
        self.ordinary: list[Work] = []
        self.ending: list[Work] = []
        self.last_asked: Work | None = None
        self.now = 0.0

    @rule(client=CLIENTS, items=st.integers(1, LARGEST_FLEET) | st.integers(1, 60))
    def order(self, client: str, items: int) -> None:
        before = [work for work in self.ordinary if work.client == client]
        try:
            self.ordinary.append(self.bound.begin(client, "vehicles.mode", items))
            self.last_asked = self.ordinary[-1]
        except TooMuchWork:
            assert any(work.is_reserve for work in before), "a client's first call is refused"

    @rule(client=CLIENTS, what=st.sampled_from("ab"), after_s=st.floats(0, 1))
    def end_flight(self, client: str, what: str, after_s: float) -> None:
        self.now += after_s
        earlier = self.bound.to_join(what, self.bound.asked(self.now))
        if earlier is not None:
            assert earlier is self.ending[-1] and earlier is self.last_asked, "something was asked since"
            assert self.now - earlier.began.at_s <= JOIN_S
        wait_s = self.bound.wait_s(client, what, self.now)
        own = [work for work in self.ending if (work.client, work.same_as) == (client, what)]
        assert 0.0 <= wait_s <= JOIN_S and (wait_s == 0.0 or len(own) >= MAX_SAME)
        self.now += wait_s + 1e-9
        assert self.bound.wait_s(client, what, self.now) == 0.0
        self.last_asked = self.bound.begin_ending(client, 3, what, self.now)
        self.ending.append(self.last_asked)

    @rule(which=st.data())
    def answer(self, which: st.DataObject) -> None:
        works = which.draw(st.sampled_from([self.ordinary, self.ending]))
        if works:
            self.bound.end(works.pop(which.draw(st.integers(0, len(works) - 1))))

    @invariant()
    def is_never_above_the_bound(self) -> None:
        shared = Counter[object]()
        for work in self.ordinary:
            shared[work.client] += 0 if work.is_reserve else work.items
        assert shared.total() == self.bound.shared_items <= MAX_ITEMS
        assert all(items <= MAX_ITEMS_OF_A_CLIENT for items in shared.values())
        assert max(Counter(work.client for work in self.ordinary if work.is_reserve).values(), default=0) <= 1
        assert self.bound.items == sum(work.items for work in (*self.ordinary, *self.ending))
        for last in self.ending:
            same = [w for w in self.ending if (w.client, w.same_as) == (last.client, last.same_as)]
            assert sum(0.0 <= last.began.at_s - w.began.at_s < JOIN_S for w in same) <= MAX_SAME

    def teardown(self) -> None:
        for work in (*self.ordinary, *self.ending):
            self.bound.end(work)
        assert self.bound.items == 0
        assert self.bound.begin("greedy", "vehicles.mode", MAX_ITEMS_OF_A_CLIENT).is_reserve is False


TestCalls = Calls.TestCase


@given(st.lists(st.integers(1, LARGEST_FLEET), max_size=40))
def test_no_greed_of_others_refuses_the_first_call_of_a_client(greed: list[int]) -> None:
    bound = WorkBound()
    for number, items in enumerate(greed):
        for client in (f"greedy {number}", "greedy"):
            try:
                bound.begin(client, "preflight.run", items)
            except TooMuchWork:
                assert client == "greedy"
    bound.begin("page", "params.list", LARGEST_FLEET)


def test_a_refusal_gives_the_numbers_and_what_to_do() -> None:
    bound = WorkBound()
    for _ in range(3):
        bound.begin("greedy", "vehicles.mode", 236)
    with pytest.raises(TooMuchWork) as refused:
        bound.begin("greedy", "vehicles.mode", 236)
    assert "vehicles.mode to 236 vehicles was not carried out" in str(refused.value)
    assert "waits for 708 orders" in str(refused.value) and "at most 512 beside one call" in str(refused.value)
    for client, items in (("a", 500), ("b", 50), ("b", 60)):
        bound.begin(client, "vehicles.mode", items)
    with pytest.raises(TooMuchWork, match="all clients together for 1022 of at most 1024; wait for their answers"):
        bound.begin("b", "vehicles.mode", 60)


def test_small_calls_leave_the_reserve_for_a_large_one() -> None:
    bound = WorkBound()
    bound.begin("page", "params.get", 1)
    assert bound.begin("page", "params.list", LARGEST_FLEET).is_reserve


def hold(bound: WorkBound, now: float, client: str = "page") -> Work:
    return bound.begin_ending(client, 50, "all", now)


def test_the_same_hold_again_joins_only_what_is_in_force() -> None:
    bound = WorkBound()
    first = hold(bound, 0.0)
    assert bound.to_join("all", bound.asked(JOIN_S)) is first
    assert bound.to_join("others", bound.asked(JOIN_S)) is None
    assert bound.to_join("all", bound.asked(JOIN_S + 0.01)) is None
    bound.other_asked()  # a setpoint, for example
    asked = bound.asked(0.1)
    assert bound.to_join("all", asked) is None
    second = hold(bound, 0.2)
    bound.begin("script", "vehicles.goto", 1)
    assert bound.to_join("all", asked) is second, "it began after that one was asked"
    assert bound.to_join("all", bound.asked(0.2)) is None
    bound.end(second)
    assert bound.to_join("all", asked) is None


def test_many_of_the_same_hold_wait_half_a_second_and_those_of_a_person_do_not() -> None:
    bound = WorkBound()
    for _ in range(MAX_SAME):
        assert bound.wait_s("page", "all", 0.0) == 0.0
        hold(bound, 0.0)
    assert bound.wait_s("page", "all", 0.1) == pytest.approx(JOIN_S - 0.1)
    assert bound.wait_s("another client", "all", 0.1) == bound.wait_s("page", "others", 0.1) == 0.0
    for press in range(1, 30):
        assert bound.wait_s("page", "all", press * (JOIN_S + 0.01)) == 0.0
        hold(bound, press * (JOIN_S + 0.01))
