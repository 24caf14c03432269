"""The home site's decision about orders of other stations: the rows of its table, its bounds, copies at any time."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.federation.protocol import order_gate
from skygcs.ext.federation.protocol.order_gate import (
    KEEP_S,
    MAX_AHEAD_S,
    MAX_ENDING,
    MAX_KEYS,
    MAX_RUNNING,
    MAX_STOPS,
    STOP_KEYS,
    STOP_LATE_S,
    Begin,
    Decision,
    OrderGate,
    Refuse,
    Remembered,
    Repeated,
)
from skygcs.ext.federation.protocol.order_messages import STOP, OrderReply, OrderRequest, OutcomeQuestion
from support.table import each

NOW = 1000.0


def key(number: int) -> str:
    return f"{number:032x}"


def order(number: int = 1, method: str = "vehicles.land", **changes: object) -> OrderRequest:
    request = OrderRequest(key(number), "alpha", method, {}, NOW + 1.0, "mia@south", "operator")
    return replace(request, **changes)  # type: ignore[arg-type]


def done(number: int = 1) -> OrderReply:
    return OrderReply(key(number), "done", "landing")


def status(decision: Decision) -> str:
    assert isinstance(decision, Refuse)
    return decision.reply.status


@pytest.fixture
def gate() -> OrderGate:
    return OrderGate("north", NOW)


def test_a_known_order_is_never_carried_out_again(gate: OrderGate) -> None:
    assert isinstance(gate.admit(order(), NOW), Begin)
    running = gate.admit(order(), NOW)
    assert isinstance(running, Repeated) and running.reply.status == "running"
    gate.ended(done(), NOW + 2.0)
    assert gate.admit(order(), NOW + 3.0) == Repeated(done())
    assert gate.asked(OutcomeQuestion(key(1)), NOW + 3.0) == done()


@each(
    ("request_", "not_held", "expected", "text"),
    [
        (order(role="observer"), None, "refused", "gives no orders"),
        (order(method="vehicles.forget"), None, "refused", "is not taken"),
        (order(method="plan.run"), None, "refused", "is not taken"),
        (order(params={"targets": "all"}), None, "refused", "names its vehicle"),
        (order(method="vehicles.goto", params={"enu_m": [0, 0, 5]}), None, "refused", "enu_m"),
        (order(method="vehicles.goto", params={"together": "all"}), None, "refused", "together"),
        (order(method="vehicles.arm", params={"wait_s": 30}), None, "refused", "wait_s"),
        (order(deadline_s=NOW + MAX_AHEAD_S + 0.1), None, "refused", "clocks disagree"),
        (order(deadline_s=NOW - 0.1), None, "late", "0.1 s after"),
        (order(method=STOP, deadline_s=NOW - STOP_LATE_S - 0.1), None, "late", "after its deadline"),
        (order(), "alpha is commanded by south", "refused", "by south"),
    ],
)
def test_what_is_refused(request_: OrderRequest, not_held: str | None, expected: str, text: str) -> None:
    gate = OrderGate("north", NOW)
    refused = gate.admit(request_, NOW, not_held=not_held)
    assert status(refused) == expected and isinstance(refused, Refuse) and text in refused.reply.text
    # a copy that comes when nothing stands against it any more is not carried out either
    assert gate.admit(order(), NOW) == Repeated(refused.reply)


def test_a_stop_needs_no_lease_and_may_be_late(gate: OrderGate) -> None:
    late_stop = order(method=STOP, deadline_s=NOW - STOP_LATE_S)
    assert isinstance(gate.admit(late_stop, NOW, not_held="south commands it"), Begin)


def test_what_was_asked_for_before_it_came_never_comes(gate: OrderGate) -> None:
    assert gate.asked(OutcomeQuestion(key(1)), NOW).status == "never came"
    refused = gate.admit(order(), NOW)
    assert isinstance(refused, Repeated) and refused.reply.status == "refused"


def test_an_order_does_not_overtake_a_newer_one_of_its_station(gate: OrderGate) -> None:
    assert isinstance(gate.admit(order(2, method="vehicles.hold", run="r", seq=2), NOW), Begin)
    assert status(gate.admit(order(1, method="vehicles.goto", run="r", seq=1), NOW)) == "refused"
    assert isinstance(gate.admit(order(3, run="other", seq=1), NOW), Begin)
    assert isinstance(gate.admit(order(4, run="r", seq=1, vehicle="bravo"), NOW), Begin)
    assert isinstance(gate.admit(order(5, method=STOP, run="r", seq=1), NOW), Begin)


def test_orders_that_end_a_flight_have_places_of_their_own(gate: OrderGate) -> None:
    for number in range(MAX_RUNNING * 4 // 5):
        assert isinstance(gate.admit(order(number, method="vehicles.goto"), NOW), Begin)
    assert status(gate.admit(order(MAX_RUNNING, method="vehicles.goto"), NOW)) == "refused"
    assert isinstance(gate.admit(order(MAX_RUNNING + 1, method="vehicles.land"), NOW), Begin)
    gate.ended(OrderReply(key(0), "done", ""), NOW)
    assert isinstance(gate.admit(order(MAX_RUNNING + 2, method="vehicles.goto"), NOW), Begin)


def test_no_flood_of_other_orders_and_questions_keeps_a_stop_out(gate: OrderGate) -> None:
    for number in range(MAX_ENDING * 4 // 5):
        assert isinstance(gate.admit(order(number, method="vehicles.land"), NOW), Begin)
    assert status(gate.admit(order(MAX_ENDING, method="vehicles.rtl"), NOW)) == "refused"
    for number in range(MAX_ENDING + 1, 2 * MAX_KEYS):
        gate.asked(OutcomeQuestion(key(number)), NOW)
    for number in range(2 * MAX_KEYS, 2 * MAX_KEYS + MAX_STOPS * 4 // 5):
        assert isinstance(gate.admit(order(number, method=STOP), NOW), Begin)
    assert status(gate.admit(order(2 * MAX_KEYS + MAX_STOPS, method=STOP), NOW)) == "refused"
    gate.ended(OrderReply(key(2 * MAX_KEYS), "done", ""), NOW)
    assert isinstance(gate.admit(order(2 * MAX_KEYS + MAX_STOPS + 1, method=STOP), NOW), Begin)


def test_a_full_table_forgets_nothing_that_may_still_come(gate: OrderGate) -> None:
    for number in range(MAX_KEYS):
        gate.admit(order(number, role="observer"), NOW)
    assert len(gate) == MAX_KEYS * 4 // 5
    begun = order(MAX_KEYS + 1, deadline_s=NOW + 2.0)
    assert status(gate.admit(begun, NOW)) == "refused"
    stop = order(MAX_KEYS + 2, method=STOP)
    assert isinstance(gate.admit(stop, NOW), Begin)
    assert gate.asked(OutcomeQuestion(key(MAX_KEYS + 3)), NOW).status == "never came"
    assert isinstance(gate.admit(order(MAX_KEYS + 5, deadline_s=NOW + 2.0, sender="another"), NOW), Begin)
    # places become free; the order that was refused without a record is still not carried out
    later = NOW + 1.0 + STOP_LATE_S + 0.1
    assert status(gate.admit(begun, NOW + 1.5)) == "refused"
    assert isinstance(gate.admit(order(MAX_KEYS + 4, deadline_s=later + 1.0), later), Begin)
    assert len(gate) <= MAX_KEYS + STOP_KEYS


def test_stops_have_a_bound_as_well(gate: OrderGate) -> None:
    for number in range(2 * MAX_KEYS):
        gate.admit(order(number, method=STOP), NOW)
        gate.ended(OrderReply(key(number), "done", ""), NOW)
    assert len(gate) == STOP_KEYS // 2


def test_no_station_keeps_the_stops_of_another_out(gate: OrderGate) -> None:
    """Nor do two of them: 3,000 stops a second of each, none of which ends, and other orders and questions as well."""
    number = 0
    for station in range(2):
        for method in (STOP, "vehicles.land", "vehicles.goto"):
            for _ in range(3000):
                number += 1
                gate.admit(order(number, method=method, sender=f"hostile {station}"), NOW)
        gate.asked(OutcomeQuestion(key(number + 1_000_000)), NOW)
    for method in (STOP, "vehicles.land", "vehicles.goto"):
        assert isinstance(gate.admit(order(number + 1, method=method, sender="mia"), NOW), Begin), method
        number += 1
    assert len(gate) <= MAX_KEYS + STOP_KEYS


def test_outcomes_are_forgotten_after_an_hour_and_the_site_says_so(gate: OrderGate) -> None:
    gate.admit(order(), NOW)
    gate.ended(done(), NOW)
    gate.admit(order(2, deadline_s=NOW + KEEP_S), NOW + KEEP_S)
    assert gate.asked(OutcomeQuestion(key(1), deadline_s=NOW + 1.0), NOW + KEEP_S).status == "unknown"
    assert gate.asked(OutcomeQuestion(key(7), deadline_s=NOW + 2 * KEEP_S), NOW + 2 * KEEP_S).status == "never came"


def test_keys_and_their_order_outlive_a_restart(gate: OrderGate) -> None:
    running = OrderReply(key(1), "running", "")
    numbered = [
        Remembered(running, NOW, NOW, "alpha", "r", 5),
        Remembered(done(), NOW, NOW, "alpha", "r", 5),
        Remembered(OrderReply(key(2), "running", ""), NOW, NOW),
    ]
    gate.restore(numbered, complete=True)
    assert gate.admit(order(1), NOW) == Repeated(done())
    assert gate.asked(OutcomeQuestion(key(2)), NOW).status == "unknown"
    assert status(gate.admit(order(3, run="r", seq=4), NOW)) == "refused"
    assert isinstance(gate.admit(order(4, run="r", seq=6), NOW), Begin)


def test_without_a_memory_only_stops_are_taken_until_older_orders_are_late() -> None:
    gate = OrderGate("north", NOW, no_order_before_s=NOW + MAX_AHEAD_S)
    assert status(gate.admit(order(1), NOW)) == "refused"
    assert isinstance(gate.admit(order(2, method=STOP), NOW), Begin)
    assert isinstance(gate.admit(order(3, deadline_s=NOW + MAX_AHEAD_S + 1.0), NOW + MAX_AHEAD_S), Begin)


@given(seed=st.integers(0, 2**32))
def test_copies_at_any_time_are_carried_out_once(seed: int) -> None:
    """Orders, copies of them, questions and restarts in any order, with a table of eight places. What was refused or
    asked for in vain is not carried out later."""
    rng = random.Random(seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(order_gate, "MAX_KEYS", 8)
        patch.setattr(order_gate, "STOP_KEYS", 2)
        gate, now, since = OrderGate("north", NOW), NOW, NOW
        carried: dict[str, int] = {}
        denied: set[str] = set()
        sent: list[OrderRequest] = []
        for number in range(60):
            now += rng.choice((0.0, 0.1, 1.0, 7.0))
            if sent and rng.random() < 0.5:
                request = rng.choice(sent[-12:])
            else:
                method = rng.choice((STOP, "vehicles.goto", "vehicles.land"))
                request = order(number, method=method, deadline_s=now + rng.choice((-1.0, 0.5, 9.0)))
                sent.append(request)
            if rng.random() < 0.2:
                asked = gate.asked(OutcomeQuestion(request.key), now)
                if asked.status == "never came" and request.deadline_s >= since:
                    assert request.key not in carried or now > request.deadline_s
                    denied.add(request.key)
                continue
            decision = gate.admit(request, now, not_held=rng.choice((None, None, "south commands it")))
            if isinstance(decision, Begin):
                assert request.key not in denied
                carried[request.key] = carried.get(request.key, 0) + 1
                if rng.random() < 0.7:
                    gate.ended(OrderReply(request.key, "done", ""), now)
            elif decision.reply.status in ("refused", "late") and request.key not in carried:
                denied.add(request.key)
            assert len(gate) <= 10 + sum(map(len, gate._running.values()))
        assert all(count == 1 for count in carried.values())


def test_a_station_cannot_overtake_the_orders_of_another_by_the_name_of_its_run(gate: OrderGate) -> None:
    hostile = order(1, run="run of mia", seq=1 << 53, sender="key of eve")
    assert isinstance(gate.admit(hostile, NOW), Begin)
    mine = order(2, run="run of mia", seq=7, sender="key of mia")
    assert isinstance(gate.admit(mine, NOW), Begin)
    older = order(3, run="run of mia", seq=6, sender="key of mia")
    assert status(gate.admit(older, NOW)) == "refused"
    # and the same after a restart of the bridge
    again = OrderGate("north", NOW)
    again.restore([Remembered(done(1), NOW + 1, NOW, "alpha", "run of mia", 1 << 53, "key of eve")], complete=True)
    assert isinstance(again.admit(mine, NOW), Begin)


# Limits, each from both sides


def test_a_deadline_may_be_as_far_ahead_as_clocks_differ_and_an_order_as_late_as_its_deadline() -> None:
    for deadline_s, method, begins in (
        (NOW + MAX_AHEAD_S, "vehicles.land", True),
        (NOW + MAX_AHEAD_S + 0.125, "vehicles.land", False),
        (NOW, "vehicles.land", True),
        (NOW - 0.125, "vehicles.land", False),
        (NOW - STOP_LATE_S, STOP, True),
        (NOW - STOP_LATE_S - 0.125, STOP, False),
    ):
        decision = OrderGate("north", NOW).admit(order(method=method, deadline_s=deadline_s), NOW)
        assert isinstance(decision, Begin) is begins, (deadline_s, method)
    ahead = OrderGate("north", NOW).admit(order(deadline_s=NOW + MAX_AHEAD_S + 3.0), NOW)
    assert isinstance(ahead, Refuse) and f"is {MAX_AHEAD_S + 3:.0f} s ahead" in ahead.reply.text
    gate = OrderGate("north", NOW, no_order_before_s=NOW + 1.0)
    assert status(gate.admit(order(1, deadline_s=NOW + 1.0), NOW)) == "refused"
    assert isinstance(gate.admit(order(2, deadline_s=NOW + 1.125), NOW), Begin)


def test_only_a_lower_number_of_the_same_series_is_overtaken(gate: OrderGate) -> None:
    assert isinstance(gate.admit(order(1, run="r", seq=2), NOW), Begin)
    for number, seq, begins in ((2, 1, False), (3, 2, True), (4, 0, True), (5, 3, True), (6, 2, False)):
        assert isinstance(gate.admit(order(number, run="r", seq=seq), NOW), Begin) is begins, seq


def test_numbers_of_the_series_that_were_noted_last_are_kept() -> None:
    newest = order_gate._NewestOrders()
    for number in range(MAX_KEYS):
        newest.note(("sender", "run", str(number)), number + 1)
    newest.note(("sender", "run", "0"), 0)  # a lower number changes nothing, but it is the latest now
    assert newest.of(("sender", "run", "0")) == 1
    newest.note(("sender", "run", "another"), 5)
    kept = [newest.of(("sender", "run", name)) for name in ("0", "1", "2", "another", "unknown")]
    assert kept == [1, 0, 3, 5, 0]


def test_every_decision_is_counted(gate: OrderGate) -> None:
    gate.admit(order(1), NOW)
    gate.admit(order(1), NOW)
    gate.admit(order(2, deadline_s=NOW - 1.0), NOW)
    gate.admit(order(3, role="observer"), NOW)
    gate.ended(done(1), NOW)
    gate.ended(done(1), NOW)  # it has ended already
    gate.ended(done(9), NOW)
    gate.asked(OutcomeQuestion(key(1)), NOW)
    counted = {"running": 1, "repeated": 1, "late": 1, "refused": 1, "done": 1, "asked": 1}
    assert gate.counters == counted
    assert gate.known(key(1)) == done(1) and gate.known(key(9)) is None
    gate.admit(order(4, role="observer"), NOW + KEEP_S)
    assert gate.counters == counted | {"refused": 2, "forgotten": 3}


def test_an_outcome_is_kept_for_an_hour_from_its_end_and_what_runs_for_as_long_as_it_does(gate: OrderGate) -> None:
    gate.admit(order(1), NOW)
    gate.ended(done(1), NOW + 2.0)
    gate.admit(order(2, deadline_s=NOW + KEEP_S + 1.5, role="observer"), NOW + KEEP_S + 1.5)
    assert gate.known(key(1)) == done(1)
    gate.admit(order(3, deadline_s=NOW + KEEP_S + 2.0, role="observer"), NOW + KEEP_S + 2.0)
    assert gate.known(key(1)) is None and gate.known(key(2)) is not None
    gate = OrderGate("north", NOW)
    gate.admit(order(1), NOW)
    gate.asked(OutcomeQuestion(key(9)), NOW + 2 * KEEP_S)
    running = gate.known(key(1))
    assert running is not None and running.status == "running"


def test_never_came_is_said_only_of_the_time_that_is_remembered() -> None:
    def asked(gate: OrderGate, deadline_s: float | None, now_s: float = NOW + 5.0) -> OrderReply:
        return gate.asked(OutcomeQuestion(key(7), deadline_s=deadline_s), now_s)

    unknown = asked(OrderGate("north", NOW), NOW + MAX_AHEAD_S)
    assert (unknown.status, unknown.text) == ("unknown", "north remembers orders of the last 5 s only")
    never = asked(OrderGate("north", NOW), NOW + MAX_AHEAD_S + 0.125)
    assert never.status == "never came"
    assert never.text == "no such order has come to north in the last 5 s; it is refused if it comes now"
    assert asked(OrderGate("north", NOW), None).status == "never came"

    whole = OrderGate("north", NOW)
    whole.restore([], complete=True)
    assert asked(whole, NOW - KEEP_S).text == "no such order has come to north; it is refused if it comes now"
    whole.forget_before(NOW + 1.0)
    assert "in the last 4 s" in asked(whole, None).text or asked(whole, NOW).status == "never came"

    for complete, status_ in ((True, "never came"), (False, "unknown")):
        gate = OrderGate("north", NOW)
        gate.restore([Remembered(done(1), NOW - 60.0, NOW - 60.0)], complete=complete)
        assert gate.counters["restored"] == 1
        assert asked(gate, NOW - 60.0 + MAX_AHEAD_S).status == status_
        assert asked(gate, NOW - 59.0 + MAX_AHEAD_S).status == "never came"


def test_a_full_table_gives_up_the_oldest_that_cannot_come_any_more() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(order_gate, "MAX_KEYS", 3)
        patch.setattr(order_gate, "STOP_KEYS", 0)
        for late_s, begins in ((0.0, False), (0.125, True)):
            gate = OrderGate("north", NOW)
            assert isinstance(gate.admit(order(1), NOW), Begin)  # it runs: it stays
            for number in (2, 3):
                gate.admit(order(number, role="observer"), NOW)
            now = NOW + 1.0 + STOP_LATE_S + late_s
            assert isinstance(gate.admit(order(4, deadline_s=now), now), Begin) is begins
            assert (gate.known(key(2)) is None) is begins
            assert gate.known(key(1)) is not None and gate.known(key(3)) is not None


def test_a_full_table_keeps_what_was_asked_or_restored_until_it_cannot_come_any_more() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(order_gate, "MAX_KEYS", 3)
        patch.setattr(order_gate, "STOP_KEYS", 0)
        for asked, may_come_s in ((True, MAX_AHEAD_S + STOP_LATE_S), (False, 1.0 + STOP_LATE_S)):
            for late_s, gone in ((0.0, False), (0.125, True)):
                gate = OrderGate("north", NOW)
                if asked:
                    assert gate.asked(OutcomeQuestion(key(1)), NOW).status == "never came"
                else:
                    gate.restore([Remembered(done(), NOW + 1.0, NOW)], complete=True)
                for number in (2, 3):  # they run: they stay
                    assert isinstance(gate.admit(order(number), NOW), Begin)
                now = NOW + may_come_s + late_s
                assert isinstance(gate.admit(order(4, deadline_s=now), now), Begin) is gone, (asked, late_s)
                assert (gate.known(key(1)) is None) is gone


def test_a_restored_table_is_bounded_and_its_latest_record_of_an_order_counts() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(order_gate, "MAX_KEYS", 2)
        gate = OrderGate("north", NOW)
        records = [Remembered(done(number), NOW, NOW - 100.0 + number) for number in (1, 2, 1, 3)]
        gate.restore(records, complete=False)
        assert [gate.known(key(number)) is not None for number in (1, 2, 3)] == [True, False, True]
        assert gate.counters == {"forgotten": 1, "restored": 2}
    gate = OrderGate("north", NOW)
    gate.restore([Remembered(OrderReply(key(1), "running", ""), NOW, NOW, "alpha", "r", 5)], complete=True)
    reply = gate.known(key(1))
    assert reply is not None and reply.text == "north restarted while it was carried out; look at the vehicle"
