"""The dialogue: what counts as an answer, when one is whole, and that noise neither hangs nor fills it."""

from __future__ import annotations

from collections.abc import Generator

from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.radio_tools.dialogue import MAX_HEARD_BYTES, Dialogue, Quiet, Reply, Say, Speak, Status, Step, Until


def once(step: Step) -> Generator[Step, Reply, Reply]:
    return (yield step)


def asked(step: Say, *heard: bytes) -> Dialogue[Reply]:
    dialogue = Dialogue(once(step), 0.0)
    for i, data in enumerate(heard):
        dialogue.feed(data, 0.1 * i)
    return dialogue


def test_echo_status_and_node_are_no_part_of_the_lines() -> None:
    dialogue = asked(Say(b"ATS3?\r"), b"ATS3?\r\n[12] 25\r\n\r\n[12] O", b"K\r\n")
    assert dialogue.result == Reply(Status.OK, ("25",), 12, 27)


def test_only_the_first_line_like_the_command_is_its_echo() -> None:
    assert asked(Say(b"AT\r"), b"AT\r\nAT\r\nOK\r\n").result.lines == ("AT",)


def test_a_single_line_ends_an_answer_of_one_line_and_an_error_every_answer() -> None:
    assert asked(Say(b"ATI\r", Until.LINE), b"SiK 2.2\r\n").result.status is Status.LINES
    for until in (Until.STATUS, Until.LINE, Until.IDLE):
        assert asked(Say(b"ATX\r", until), b"ATX\r\nERROR\r\n").result.status is Status.ERROR


def test_a_list_is_over_when_nothing_more_comes() -> None:
    dialogue = asked(Say(b"ATI5\r", Until.IDLE, timeout_s=1.0, idle_s=0.3), b"S0:A=1\r\n", b"S1:B=2\r\nS2:C=")
    assert dialogue.next_deadline() == 0.1 + 0.3
    dialogue.advance(0.39)
    assert not dialogue.done
    dialogue.feed(b"3\r\n", 0.39)
    dialogue.advance(0.7)
    assert dialogue.result.lines == ("S0:A=1", "S1:B=2", "S2:C=3")


def test_no_answer_is_silence_at_the_deadline_and_says_how_much_noise_there_was() -> None:
    dialogue = asked(Say(b"AT\r", timeout_s=1.0), b"\xfe\x09\x00noise")
    assert dialogue.next_deadline() == 1.0
    dialogue.advance(1.0)
    assert (dialogue.result.status, dialogue.result.heard_bytes) == (Status.SILENCE, 8)


def test_ok_behind_data_without_a_line_end_counts_only_where_data_is_expected() -> None:
    heard = b"\xfd\x1c\x00\x00telemetryOK\r\n"
    assert asked(Say(b"+++", amid_noise=True), heard).result.status is Status.OK
    assert not asked(Say(b"AT\r"), heard).done


def test_steps_that_take_no_time_are_done_at_once_and_in_order() -> None:
    def procedure() -> Generator[Step, Reply, str]:
        yield Speak(9600)
        yield Say(b"ATO\r", Until.SENT)
        yield Quiet(0.5)
        return "left"

    dialogue = Dialogue(procedure(), 10.0)
    assert (dialogue.baud, dialogue.take_output(), dialogue.take_output()) == (9600, b"ATO\r", b"")
    dialogue.feed(b"late", 10.2)
    assert dialogue.next_deadline() == 10.5
    dialogue.advance(10.5)
    assert (dialogue.done, dialogue.result, dialogue.next_deadline()) == (True, "left", None)


@given(st.lists(st.binary(max_size=300), max_size=20))
def test_any_bytes_whatever_leave_it_at_its_deadline_or_done(chunks: list[bytes]) -> None:
    dialogue = asked(Say(b"AT\r", timeout_s=5.0), *chunks)
    if not dialogue.done:
        assert dialogue.next_deadline() == 5.0
        dialogue.advance(5.0)
    assert dialogue.done


def test_endless_noise_is_not_kept() -> None:
    dialogue = asked(Say(b"AT\r"), *[b"\xff" * 4096] * 100)
    assert len(dialogue._text) < MAX_HEARD_BYTES
    dialogue.feed(b"\r\nOK\r\n", 0.9)
    assert dialogue.result.status is Status.OK
