"""Whose files come: turns, ends, and what always passes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.radio_link.admission_frames import ThirdPartyFrame
from skygcs.core.radio_link.file_turns import LONGEST_S, QUIET_S, FileTurns


def request(system: int, opcode: int = 15) -> ThirdPartyFrame:
    return ThirdPartyFrame(b"", 110, 255 << 8 | 190, system, 1, bytes([0, system, 1, 7, 0, 0, opcode]))


def test_the_turn_passes_when_nothing_has_gone_up_or_come_down_for_a_while() -> None:
    turns = FileTurns()
    assert turns.may(request(1), 0.0)
    turns.heard(1, 2.0)
    assert not turns.may(request(2), 2.0 + QUIET_S)
    assert turns.running(2.0 + QUIET_S) == 1
    assert turns.running(2.1 + QUIET_S) is None
    turns.heard(1, 2.1 + QUIET_S)  # too late
    assert turns.may(request(2), 2.1 + QUIET_S)


@pytest.mark.parametrize("opcode", [1, 2])
def test_a_transfer_may_be_ended_at_any_time_which_takes_no_turn(opcode: int) -> None:
    turns = FileTurns()
    turns.may(request(1), 0.0)
    assert turns.may(request(2, opcode), 1.0)
    assert turns.running(1.0) == 1


def test_a_payload_too_short_to_have_an_opcode_is_a_request() -> None:
    turns = FileTurns()
    turns.may(request(1), 0.0)
    assert not turns.may(request(2)._replace(payload=b"\0\2"), 0.0)


@given(st.lists(st.tuples(st.floats(0, 5), st.integers(1, 3), st.booleans()), max_size=200))
def test_never_two_within_the_quiet_time_unless_one_has_had_its_time(steps: list[tuple[float, int, bool]]) -> None:
    turns = FileTurns()
    now, holder, since, at = 0.0, 0, 0.0, float("-inf")
    for pause_s, system, down in steps:
        now += pause_s
        if down:
            turns.heard(system, now)
            if system == holder and now - at <= QUIET_S:
                at = now
        elif turns.may(request(system), now):
            if system != holder:
                assert now - at > QUIET_S or now - since >= LONGEST_S
                holder, since = system, now
            at = now
