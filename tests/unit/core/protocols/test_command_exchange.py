from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.protocols.base import Finish, ProgressReport, Transmit
from skygcs.core.protocols.command import (
    EMERGENCY_TIMERS_S,
    IN_PROGRESS,
    MAX_TEXTS,
    RETRY_TIMERS_S,
    SETTLE_S,
    WORKING_LIMIT_S,
    WORKING_SILENCE_S,
    Ack,
    CommandProtocol,
    CommandSpec,
    CommandState,
    Location,
    Outcome,
)
from support.table import each

ARM = CommandSpec(400, (1.0, 0.0))
ACCEPTED = Ack(400, 0)


def started(timers: tuple[float, ...] = RETRY_TIMERS_S) -> CommandProtocol:
    exchange = CommandProtocol(ARM, timers)
    assert exchange.start(100.0) == (Transmit(0),)
    return exchange


def outcome_of(exchange: CommandProtocol) -> Outcome:
    assert exchange.done
    assert exchange.deadline is None
    assert exchange.outcome is not None
    return exchange.outcome


@pytest.fixture
def exchange() -> CommandProtocol:
    return started()


def test_an_accepted_command_ends_at_once(exchange: CommandProtocol) -> None:
    assert exchange.on_ack(ACCEPTED, 100.3) == (Finish(),)
    outcome = outcome_of(exchange)
    assert (outcome.ok, outcome.result, outcome.attempts) == (True, "accepted", 1)
    assert outcome.elapsed_s == pytest.approx(0.3)


TWICE = CommandSpec(176, (1, 6, 0), answers_twice=True)


@each(("second", "result"), [(0, "accepted"), (1, "temporarily_rejected")])
def test_of_a_command_that_is_answered_twice_the_second_answer_is_the_result(second: int, result: str) -> None:
    exchange = CommandProtocol(TWICE)
    exchange.start(100.0)
    assert exchange.on_ack(Ack(176, 0), 100.1) == () and not exchange.done
    exchange.on_ack(Ack(176, second), 100.12)
    exchange.on_text("Switching to Offboard is currently not possible")
    exchange.on_timer(101.0)
    outcome = outcome_of(exchange)
    assert outcome.result == result
    assert second == 0 or "not possible" in outcome.message


def test_if_the_second_answer_is_lost_the_first_one_counts() -> None:
    exchange = CommandProtocol(TWICE)
    exchange.start(100.0)
    exchange.on_ack(Ack(176, 0), 100.1)
    assert exchange.deadline is not None and exchange.on_timer(exchange.deadline) == (Finish(),)
    assert outcome_of(exchange).result == "accepted" and exchange.attempts == 1


def test_silence_is_repeated_with_the_confirmation_count_and_then_a_timeout(exchange: CommandProtocol) -> None:
    now, sent = 100.0, []
    while not exchange.done:
        assert exchange.deadline is not None
        assert exchange.on_timer(exchange.deadline - 0.01) == ()
        now = exchange.deadline
        sent += exchange.on_timer(now)
    assert sent == [Transmit(1), Transmit(2), Transmit(3), Finish()]
    assert now - 100.0 == pytest.approx(sum(RETRY_TIMERS_S))
    outcome = outcome_of(exchange)
    assert (outcome.ok, outcome.result, outcome.attempts) == (False, "timeout", 4)
    assert outcome.message == "no answer to 4 transmissions"


def test_the_first_wait_outlasts_a_round_of_a_nine_node_radio() -> None:
    assert RETRY_TIMERS_S[0] > 0.749
    assert list(RETRY_TIMERS_S) == sorted(RETRY_TIMERS_S)
    assert sum(EMERGENCY_TIMERS_S) <= 5.0


@each(
    ("result", "word"),
    [(1, "temporarily_rejected"), (2, "denied"), (3, "unsupported"), (4, "failed"), (6, "cancelled")],
)
def test_a_refusal_waits_for_the_text_that_says_why(result: int, word: str) -> None:
    exchange = started()
    exchange.on_text("Pre-arm checks follow")
    assert exchange.on_ack(Ack(400, result), 100.2) == ()
    exchange.on_text("Arm: Throttle too high")
    assert exchange.on_timer(100.2 + SETTLE_S - 0.01) == ()
    assert exchange.on_timer(100.2 + SETTLE_S) == (Finish(),)
    outcome = outcome_of(exchange)
    assert (outcome.ok, outcome.result) == (False, word)
    assert outcome.message == f"{word.replace('_', ' ')}: Pre-arm checks follow; Arm: Throttle too high"
    assert outcome.status_texts == ("Pre-arm checks follow", "Arm: Throttle too high")


@each(
    ("result", "word", "said"),
    [(7, "unsupported", "COMMAND_LONG only"), (8, "unsupported", "COMMAND_INT only"), (77, "failed", "MAV_RESULT 77")],
)
def test_odd_results_are_told_in_words(result: int, word: str, said: str) -> None:
    exchange = started()
    exchange.on_ack(Ack(400, result), 100.1)
    exchange.on_timer(101.0)
    assert outcome_of(exchange).result == word
    assert said in outcome_of(exchange).message


def test_a_refusal_is_not_repeated_while_it_settles_nor_turned_round_by_a_second_ack(exchange: CommandProtocol) -> None:
    exchange.on_timer(101.0)
    exchange.on_ack(Ack(400, 4), 101.9)
    assert exchange.on_timer(102.0) == () and exchange.attempts == 2
    assert exchange.on_ack(ACCEPTED, 102.1) == ()
    exchange.on_timer(103.0)
    assert outcome_of(exchange).result == "failed" and exchange.outstanding == 0


def test_progress_stops_the_repeats_and_is_reported(exchange: CommandProtocol) -> None:
    assert exchange.on_ack(Ack(400, IN_PROGRESS, progress=20), 100.5) == (ProgressReport(20),)
    assert exchange.on_timer(103.0) == ()
    assert exchange.on_ack(Ack(400, IN_PROGRESS, progress=255), 105.0) == (ProgressReport(None),)
    assert exchange.on_ack(ACCEPTED, 110.0) == (Finish(),)
    assert outcome_of(exchange).attempts == 1


def test_progress_that_stops_is_a_timeout_that_says_how_far_it_came(exchange: CommandProtocol) -> None:
    exchange.on_ack(Ack(400, IN_PROGRESS, progress=40), 100.5)
    assert exchange.on_timer(100.5 + WORKING_SILENCE_S) == (Finish(),)
    assert outcome_of(exchange).result == "timeout"
    assert "40 %" in outcome_of(exchange).message


def test_progress_without_end_is_given_up(exchange: CommandProtocol) -> None:
    now = 100.0
    while not exchange.done and now < 1000:
        now += 1.0
        if exchange.deadline is not None and now >= exchange.deadline:
            exchange.on_timer(now)
        exchange.on_ack(Ack(400, IN_PROGRESS, progress=50), now)
    assert outcome_of(exchange).result == "in_progress"
    assert now <= 100 + 1 + WORKING_LIMIT_S + 1


def test_a_broadcast_counts_as_the_first_transmission() -> None:
    exchange = CommandProtocol(ARM)
    assert exchange.start(5.0, transmitted=True) == ()
    assert exchange.on_timer(6.0) == (Transmit(1),)
    assert exchange.on_ack(Ack(176, 0), 6.1) == () and exchange.state is CommandState.WAITING, "another command's"
    exchange.on_ack(ACCEPTED, 6.2)
    assert exchange.outstanding == 1, "the other answer may still come"


def test_it_can_be_stopped_once(exchange: CommandProtocol) -> None:
    assert exchange.stop(101.0, "lost", "the vehicle was lost") == (Finish(),)
    assert exchange.stop(102.0, "cancelled", "x") == ()
    assert outcome_of(exchange).result == "lost"
    assert exchange.on_ack(ACCEPTED, 103.0) == ()


def test_texts_are_bounded_and_not_repeated(exchange: CommandProtocol) -> None:
    for n in range(50):
        exchange.on_text(f"text {n}")
        exchange.on_text(f"text {n}")
    exchange.on_ack(ACCEPTED, 100.1)
    assert outcome_of(exchange).status_texts == tuple(f"text {n}" for n in range(50 - MAX_TEXTS, 50))


@each(
    ("target", "ours"), [((0, 0), True), ((255, 25), True), ((255, 0), True), ((255, 190), False), ((254, 25), False)]
)
def test_an_ack_for_another_ground_station_is_not_ours(target: tuple[int, int], ours: bool) -> None:
    assert Ack(400, 0, 0, *target).is_for(255, 25) is ours


def test_a_long_command_carries_the_confirmation_count_and_an_int_command_its_place() -> None:
    assert ARM.message == "COMMAND_LONG"
    target = {"target_system": 3, "target_component": 1}
    assert ARM.values(3, 1, 2) == {**target, "command": 400, "param1": 1.0, "param2": 0.0, "confirmation": 2}
    there = CommandSpec(192, (-1.0, 1.0, 0.0, math.nan), Location(0, 473977420, 85455940, 498.1))
    values = there.values(3, 1, 2)
    assert there.message == "COMMAND_INT" and "confirmation" not in values
    assert (values["frame"], values["x"], values["y"], values["z"]) == (0, 473977420, 85455940, 498.1)
    with pytest.raises(ValueError, match="too many"):
        CommandSpec(192, (0.0,) * 5, Location(0, 1, 1, 1.0))


def test_an_outcome_is_json_able() -> None:
    outcome = {"ok": False, "result": "denied", "message": "denied: x", "attempts": 2}
    shown = Outcome(*outcome.values(), 1.23456, ("x",)).as_dict()
    assert shown == {**outcome, "elapsed_s": 1.235, "status_texts": ["x"]}


ACKS = st.builds(Ack, st.sampled_from([400, 176]), st.integers(0, 9), st.integers(0, 255))
HAPPENINGS = st.lists(st.tuples(st.floats(0, 8), st.none() | ACKS, st.none() | st.text(max_size=5)), max_size=40)


@given(HAPPENINGS)
def test_whatever_comes_in_whatever_order_there_is_exactly_one_outcome_in_bounded_time(story) -> None:
    exchange = CommandProtocol(ARM)
    now, finishes, transmissions = 0.0, 0, 0

    def count(effects: tuple[object, ...]) -> None:
        nonlocal finishes, transmissions
        finishes += sum(isinstance(e, Finish) for e in effects)
        transmissions += sum(isinstance(e, Transmit) for e in effects)
        assert exchange.done == (exchange.outcome is not None) == (exchange.deadline is None) == (finishes == 1)

    def run_until(end: float) -> None:
        nonlocal now
        while exchange.deadline is not None and exchange.deadline <= end:
            now = exchange.deadline
            count(exchange.on_timer(now))
        now = max(now, end) if not exchange.done else now

    count(exchange.start(now))
    for after_s, ack, text in story:
        run_until(now + after_s)
        if text is not None:
            exchange.on_text(text)
        if ack is not None:
            was = exchange.outcome
            count(exchange.on_ack(ack, now))
            assert was is None or exchange.outcome is was
    run_until(now + LONGEST_S + 1)
    assert finishes == 1 and 1 <= transmissions <= len(RETRY_TIMERS_S)
    outcome = outcome_of(exchange)
    assert outcome.elapsed_s <= LONGEST_S + 1e-6
    assert (outcome.ok, outcome.attempts) == (outcome.result == "accepted", transmissions)


LONGEST_S = sum(RETRY_TIMERS_S) + WORKING_LIMIT_S + SETTLE_S
