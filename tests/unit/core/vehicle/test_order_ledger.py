"""Which of the orders to a vehicle counts, and whether one of them may have armed it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.flight_evidence import RECENTLY_ARMED_S
from skygcs.core.vehicle.order_ledger import MOST_TOLD, ClientIdentity, OrderLedger, StreamOwner, may_have_effect

DONE = Outcome(True, "accepted", "")
LOST = Outcome(False, "timeout", "", attempts=5)
DENIED = Outcome(False, "denied", "", attempts=1)
FIRST = 1000


@pytest.mark.parametrize(
    ("result", "attempts", "may"),
    [
        *((refusal, 1, False) for refusal in ("temporarily_rejected", "denied", "unsupported", "failed")),
        ("refused", 1, False),
        ("timeout", 1, True),
        ("lost", 1, True),
        ("cancelled", 1, True),
        ("timeout", 0, False),
        ("lost", 0, False),
        ("cancelled", 0, False),
    ],
)
def test_an_order_may_have_an_effect_unless_it_was_not_sent_or_is_refused(
    result: str, attempts: int, may: bool
) -> None:
    assert may_have_effect(Outcome(False, result, "", attempts)) is may
    assert may_have_effect(None) and may_have_effect(Outcome(True, "accepted", ""))


def test_an_order_that_is_refused_counts_while_it_is_in_progress_only() -> None:
    ledger = OrderLedger(FIRST)
    assert ledger.knows(FIRST) and not ledger.knows(FIRST - 1) and not ledger.knows(FIRST + 1)
    ledger.ended(ledger.begins("goto", 5, ends_flight=False), DONE)
    assert (ledger.effective, ledger.effective_order, ledger.effective_serial) == (FIRST + 1, "goto", 5)
    number = ledger.begins("land", 6, ends_flight=True)
    assert (ledger.in_progress, ledger.newest_in_progress, number) == (1, "land", ledger.number)
    assert ledger.is_behind(5) and not ledger.is_behind(6) and ledger.knows(number)
    ledger.ended(number, DENIED)
    assert (ledger.in_progress, ledger.newest_in_progress, ledger.number) == (0, "", FIRST + 2)
    assert (ledger.effective, ledger.effective_order, ledger.effective_serial) == (FIRST + 1, "goto", 5)
    assert not ledger.is_behind(5)


def test_an_older_order_that_ends_later_does_not_take_the_place_of_a_newer_one() -> None:
    ledger = OrderLedger()
    older = ledger.begins("mode", 8, ends_flight=False)
    newer = ledger.begins("hold", 7, ends_flight=True)
    ledger.ended(newer, LOST)
    assert ledger.newest_in_progress == "", "the one in progress is not the newest"
    ledger.ended(older, None)
    assert (ledger.effective, ledger.effective_order) == (newer, "hold")
    assert ledger.effective_serial == 8, "though it was asked for later"


def test_an_effect_without_a_number_counts_by_its_serial() -> None:
    ledger = OrderLedger(FIRST)
    ledger.note_effect(4)
    ledger.note_effect(3)
    assert (ledger.effective, ledger.effective_serial) == (FIRST, 4) and ledger.is_behind(3)


def test_what_ends_a_flight_ends_it_for_what_began_before() -> None:
    ledger = OrderLedger()
    before = ledger.number
    ledger.begins("mode", 1, ends_flight=False)
    assert not ledger.flight_ended_since(before)
    ending = ledger.begins("disarm", 2, ends_flight=True)
    ledger.begins("mode", 3, ends_flight=False)
    assert ledger.flight_ended_since(before) and not ledger.flight_ended_since(ending)


@pytest.mark.parametrize(
    ("mode", "mode_changes", "mode_since", "own"),
    [
        (5, 8, 12.9, True),
        (5, 8, 13.1, False),  # too late
        (5, 7, 9.0, False),  # it was in that one before
        (5, 9, 12.0, False),  # another one has shown in between
        (2, 8, 12.0, False),
    ],
)
def test_a_mode_is_our_own_if_it_was_accepted_and_shows_next_and_in_time(
    mode: int, mode_changes: int, mode_since: float, own: bool
) -> None:
    ledger = OrderLedger()
    assert not ledger.is_own_mode(mode, mode_changes, mode_since)
    ledger.mode_accepted(frozenset({5, 6}), 7, 13.0)
    assert ledger.is_own_mode(mode, mode_changes, mode_since) is own
    ledger.mode_accepted(frozenset({4}), 7, 13.0)
    assert not ledger.is_own_mode(mode, mode_changes, mode_since), "a newer one is accepted"


def test_an_arming_may_show_until_heartbeats_have_followed_what_may_have_armed_it() -> None:
    ledger = OrderLedger()
    assert ledger.arming == (-math.inf, -math.inf)
    ledger.arming_begins(10.0)
    assert ledger.arming == (10.0, math.inf)
    ledger.arming_begins(12.0)
    ledger.arming_ended(13.0, LOST)
    assert ledger.arming == (12.0, math.inf), "another one is in progress"
    ledger.arming_ended(14.0, DENIED)
    assert ledger.arming == (12.0, 13.0 + RECENTLY_ARMED_S), "that of the one before stays"
    ledger.arming_begins(20.0)
    ledger.arming_ended(21.0, DENIED)
    assert ledger.arming == (12.0, 13.0 + RECENTLY_ARMED_S)


@given(st.lists(st.tuples(st.integers(0, 9), st.sampled_from([DONE, LOST, DENIED, None]), st.booleans())))
def test_by_whatever_interleaving_the_effective_order_is_the_newest_that_was_not_refused(
    orders: list[tuple[int, Outcome | None, bool]],
) -> None:
    """``orders``: serial, outcome, and whether it waits for those that follow."""
    ledger = OrderLedger()
    took, waiting = [(0, 0)], list[tuple[int, int, Outcome | None]]()
    for serial, outcome, waits in orders:
        waiting.append((ledger.begins("mode", serial, ends_flight=False), serial, outcome))
        assert ledger.in_progress == len(waiting)
        assert ledger.is_behind(0) is any(s > 0 for _, s in (*took, *((n, s) for n, s, _ in waiting)))
        while waiting and not waits:
            number, of, ends = waiting.pop(0)
            ledger.ended(number, ends)
            took += [(number, of)] if may_have_effect(ends) else []
        assert ledger.effective == max(number for number, _ in took)
        assert ledger.effective_serial == max(serial for _, serial in took)


def test_what_has_changed_the_mode_counts_though_it_is_refused_then() -> None:
    ledger = OrderLedger(FIRST)
    number = ledger.begins("hold", 5, ends_flight=False)
    ledger.ended(number, DENIED, changed=True)
    assert (ledger.effective, ledger.effective_order, ledger.is_behind(4)) == (number, "hold", True)


# --- the owner of a stream of setpoints -------------------------------------------------------------------------------

Streamed = list[tuple[float, str, str | None]]
"""When, who or what, and a part of the refusal; None: it is followed. "A": a setpoint of A; "A!": with take_over;
"A gone", "order ends" (a flight), "order True", "goto", "goto refused", "engaged", "lead B": what happens."""


@pytest.mark.parametrize(
    "streamed",
    [
        # one owner until its deadline, after which anybody begins; 0.5 s are not over at 0.5
        [(0.0, "A", None), (0.4, "A", None), (0.9, "B", "of A, each valid for 0.5 s; take_over"), (0.91, "B", None)],
        # at once where the owner's connection has closed, which reconnects as another client
        [(0.0, "A", None), (0.1, "B", "of A"), (0.1, "A gone", None), (0.1, "B", None), (0.2, "C", "of B")],
        # what was taken over stays so: late setpoints, those after the end of B's stream, and insisting ones
        [(0.0, "A", None), (0.1, "B!", None), (0.15, "A", "B has taken it over"), (0.2, "A!", "B has taken it over")]
        + [(t / 10, "A!", "pause of 1 s") for t in range(3, 30)]
        + [(2.95, "C", None), (3.9, "A", "pause"), (4.91, "A", None)],
        # both insist with every setpoint: one change, not one for each
        [(0.0, "A!", None), (0.02, "B!", None)] + [(0.04 + t / 50, "AB"[t % 2] + "!", ["B has", None][t % 2])
                                                  for t in range(200)],
        # three that insist after a pause each
        [(0.0, "A!", None), (0.1, "B!", None), (0.2, "C!", None), (0.3, "A!", "B has"), (0.3, "B!", "C has"),
         (1.25, "A!", "B has"), (2.3, "A!", None), (2.45, "C", "of A")],
        # an order ends the stream: its owner does not take the vehicle back, another may begin
        *([(0.0, "A", None), (0.1, order, None), (0.15, "A", how), (0.5, "A!", how), (1.6, "A", None)]
          for order, how in (("order ends", "another order"), ("order True", "another order"), ("goto", "a goto"))),
        [(0.0, "A", None), (0.1, "order ends", None), (0.15, "B", None), (0.2, "A", "another order")],
        # one that the vehicle refused and that ends no flight takes nothing: a mission that it does not have
        [(0.0, "A", None), (0.1, "order False", None), (0.2, "A", None), (0.3, "B", "of A")],
        # of one whose deadline had passed before the order nothing was taken
        [(0.0, "A", None), (0.6, "order ends", None), (0.7, "A", None)],
        # a companion refuses a goto, before or after another has begun
        [(0.0, "A", None), (0.1, "goto", None), (0.15, "A", "a goto"), (0.2, "goto refused", None), (0.25, "A", None),
         (0.3, "B", "of A")],
        [(0.0, "A", None), (0.1, "goto", None), (0.15, "B", None), (0.2, "goto refused", None), (0.25, "A", "of B")],
        # control is set again: who had lost it goes on; an owner beside it stays the owner
        [(0.0, "A", None), (0.1, "goto", None), (0.15, "A", "a goto"), (0.2, "engaged", None), (0.25, "A", None),
         (0.3, "engaged", None), (0.3, "B", "of A"), (0.31, "engaged anew", None), (0.32, "B", None)],
        # beside an owner control is set in vain for one that has lost it, however often
        [(0.0, "A", None), (0.1, "B!", None), (0.2, "engaged", None), (0.2, "A!", "B has"), (0.3, "B gone", None),
         (0.3, "engaged", None), (0.3, "A", None)],
        # a program of the daemon that an order has begin
        [(0.0, "A", None), (0.1, "lead F", None), (0.2, "A", "F has taken it over"), (0.2, "B", "of F")],
        # two clients end at once, and one dies that had lost it
        [(0.0, "A", None), (0.1, "B!", None), (0.2, "A gone", None), (0.2, "B gone", None), (0.2, "C", None)],
        # no deadline at all
        [(0.0, "A", None), (math.nan, "B", None)],
    ],
)  # fmt: skip
def test_a_stream_has_one_owner(streamed: Streamed) -> None:
    ledger = OrderLedger(FIRST)
    owner = StreamOwner(ledger)
    clients = {name: ClientIdentity(lambda name=name: name) for name in "ABCF"}  # type: ignore[misc]
    refused = 0
    for now, what, expected in streamed:
        why = None
        match what.split():
            case ["order", "ends"]:
                ledger.ended(ledger.begins("hold", 1, ends_flight=True), DENIED)
            case ["order", ok]:
                ledger.ended(ledger.begins("mission", 1, ends_flight=False), DONE if ok == "True" else DENIED)
            case ["goto"]:
                goes_on = owner.ended("a goto was ordered", now)
            case ["goto", "refused"]:
                goes_on()
            case ["engaged", *anew]:
                owner.engaged(now, anew=bool(anew))
            case ["lead", name]:
                owner.followed(clients[name], 0.5, now)
            case [name, "gone"]:
                clients[name].leave()
            case [given]:
                client = clients[given[0]]
                why = owner.refusal(client, 0.5, now, take_over=given.endswith("!"))
                if why is None:
                    owner.followed(client, 0.5, now)
        assert (why is None) if expected is None else (why is not None and expected in why), (now, what, why)
        refused += why is not None
    assert owner.status(now)["setpoints_refused"] == refused


def test_clients_that_come_and_go_leave_nothing_behind() -> None:
    owner = StreamOwner(OrderLedger(FIRST))
    for i in range(1000):
        client = ClientIdentity(lambda: "one")
        assert owner.refusal(client, 0.5, i * 0.01, take_over=True) is None
        owner.followed(client, 0.5, i * 0.01)
        another = ClientIdentity(lambda: "another")
        assert owner.is_new(another) and not owner.is_new(another), "each is reported once beside one owner"
        if i % 2 == 0:
            client.leave()
    assert len(owner._lost) <= 101
    assert [owner.is_new(ClientIdentity(lambda: "one of many")) for _ in range(MOST_TOLD)].count(False) == 1
