"""Output of a shell as a person sees it."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.shell.shell_text import ShellOutputText

VER = "ver all\r\nHW arch: PX4_SITL\nPX4 version: 1.16.1\nnsh> \x1b[K"


@given(st.lists(st.integers(1, 12), min_size=1))
def test_the_echo_the_prompt_and_colours_are_left_out_however_it_comes(sizes: list[int]) -> None:
    text, shown, rest, n = ShellOutputText(), "", "\n\x1b[1;31mNuttShell\x1b[0m\nnsh> \x1b[K", 0
    while rest:
        shown += text.feed(rest[: sizes[n % len(sizes)]])
        rest, n = rest[sizes[n % len(sizes)] :], n + 1
    assert shown == "\nNuttShell\n" and text.prompt == "nsh> "
    text.begin()
    rest, shown = VER, ""
    while rest:
        shown += text.feed(rest[: sizes[n % len(sizes)]])
        rest, n = rest[sizes[n % len(sizes)] :], n + 1
    assert shown == "HW arch: PX4_SITL\nPX4 version: 1.16.1\n"
    assert text.prompt == "nsh> " and text.end() == ""


@given(st.lists(st.text(st.characters(codec="utf-8")), max_size=20))
def test_nothing_of_the_output_moves_the_cursor(parts: list[str]) -> None:
    text = ShellOutputText()
    shown = "".join(text.feed(part) for part in parts) + text.end()
    assert all(char == "\n" or char == "\t" or char.isprintable() or ord(char) >= 0xA0 for char in shown)
    assert "\x1b" not in shown and "\x9b" not in shown and "\x07" not in shown


def test_a_line_without_an_end_is_shown_unless_it_may_be_a_prompt() -> None:
    text = ShellOutputText()
    assert text.feed("calibrating: 10") == "calibrating: 10"
    assert text.feed("%\nns") == "%\n"
    assert text.prompt == ""
    assert text.feed("h: top: command not found\n") == "nsh: top: command not found\n"
    text.feed("px")
    assert text.end() == "px"


def test_what_is_dangerous_is_shown_as_it_is_written() -> None:
    text = ShellOutputText()
    assert text.feed("\x1b]0;title\x07 \x9b2J \u202e\n") == "\\x1b]0;title\\x07 \\x9b2J \\u202e\n"
