"""What comes from a companion is bounded and cannot move the cursor of the terminal that shows it."""

from __future__ import annotations

from skygcs.ext.companions.bring_up import ssh_session
from skygcs.ext.companions.bring_up.ssh_session import Ran, printable, quoted


class Pipe:
    """A reader that gives these pieces."""

    def __init__(self, *pieces: bytes) -> None:
        self.pieces = list(pieces)

    async def read(self, _: int) -> bytes:
        return self.pieces.pop(0) if self.pieces else b""


async def lines(*pieces: bytes) -> list[str]:
    return [line async for line in ssh_session._lines_of(Pipe(*pieces))]  # type: ignore[arg-type]


async def test_lines_are_put_together_cut_and_cleaned() -> None:
    assert await lines(b"on", b"e\r\ntwo\n", b"\xff\x1b[2Jthree") == ["one", "two", "�·[2Jthree"]
    (long,) = await lines(*[b"x" * 65536] * 100, b"\n")
    assert len(long) == ssh_session.MAX_LINE_CHARS


async def test_an_output_without_end_is_kept_up_to_a_bound() -> None:
    kept = await ssh_session._kept(Pipe(*[b"x" * 65536] * 100))  # type: ignore[arg-type]
    assert len(kept) == ssh_session.MAX_OUTPUT_BYTES


def test_the_reason_of_a_command_is_its_last_line() -> None:
    assert Ran(1, "", "first\nlast\n\n").why == "last"
    assert (Ran(2, "", "").why, Ran(None, "", "").why) == ("exit code 2", "was ended by a signal")


def test_words_reach_the_shell_as_they_are() -> None:
    assert quoted("a b", "$HOME", "x") == "'a b' '$HOME' x"
    assert printable("a\tb\x07\u202e") == "a\tb··"
