"""The way of typed text to a PX4's shell: in pieces that its pipe takes, a line at a time. Pure.

Between the thread of PX4 that receives MAVLink and its shell is a pipe of `PIPE_BYTES` (CONFIG_DEV_PIPE_SIZE=70), and
while a command runs nobody reads it. A write into the full pipe waits (mavlink_shell.cpp: write), and then the
vehicle hears nothing on this link, no disarming either. So no byte is sent unless the pipe has room for it:

    the shell types its prompt                   it has read everything
    it echoes characters of a line               it has read as many
    it was started, or a line was sent, and no
    prompt has come                              bytes may lie in the pipe. The next line waits; after QUIET_S
                                                 without any output, as a prompt may be lost, it goes if it fits in
    an unfinished line, and no echo for QUIET_S  the shell has read it: nothing else keeps it busy
    a Ctrl-C                                     goes before everything, if it fits in, and drops what waits
"""

from __future__ import annotations

import re

PIPE_BYTES = 70
"""CONFIG_DEV_PIPE_SIZE of each board of PX4 with NuttX, and the length of SERIAL_CONTROL.data."""

KEPT_BYTES = 1
"""Room in the pipe that is left to a Ctrl-C or an Enter."""

MAX_LINE_CHARS = 120
"""nsh reads 126 characters of a line (CONFIG_NSH_LINELEN=128) and cuts off the rest without a word."""

MAX_WAITING_BYTES = 2048
"""Most bytes that wait for the shell; a text for which there is no room is refused as a whole."""

QUIET_S = 2.0

INTERRUPT = "\x03"
"""Ctrl-C, which ends commands of PX4 that read the keyboard, such as top."""

PROMPT = re.compile(rb"(?:nsh|pxh)> (?:\x1b\[K)?$")
"""The end of an output after which the shell reads: of nsh (CONFIG_NSH_PROMPT) and of SITL's pxh."""

TAIL_BYTES = 16

_ALLOWED = re.compile(r"[\x20-\x7e\n]*")


def problem_of(text: str) -> str | None:
    """Why a shell cannot be given this text; None: it can. The longest line is not looked at: `ShellInput.put`."""
    if text == INTERRUPT or _ALLOWED.fullmatch(text) is not None:
        return None
    return "has characters that the shell does not read: printable ASCII and newlines, or one Ctrl-C (\\x03) alone"


class ShellInput:
    """Text of one session that waits for the shell, and how much of what was sent its pipe may hold.

    `put` takes text, `next_piece` says what may be sent now, `sent` that it was; `on_output` sees what comes back.
    """

    def __init__(self, now: float) -> None:
        self._waiting = bytearray()
        self._unfinished = 0
        """Characters of the last line that was put and has no end yet."""
        self._begun = False
        """A part of a line was sent, and not its end."""
        self.cut = False
        """The rest of such a line was dropped: the shell would put the next line behind what it has."""
        self._unread = 0
        """Bytes that the pipe may hold, at most."""
        self._executing = True
        """A line's end was sent, or the shell is being started, and no prompt has come since."""
        self._tail = b""
        self._changed_at = now
        """When something was sent or came."""

    def begin(self, now: float) -> None:
        """The vehicle was told to begin a shell: its prompt is awaited from now on."""
        self._changed_at = now

    @property
    def waiting_bytes(self) -> int:
        """Bytes that were put and not sent."""
        return len(self._waiting)

    @property
    def awaits_prompt(self) -> bool:
        """True if no prompt has come since the shell was begun, or a line was sent."""
        return self._executing

    @property
    def ready(self) -> bool:
        """True if the shell shows its prompt and nothing waits for it."""
        return not self._executing and not self._waiting and PROMPT.search(self._tail) is not None

    def put(self, text: str) -> str | None:
        """Take text behind what waits; or refuse it as a whole: why. A Ctrl-C drops what waits."""
        if (problem := problem_of(text)) is not None:
            return problem
        if text == INTERRUPT:
            self.drop()
            self._waiting += text.encode("ascii")
            return None
        first, *rest = text.split("\n")
        lengths = [self._unfinished + len(first), *map(len, rest)]
        if max(lengths) > MAX_LINE_CHARS:
            return f"has a line of {max(lengths)} characters; PX4's shell reads {MAX_LINE_CHARS} and drops the rest"
        if len(self._waiting) + len(text) > MAX_WAITING_BYTES:
            return (
                f"finds {len(self._waiting)} bytes that wait for the shell, and {MAX_WAITING_BYTES} may: "
                "a command of it runs; end that with Ctrl-C, or close the shell"
            )
        self._waiting += text.encode("ascii")
        self._unfinished = lengths[-1]
        return None

    def next_piece(self, now: float) -> bytes:
        """Return what may be sent now; b"" if nothing waits or the pipe may have no room."""
        if not self._waiting:
            return b""
        quiet = now - self._changed_at >= QUIET_S
        if self._waiting.startswith(INTERRUPT.encode()):
            return bytes(self._waiting[:1]) if self._unread < PIPE_BYTES else b""
        if self._executing and not quiet:
            return b""
        if not self._executing and quiet:
            self._unread = 0
        end = self._waiting.find(b"\n") + 1
        line = bytes(self._waiting[: end or None])
        room = PIPE_BYTES - KEPT_BYTES - self._unread
        if self._executing:  # typed ahead: whole or not at all, as nothing shows when the pipe has room again
            enter = len(line) == 1 and self._unread < PIPE_BYTES
            return line if len(line) <= room or enter else b""
        return line[: max(0, room)]

    def sent(self, piece: bytes, now: float) -> None:
        """The piece that `next_piece` gave was sent."""
        del self._waiting[: len(piece)]
        self._unread += len(piece)
        self._changed_at = now
        if piece != INTERRUPT.encode():
            self._begun = not piece.endswith(b"\n")
        if piece.endswith(b"\n"):
            self._executing = True
            self._tail = b""

    def sent_enter(self, now: float) -> None:
        """An Enter was sent that nobody has put: for the first prompt."""
        self._unread += 1
        self._changed_at = now

    def on_output(self, data: bytes, now: float) -> None:
        """Take in bytes of the shell."""
        self._changed_at = now
        self._tail = (self._tail + data)[-TAIL_BYTES:]
        if PROMPT.search(self._tail) is not None:
            self._unread = 0
            self._executing = False
        elif not self._executing:
            self._unread = max(0, self._unread - len(data))

    def drop(self) -> int:
        """Forget what waits; how many bytes that were. See `cut`: also a begun line of which nothing waits stays in the
        shell."""
        gone = len(self._waiting)
        self.cut |= self._begun
        self._waiting.clear()
        self._unfinished = 0
        return gone
