"""The emulated radio's command line, where it must be as unforgiving as the firmware."""

from __future__ import annotations

from skygcs.sim.at_modem import BOOT_S, AtRadio, Kind
from support.table import each


def at_command_line(kind: Kind = Kind.SIK) -> AtRadio:
    radio = AtRadio(kind, command_mode=True)
    radio.hear(b"", 0.0, 57600)
    return radio


def reported(radio: AtRadio, command: bytes, now: float = 0.0) -> bytes:
    radio.hear(command + b"\r", now, 57600)
    return radio.take_output(57600)


@each(
    ("before_s", "data", "after_s", "entered"),
    [
        (1.0, b"+++", 1.0, True),
        (0.9, b"+++", 1.0, False),
        (1.0, b"+++", 0.9, False),
        (1.0, b"++", 1.0, False),
        (1.0, b"++++", 1.0, False),
        (1.0, b"+++\r", 1.0, False),
        (1.0, b"a+++", 1.0, False),
    ],
)
def test_plus_signs_count_only_between_two_guard_times(
    before_s: float, data: bytes, after_s: float, entered: bool
) -> None:
    radio = AtRadio()
    radio.hear(b"data", 10.0, 57600)
    radio.hear(data, 10.0 + before_s, 57600)
    radio.advance(10.0 + before_s + after_s)
    assert radio.command_mode is entered
    assert radio.take_output(57600) == (b"[2] OK\r\n" if entered else b"")


def test_it_echoes_and_tells_its_node_only_where_it_has_one() -> None:
    assert reported(at_command_line(Kind.SIK), b"ats3?") == b"ATS3?\r\n25\r\n"
    assert reported(at_command_line(Kind.SIK_MULTIPOINT), b"AT") == b"AT\r\n[1] OK\r\n"
    assert reported(at_command_line(), b"ATS99=1").endswith(b"ERROR\r\n")
    assert reported(at_command_line(), b"hello") == b"HELLO\r\n"


def test_a_command_that_is_no_persons_ends_the_command_mode() -> None:
    radio = at_command_line()
    radio.hear(b"A" * 17, 0.0, 57600)
    assert not radio.command_mode


def test_at_a_wrong_rate_neither_understands_the_other() -> None:
    radio = at_command_line()
    radio.hear(b"AT\r", 0.0, 9600)
    assert radio.commands == []
    radio.hear(b"\rAT\r", 0.0, 57600)
    assert b"OK" not in radio.take_output(9600)


def test_what_is_not_saved_is_gone_after_a_restart_and_a_new_rate_is_from_then_on() -> None:
    radio = at_command_line()
    reported(radio, b"ATS3=7")
    reported(radio, b"ATS1=115")
    reported(radio, b"AT&W")
    reported(radio, b"ATS2=125")
    assert radio.baud == 57600
    reported(radio, b"ATZ", 5.0)
    assert (radio.live[3], radio.live[2], radio.baud, radio.command_mode) == (7, 64, 115200, False)
    radio.hear(b"lost", 5.0 + BOOT_S / 2, 115200)
    assert radio.traffic == b""


def test_values_are_corrected_without_a_word_as_the_firmware_does() -> None:
    radio = at_command_line()
    for command, register, held in ((b"ATS11=150", 11, 100), (b"ATS12=5", 12, 25), (b"ATS4=15", 4, 17)):
        assert reported(radio, command).endswith(b"OK\r\n")
        assert radio.live[register] == held
