"""One vehicle's list, or file, at a time: how a turn ends, what is repeated, who is next."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.mavlink.frame import Frame
from skygcs.core.radio_link.admission_frames import Kind, ThirdPartyFrame
from skygcs.core.radio_link.turn_gate import (
    FILE_SILENCE_S,
    FIRST_VALUE_S,
    LONGEST_FILE_S,
    LONGEST_LIST_S,
    MAX_WAITING,
    RESEND_S,
    SILENCE_S,
    ParameterListGate,
    TurnGate,
)
from support.table import each

QGC = 255 << 8 | 190
NO_INDEX = 0xFFFF


def request(system: int, component: int = 1, source: int = QGC) -> ThirdPartyFrame:
    frame = Frame(b"", 0, source >> 8, source & 0xFF, 21, None)
    return ThirdPartyFrame(frame, Kind.PARAMETER_LIST, source, system, component, bytes((system, component)))


def due(lists: ParameterListGate, now: float) -> int | None:
    frame = lists.due(now, lambda source: True)
    return None if frame is None else frame.target


@pytest.fixture
def lists() -> ParameterListGate:
    return ParameterListGate()


def asked(*systems: int) -> ParameterListGate:
    """The first has its turn, the others wait."""
    lists = ParameterListGate()
    for system in systems:
        lists.ask(request(system), 0.0)
    return lists


def test_a_list_is_through_when_every_index_was_seen_in_any_order_and_more_than_once(lists: ParameterListGate) -> None:
    assert lists.ask(request(1), 0.0) == "send"
    assert lists.ask(request(2), 0.0) == "hold"
    for index in (2, 0, 2, 0, NO_INDEX, 7):
        lists.heard(1, 1, index, 3, 1.0)
    lists.heard(2, 1, 1, 3, 1.0)  # another vehicle's
    lists.heard(1, 100, 1, 3, 1.0)  # another component's
    assert due(lists, 1.0) is None
    assert lists.running == (1, 2, 3)
    lists.heard(1, 1, 1, 3, 2.0)
    assert due(lists, 2.0) == 2
    assert lists.finished == 1


def test_a_list_of_all_components_is_the_autopilots(lists: ParameterListGate) -> None:
    lists.ask(request(1, 0), 0.0)
    lists.heard(1, 1, 0, 1, 1.0)
    assert lists.ask(request(2), 1.0) == "send"


@each("values", [0, 1, 10])
def test_a_list_that_ceases_ends_after_a_while_and_lets_the_next_go(values: int) -> None:
    lists = asked(1, 2)
    for index in range(values):
        lists.heard(1, 1, index, 900, 1.0 + index)
    ends = values + SILENCE_S if values else FIRST_VALUE_S
    assert lists.next_at(0.0) == ends
    assert [due(lists, now) for now in (ends - 0.01, ends)] == [None, 2]
    assert (lists.finished, lists.unfinished) == (0, 1)


def test_a_request_that_brought_nothing_is_sent_again_but_not_for_ever() -> None:
    lists, now, sent = asked(2, 1), 0.0, 0
    while due(lists, now) is None:
        now += 1.0
        sent += lists.ask(request(2), now) == "send"
        assert now < 60
    assert now <= FIRST_VALUE_S and 1 <= sent <= FIRST_VALUE_S / RESEND_S


def test_a_request_that_waited_is_repeated_by_the_gate_as_its_sender_has_perhaps_given_up() -> None:
    lists, first = asked(1, 2), FIRST_VALUE_S
    assert due(lists, first) == 2
    assert lists.next_at(first) == first + RESEND_S, "though nothing else waits"
    times = first + RESEND_S - 0.1, first + RESEND_S, first + 2 * RESEND_S
    assert [due(lists, now) for now in times] == [None, 2, 2]
    assert lists.next_at(first + 2 * RESEND_S) is None, "and then its turn ends"
    assert due(lists, 2 * first) is None
    assert lists.status(2 * first)["unfinished"] == 2


def test_once_values_come_requests_are_not_repeated() -> None:
    lists = asked(1, 2)
    assert due(lists, FIRST_VALUE_S) == 2
    lists.heard(2, 1, 0, 900, FIRST_VALUE_S + 1.0)
    assert lists.next_at(FIRST_VALUE_S + 1.0) is None
    assert due(lists, FIRST_VALUE_S + RESEND_S) is None
    lists = asked(1)
    lists.heard(1, 1, 0, 900, 1.0)
    assert lists.ask(request(1), 1.0 + SILENCE_S - 0.1) == "repeat"
    assert lists.ask(request(1, source=7), 2.0) == "repeat", "the list comes to everybody"


def test_somebody_who_goes_on_asking_for_values_does_not_keep_the_others_for_ever() -> None:
    lists, now = asked(1, 2), 0.0
    while due(lists, now) is None:
        now += 1.0
        lists.heard(1, 1, 5, 900, now)
    assert now == LONGEST_LIST_S


def test_of_those_who_wait_for_one_vehicle_the_newest_is_sent_in_the_first_ones_turn() -> None:
    lists = asked(1, 2, 3)
    assert lists.ask(request(2, source=7), 1.0) == "repeat"
    assert lists.waiting == [2, 3]
    frame = lists.due(FIRST_VALUE_S, lambda source: source == 7)
    assert frame is not None and (frame.target, frame.source) == (2, 7)


def test_who_is_gone_is_passed_over_and_a_broken_link_forgets_all() -> None:
    lists = asked(1, 2, 3)
    assert lists.due(FIRST_VALUE_S, lambda source: False) is None
    assert lists.abandoned == 2
    assert lists.ask(request(4), FIRST_VALUE_S) == "send"
    lists.ask(request(5), FIRST_VALUE_S)
    assert lists.clear() == 1
    assert lists.ask(request(6), FIRST_VALUE_S) == "send"


STEPS = st.tuples(st.floats(0, 8), st.integers(1, 4), st.integers(0, 70000), st.integers(0, 70000))


@given(st.lists(STEPS, max_size=80))
def test_never_two_at_a_time_and_everyone_asked_for_gets_a_turn(steps: list[tuple[float, int, int, int]]) -> None:
    lists, sent, now = ParameterListGate(), list[int](), 0.0
    for pause_s, system, index, count in steps:
        now += pause_s
        before = lists.running
        if lists.ask(request(system), now) == "send":
            sent.append(system)
            assert before is None or before[0] == system or lists.finished + lists.unfinished
        lists.heard(system, 1, index, count, now)
    while (at := lists.next_at(now)) is not None:
        now = max(now, at)
        system_now = due(lists, now)
        assert system_now is not None, "next_at is a promise"
        sent.append(system_now)
    assert set(sent) == {system for _, system, _, _ in steps}


def test_no_more_wait_than_there_can_be_vehicles(lists: ParameterListGate) -> None:
    for system in range(1, 256):
        for component in (1, 2):
            lists.ask(request(system, component), 0.0)
    assert len(lists.waiting) == MAX_WAITING


# -- files


def test_a_file_s_turn_passes_when_nothing_has_gone_up_or_come_down_for_a_while() -> None:
    files = TurnGate(FILE_SILENCE_S, LONGEST_FILE_S)
    assert files.enter(1, 0.0)
    files.heard(1, 2.0)
    files.heard(2, 2.5)  # another vehicle's
    assert not files.enter(2, 1.9 + FILE_SILENCE_S)
    assert files.running(1.9 + FILE_SILENCE_S) == 1
    assert files.running(2.1 + FILE_SILENCE_S) is None
    files.heard(1, 2.1 + FILE_SILENCE_S)  # too late
    assert files.enter(2, 2.1 + FILE_SILENCE_S)


@given(st.lists(st.tuples(st.floats(0, 5), st.integers(1, 3), st.booleans()), max_size=200))
def test_never_two_within_the_silence_unless_one_has_had_its_time(steps: list[tuple[float, int, bool]]) -> None:
    files = TurnGate(FILE_SILENCE_S, LONGEST_FILE_S)
    now, holder, since, at = 0.0, 0, 0.0, float("-inf")
    for pause_s, system, down in steps:
        now += pause_s
        if down:
            if system == files.running(now):
                at = now
            files.heard(system, now)
        elif files.enter(system, now):
            if system != holder:
                assert now - at >= FILE_SILENCE_S - 1e-6 or now - since >= LONGEST_FILE_S - 1e-6
                holder, since = system, now
            at = now
