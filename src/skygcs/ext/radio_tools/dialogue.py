"""A conversation with a radio's command line, without a port and without a clock.

A procedure (a generator) yields what is to be done and is handed what came of it:

    Speak(baud)          the port's rate from now on                 -> an empty reply
    Quiet(duration_s)    write nothing, ignore what is heard         -> an empty reply
    Say(data, until …)   write, and read until the answer is whole   -> Reply

`Dialogue` runs one procedure. Whoever owns the port applies `baud`, writes `take_output`, hands what it reads to
`feed`, calls `advance` at `next_deadline`, and looks at `done` after each. Radios answer in lines: an echo of the
command, then the answer, then "OK" or "ERROR" where the command has a status (SiK firmware: at.c). Multipoint firmware
puts the answering node's id before each line: "[2] OK".
"""

from __future__ import annotations

import re
from collections.abc import Generator
from dataclasses import dataclass
from enum import StrEnum, auto
from typing import Generic, TypeVar

T = TypeVar("T")

ANSWER_S = 1.0
"""The longest pause before a local radio answers: it does so within a character time, but a USB adapter may hold
characters back (16 ms by default) and the radio finishes a packet first (up to 131 ms, MAX_WINDOW)."""

IDLE_S = 0.3
"""A list has no end mark; it is over when so long nothing came. A line takes 5 ms at 57600 baud, 200 ms at 1200."""

MAX_HEARD_BYTES = 16384
"""Kept of one answer; the longest (ATI5? of an RFD900x) has about 2 kB. More is traffic or noise: the oldest goes."""

MAX_LINE_CHARS = 200
"""Longer than any line of an answer; of noise without a line end no more is kept."""

_NODE = re.compile(r"\[(\d{1,5})\] ?")


class Until(StrEnum):
    """When the answer to a `Say` is whole; a status ends every one of them."""

    STATUS = auto()
    LINE = auto()
    IDLE = auto()
    SENT = auto()
    """At once: the radio says nothing to it (ATO, ATZ)."""


class Status(StrEnum):
    """Meaning of an answer."""

    OK = auto()
    ERROR = auto()
    LINES = auto()
    """Lines without a status."""
    SILENCE = auto()
    """Nothing that is a line of an answer, within the time."""


@dataclass(frozen=True, slots=True)
class Speak:
    baud: int


@dataclass(frozen=True, slots=True)
class Quiet:
    duration_s: float


@dataclass(frozen=True, slots=True)
class Say:
    data: bytes
    until: Until = Until.STATUS
    timeout_s: float = ANSWER_S
    """Seconds to wait for the first sign of an answer, and from then on for each further line."""
    idle_s: float = IDLE_S
    amid_noise: bool = False
    """The answer may follow other bytes without a line end: the radio was passing on data until then."""


@dataclass(frozen=True, slots=True)
class Reply:
    """``lines`` are without echo, status, node and blank ones; ``node`` is the sender, if the firmware names it."""

    status: Status = Status.SILENCE
    lines: tuple[str, ...] = ()
    node: int | None = None
    heard_bytes: int = 0
    """Everything heard meanwhile, noise as well."""


Step = Speak | Quiet | Say
Procedure = Generator[Step, Reply, T]


class Dialogue(Generic[T]):
    """One procedure being carried out. Errors it raises come out of the constructor, `feed` or `advance`."""

    def __init__(self, procedure: Procedure[T], now: float) -> None:
        self.baud: int | None = None
        """The rate to speak at, None until the procedure says."""
        self.done = False
        self._procedure = procedure
        self._result: list[T] = []
        self._output = b""
        self._say: Say | None = None
        self._deadline = now
        self._text = ""
        self._lines: list[str] = []
        self._node: int | None = None
        self._heard_bytes = 0
        self._echo = ""
        self._step(None, now)

    @property
    def result(self) -> T:
        """Return what the procedure returned; only once it is `done`."""
        assert self._result, "the dialogue is not over"
        return self._result[0]

    def next_deadline(self) -> float | None:
        """When `advance` is due; None when it is over."""
        return None if self.done else self._deadline

    def take_output(self) -> bytes:
        """Return what is to be written now."""
        output, self._output = self._output, b""
        return output

    def feed(self, data: bytes, now: float) -> None:
        """Take what was read."""
        if self.done or self._say is None or not data:
            return
        self._heard_bytes += len(data)
        text = (self._text + data.decode("latin-1"))[-MAX_HEARD_BYTES:]
        *lines, rest = re.split(r"[\r\n]+", text)
        self._text = rest[-MAX_LINE_CHARS:]
        status = None
        for line in lines:
            status = self._hear(line.strip()) or status
        if status is not None:
            self._finish(status, now)
        elif self._say.until is Until.LINE and self._lines:
            self._finish(Status.LINES, now)
        elif self._say.until is Until.IDLE and self._lines:
            self._deadline = now + self._say.idle_s

    def advance(self, now: float) -> None:
        """Let time pass; does nothing before `next_deadline`."""
        while not self.done and now >= self._deadline:
            self._finish(Status.LINES if self._lines else Status.SILENCE, now)

    def _hear(self, line: str) -> Status | None:
        assert self._say is not None
        if self._say.amid_noise and line.endswith("OK"):
            return Status.OK
        if match := _NODE.match(line):
            self._node = int(match[1])
            line = line[match.end() :].strip()
        if not line:
            return None
        if self._echo and line.upper() == self._echo:
            self._echo = ""
            return None
        if line in ("OK", "ERROR"):
            return Status.OK if line == "OK" else Status.ERROR
        if not self._say.amid_noise and line.isprintable() and len(line) <= MAX_LINE_CHARS:
            self._lines.append(line)
        return None

    def _finish(self, status: Status, now: float) -> None:
        reply = Reply(status, tuple(self._lines), self._node, self._heard_bytes)
        self._step(reply, now)

    def _step(self, reply: Reply | None, now: float) -> None:
        """Hand the reply over and take up the next step; those that take no time are done on the spot."""
        while True:
            try:
                step = self._procedure.send(reply) if reply is not None else next(self._procedure)
            except StopIteration as end:
                self.done = True
                self._result.append(end.value)
                return
            except BaseException:
                self.done = True
                raise
            self._say, self._text, self._lines, self._node, self._heard_bytes = None, "", [], None, 0
            match step:
                case Speak(baud):
                    self.baud = baud
                case Quiet(duration_s):
                    self._deadline = now + duration_s
                    return
                case Say():
                    self._output += step.data
                    if step.until is not Until.SENT:
                        self._say = step
                        self._echo = step.data.decode("latin-1").strip().upper()
                        self._deadline = now + step.timeout_s
                        return
            reply = Reply()
