"""Typed text on its way to a shell, against a shell behind a pipe of 70 bytes that never may be written when full."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.shell import history
from skygcs.ext.shell.history import MAX_FILE_BYTES, MAX_LINES, history_file, read_history, write_history
from skygcs.ext.shell.shell_input import INTERRUPT, MAX_LINE_CHARS, MAX_WAITING_BYTES, PIPE_BYTES, QUIET_S, ShellInput
from skygcs.ext.shell.shell_output import MAX_OUTPUT_BYTES, ShellOutput
from skygcs.ext.shell.shell_text import ShellOutputText


class Shell:
    """The way PX4 1.16 has: a pipe (mavlink_shell.cpp), and nsh, which reads nothing while a command runs."""

    def __init__(self) -> None:
        self.pipe = b""
        self.line = b""
        self.executed: list[bytes] = []
        self.steps_busy = 0
        self.most = 0

    def write(self, data: bytes) -> None:
        self.pipe += data
        self.most = max(self.most, len(self.pipe))

    def step(self, busy: int) -> bytes:
        """Its output; a line that is executed keeps it busy for so many further steps."""
        out = b""
        if self.steps_busy:
            self.steps_busy -= 1
            return b"" if self.steps_busy else b"done\nnsh> \x1b[K"
        while self.pipe:
            byte, self.pipe = self.pipe[:1], self.pipe[1:]
            out += byte
            if byte != b"\n":
                self.line += byte
                continue
            self.executed.append(self.line)
            self.line = b""
            if busy:
                self.steps_busy = busy
                return out
            out += b"nsh> \x1b[K"
        return out


def at_prompt() -> ShellInput:
    typed = ShellInput(-1.0)
    typed.on_output(b"\nNuttShell (NSH)\nnsh> \x1b[K", 0.0)
    return typed


LINES = st.lists(st.text(st.characters(codec="ascii", min_codepoint=32, max_codepoint=126), max_size=MAX_LINE_CHARS))


@given(
    LINES,
    st.lists(st.integers(0, 200), min_size=1, max_size=8),
    st.lists(st.integers(0, 60), min_size=1),
    st.lists(st.booleans(), min_size=1),
)
def test_every_line_comes_whole_and_in_order_and_the_pipe_never_overflows(
    lines: list[str], cuts: list[int], busy: list[int], lost: list[bool]
) -> None:
    text = "".join(f"{line}\n" for line in lines)
    typed, shell, now, n = at_prompt(), Shell(), 0.0, 0
    put = 0
    for step in range(100 * (len(lines) + 1) + 200):
        part = text[put : put + 1 + cuts[step % len(cuts)]]
        if part and typed.put(part) is None:
            put += len(part)
        piece = typed.next_piece(now)
        assert len(piece) <= PIPE_BYTES
        if piece:
            shell.write(piece)
            typed.sent(piece, now)
        out = shell.step(busy[step % len(busy)])
        for at in range(0, len(out), 70):  # as frames, some of which are lost
            n += 1
            if not lost[n % len(lost)] or len(lost) < 3:
                typed.on_output(out[at : at + 70], now)
        now += 0.05
        if len(shell.executed) == len(lines):
            break
    assert shell.most <= PIPE_BYTES
    assert shell.executed == [line.encode() for line in lines[: len(shell.executed)]]
    if len(lost) < 3:  # nothing was lost: all of it arrives
        assert len(shell.executed) == len(lines)


@given(st.lists(st.text(max_size=300), max_size=30), st.lists(st.binary(max_size=80), max_size=30))
def test_whatever_is_put_and_comes_back_little_waits_and_no_piece_is_too_long(
    texts: list[str], outputs: list[bytes]
) -> None:
    typed, now, unread = ShellInput(0.0), 0.0, 0
    for n, text in enumerate(texts):
        before = typed.waiting_bytes
        problem = typed.put(text)
        assert problem is None or typed.waiting_bytes == before
        assert typed.waiting_bytes <= MAX_WAITING_BYTES
        piece = typed.next_piece(now)
        assert set(piece) <= {*range(0x20, 0x7F), 3, 10} and piece[:-1].find(b"\n") == -1
        if piece:
            typed.sent(piece, now)
            unread += len(piece)
        assert unread <= PIPE_BYTES or outputs or now >= QUIET_S
        if n < len(outputs):
            typed.on_output(outputs[n], now)
            unread = 0
        now += 0.01


def test_a_line_waits_for_the_prompt_after_the_one_before() -> None:
    typed = at_prompt()
    assert typed.put("ver all\ntop\n") is None
    assert typed.next_piece(0.0) == b"ver all\n"
    typed.sent(b"ver all\n", 0.0)
    assert typed.next_piece(0.1) == b""
    typed.on_output(b"ver all\nPX4 version: 1.16.1\n", 0.2)
    assert typed.next_piece(0.3) == b"" and not typed.ready
    typed.on_output(b"nsh> \x1b[K", 0.4)
    assert typed.next_piece(0.4) == b"top\n" and not typed.ready
    typed.sent(b"top\n", 0.4)
    typed.on_output(b"top\r\nnsh> ", 0.5)
    assert typed.ready


def test_a_prompt_that_is_lost_holds_the_next_line_for_a_while_and_a_second_one_until_enter() -> None:
    typed = at_prompt()
    typed.put("a" * 60 + "\n")
    typed.sent(typed.next_piece(0.0), 0.0)
    typed.put("ver all\n")
    assert typed.next_piece(QUIET_S - 0.1) == b""
    assert typed.next_piece(QUIET_S) == b"ver all\n"
    typed.sent(b"ver all\n", QUIET_S)
    typed.put("top\n")  # the pipe may hold 69 bytes: neither this nor more is sent into it
    assert typed.next_piece(100.0) == b""
    typed.drop()
    typed.put("\n")
    assert typed.next_piece(100.0) == b"\n"
    typed.sent(b"\n", 100.0)
    typed.put(INTERRUPT)
    assert typed.next_piece(200.0) == b""


def test_a_long_line_goes_on_when_its_echo_comes() -> None:
    typed = at_prompt()
    assert typed.put("b" * 100) is None
    assert typed.next_piece(0.0) == b"b" * 69
    typed.sent(b"b" * 69, 0.0)
    assert typed.next_piece(0.1) == b""
    typed.on_output(b"b" * 40, 0.2)
    typed.on_output(b"b" * 29, 0.2)
    assert typed.next_piece(0.2) == b"b" * 31


def test_ctrl_c_overtakes_and_drops_what_waits() -> None:
    typed = at_prompt()
    typed.put("sleep 100\nver all\n")
    typed.sent(typed.next_piece(0.0), 0.0)
    assert typed.put(INTERRUPT) is None
    assert typed.next_piece(0.0) == INTERRUPT.encode()
    typed.sent(INTERRUPT.encode(), 0.0)
    assert typed.waiting_bytes == 0


def test_a_line_that_is_dropped_when_a_part_of_it_was_sent_is_not_forgotten() -> None:
    typed = at_prompt()
    typed.put("param set A 1 " + "c" * 100 + "\n")
    typed.drop()
    assert not typed.cut
    typed.put("param set A 1 " + "c" * 100 + "\n")
    typed.sent(typed.next_piece(0.0), 0.0)
    assert not typed.cut
    typed.put(INTERRUPT)
    assert typed.cut


def test_a_begun_line_that_was_sent_as_far_as_it_came_is_not_forgotten_either() -> None:
    """The shell has it: 120 further characters would make a line that it cuts off without a word."""
    typed = at_prompt()
    typed.put("c" * 60)
    typed.sent(typed.next_piece(0.0), 0.0)
    assert typed.waiting_bytes == 0
    typed.put(INTERRUPT)
    assert typed.cut


def test_text_that_the_shell_cannot_read_is_refused_as_a_whole() -> None:
    typed = at_prompt()
    for bad, why in (
        ("rm /fs/microsd/ä\n", "printable ASCII"),
        ("\x1b[A", "printable ASCII"),
        ("ver\x03", "printable ASCII"),
        ("ver\tall\n", "printable ASCII"),
        ("x" * 121, "121 characters"),
        ("ok\n" + "x" * 121 + "\n", "121 characters"),
    ):
        problem = typed.put(bad)
        assert problem is not None and why in problem
    assert typed.waiting_bytes == 0
    # also in parts
    assert typed.put("x" * 100) is None
    assert "121 characters" in (typed.put("x" * 21) or "")
    assert typed.put("x" * 20 + "\n") is None
    for _ in range(16):
        typed.put("y" * 119 + "\n")
    problem = typed.put("z" * 100 + "\n")
    assert problem is not None and "2048" in problem


def test_before_the_first_prompt_a_line_waits() -> None:
    typed = ShellInput(0.0)
    typed.put("ver all\n")
    assert typed.next_piece(1.0) == b"" and not typed.ready
    assert typed.next_piece(QUIET_S) == b"ver all\n"


# -- The lines that were typed before: a bounded file of the user's own.


def test_the_newest_lines_come_back_and_nobody_else_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "skygcs" / "shell_history"
    assert read_history(path) == []
    write_history(path, ["", "  ", "caf\u00e9", "\x1b[A", *(f"line {n}" for n in range(MAX_LINES + 10))])
    assert read_history(path) == [f"line {n}" for n in range(10, MAX_LINES + 10)]
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_file_of_any_kind_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "history"
    path.write_bytes(b"first\n" + b"\xff\x1b\x00" * MAX_FILE_BYTES + b"\nlast\n")
    assert read_history(path) == ["last"]
    assert read_history(tmp_path) == []
    write_history(tmp_path / "history" / "below", ["line"])  # a file in place of a folder


def test_it_is_in_the_users_state_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert history_file() == tmp_path / "skygcs" / "shell_history"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(history.Path, "home", lambda: tmp_path)
    assert history_file() == tmp_path / ".local" / "state" / "skygcs" / "shell_history"


# -- Output of a shell that waits for its client: bounded, the newest stays, and what was dropped is said.


def test_the_oldest_is_dropped_and_counted_once() -> None:
    output = ShellOutput()
    output.put(b"first")
    output.put(b"x" * MAX_OUTPUT_BYTES)
    assert output
    text, dropped = output.take()
    assert (text, dropped) == ("x" * MAX_OUTPUT_BYTES, 5)
    output.put(b"more")
    assert output.take() == ("more", 0)
    assert not output
    assert (output.received_bytes, output.dropped_bytes) == (MAX_OUTPUT_BYTES + 9, 5)


@given(st.text(max_size=200), st.lists(st.integers(1, 70), min_size=1))
def test_a_character_that_comes_in_two_frames_is_whole(text: str, sizes: list[int]) -> None:
    data, output, seen, n = text.encode("utf-8", "replace"), ShellOutput(), "", 0
    while data:
        size = sizes[n % len(sizes)]
        output.put(data[:size])
        data, n = data[size:], n + 1
        seen += output.take()[0]
    assert seen == text.encode("utf-8", "replace").decode()


@given(st.binary(max_size=300))
def test_bytes_that_are_no_text_do_no_harm(data: bytes) -> None:
    output = ShellOutput()
    output.put(data)
    assert isinstance(output.take()[0], str)


# -- Output of a shell as a person sees it.


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
