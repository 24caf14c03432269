"""What a site sends: everything shared that its daemon has, as old as it is."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.federation.protocol.fair_share import FairShare
from skygcs.ext.federation.protocol.own_states import OwnStates
from skygcs.ext.federation.protocol.state_batch import MAX_VEHICLES_OF_SITE, RowLease, VehicleRow
from support.table import each


def state(sysid: int, **more: Any) -> dict[str, Any]:
    return {"name": f"v{sysid}", "sysid": sysid, "compid": 1, "connected": True, "last_heartbeat_age_s": 0.25, **more}


def own(*share: str) -> OwnStates:
    return OwnStates("north", "r1", 0.1, share or ("all",))


def sent(states: OwnStates, now: float, **more: Any) -> dict[str, VehicleRow]:
    batch = states.batch(now, 1000.0 + now, None, daemon=True, **more)
    return {row.name: row for row in batch.vehicles}


def give_round(states: OwnStates, now: float, *sysids: int) -> None:
    for sysid in sysids:
        states.put(state(sysid), now)
    states.end_round(now)


def test_a_state_is_as_old_as_it_was_and_has_waited() -> None:
    states = own()
    give_round(states, 5.0, 1)
    assert sent(states, 5.5)["v1"].age_s == 0.75
    assert [states.batch(6.0, 0.0, None, daemon=True).seq for _ in range(2)] == [2, 3]


def test_a_daemon_that_stands_still_has_vehicles_that_grow_old_and_are_then_not_heard() -> None:
    states = own()
    give_round(states, 0.0, 1, 2)
    later = sent(states, 9.9)
    assert later["v1"].heard and later["v1"].age_s == 10.15
    last = sent(states, 60.0)
    assert set(last) == {"v1", "v2"} and not last["v1"].heard and last["v1"].age_s == 60.25


def test_a_vehicle_that_the_daemon_has_forgotten_goes_with_its_rounds() -> None:
    states = own()
    give_round(states, 0.0, 1, 2)
    for tenth in range(1, 30):
        give_round(states, tenth / 10, 1)
    assert set(sent(states, 2.95)) == {"v1", "v2"}
    for tenth in range(30, 33):
        give_round(states, tenth / 10, 1)
    assert set(sent(states, 3.2)) == {"v1"}


def test_another_daemons_vehicles_are_those_of_its_first_round() -> None:
    states = own()
    give_round(states, 0.0, 1, 2)
    states.begin_anew(1.0)
    assert set(sent(states, 1.0)) == {"v1", "v2"}  # no gap between the two
    give_round(states, 1.1, 2, 3)
    assert set(sent(states, 1.1)) == {"v2", "v3"}
    states.begin_anew(2.0)  # this one has none, and sends no round
    assert set(sent(states, 4.9)) == {"v2", "v3"}
    assert sent(states, 5.1) == {}


def test_only_shared_vehicles_are_sent_and_a_share_may_name_one_that_comes_later() -> None:
    states = own("2-3", "scouts")
    give_round(states, 0.0, 1, 2)
    assert set(sent(states, 0.0)) == {"v2"}
    states.put(state(3), 0.1)
    states.put(state(9, groups=["scouts"]), 0.1)
    assert set(sent(states, 0.1)) == {"v2", "v3", "v9"}
    states.put(state(9), 0.2)  # no longer of the group
    assert set(sent(states, 0.2)) == {"v2", "v3"}
    assert not states.shares("v1") and not states.shares("nobody")


def test_leases_are_those_at_the_moment_of_sending() -> None:
    states = own()
    give_round(states, 0.0, 1, 2)
    rows = sent(states, 0.0, lease_of=lambda name: RowLease("south", 4, 2.5) if name == "v2" else None)
    assert rows["v1"].lease is None and rows["v2"].lease == RowLease("south", 4, 2.5)


def test_it_keeps_no_more_vehicles_than_a_batch_may_have_and_counts_what_it_leaves_out() -> None:
    states = own()
    for i in range(MAX_VEHICLES_OF_SITE + 5):
        states.put(state(i % 250 + 1, compid=i // 250 + 1, name=f"n{i}"), 0.0)
    states.put(state(1, name="a/b"), 0.0)
    assert len(sent(states, 0.0)) == MAX_VEHICLES_OF_SITE
    assert states.counters == {"vehicles_beyond_limit": 5, "states_unusable": 1}


# -- The places of one pool among senders.


def fill(pool: FairShare, *senders: str) -> None:
    """Each takes what it may, in turns."""
    while any(pool.has_room(sender) for sender in senders):
        for sender in senders:
            if pool.has_room(sender):
                pool.take(sender)


@each("factor", [1.0, 4.0])
@each("greedy", [1, 2, 5])
def test_greedy_senders_leave_places_for_one_that_comes_later(factor: float, greedy: int) -> None:
    pool = FairShare(1000, factor)
    senders = [f"s{n}" for n in range(greedy)]
    fill(pool, *senders)
    for sender in senders:
        assert pool.of(sender) == pytest.approx(1000 * factor / (1 + greedy * factor), abs=factor + 1)
    assert pool.places - len(pool) >= 1000 / (1 + greedy * factor) - greedy - 1
    assert pool.has_room("late")


@given(st.lists(st.tuples(st.integers(0, 4), st.booleans()), max_size=300))
def test_it_never_gives_more_than_it_has_and_counts_right(steps: list[tuple[int, bool]]) -> None:
    pool, taken = FairShare(20, 4.0), dict.fromkeys(map(str, range(5)), 0)
    for number, back in steps:
        sender = str(number)
        if back and taken[sender]:
            pool.give_back(sender)
            taken[sender] -= 1
        elif not back and pool.has_room(sender):
            pool.take(sender)
            taken[sender] += 1
        assert len(pool) == sum(taken.values()) <= 20
        assert all(pool.of(sender) == count for sender, count in taken.items())
