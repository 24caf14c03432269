"""Base of the request/reply state machines: time goes in, effects come out, one deadline says when to call again.

The shell owns the machine: it calls `start` once, `on_timer` when ``deadline`` has come, the machine's other methods
when a message arrived, and carries out the effects returned, in order. A machine with an outcome returns no
further effects and has no deadline.

`SlidingWindow`: numbered requests of which several are under way at once, paced, repeated until answered, given up
after so many. The parts of a file and the indices of a parameter list are requested like this (`FileDownload`,
`ParamList`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

# --- machine ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Transmit:
    """Send the request; ``attempt`` is 0 for the first time (COMMAND_LONG's confirmation count)."""

    attempt: int


@dataclass(frozen=True, slots=True)
class Send:
    """Send this message (for machines that send several kinds); the shell fills in its target fields."""

    message: str
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ProgressReport:
    """The vehicle is working on the request; ``percent`` is None if it reports no progress."""

    percent: int | None


@dataclass(frozen=True, slots=True)
class Finish:
    """Over: the machine's ``outcome`` is set."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Next data, to be written at ``offset``."""

    offset: int
    data: bytes


Effect = Transmit | Send | ProgressReport | Chunk | Finish


class ProtocolMachine(ABC):
    """One request and its reply."""

    deadline: float | None = None
    """When `on_timer` has to be called; None while not started and after the end."""

    @abstractmethod
    def start(self, now: float) -> tuple[Effect, ...]:
        """Begin. To be called once."""

    @abstractmethod
    def on_timer(self, now: float) -> tuple[Effect, ...]:
        """The deadline has come; harmless when called early."""

    @property
    @abstractmethod
    def done(self) -> bool:
        """True if it is over."""


# --- sliding window ---------------------------------------------------------------------------------------------------


FIRST_WAIT_S = 1.0
MIN_WAIT_S, MAX_WAIT_S = 0.25, 5.0
"""Bounds of the wait for an answer before its request is repeated. The first wait is FIRST_WAIT_S; measured round trips
set it within these bounds."""


class ReplyTimeout:
    """Time to wait for an answer: the smoothed round trip and four times its deviation, doubled when one is overdue.

    TCP's rule (RFC 6298). Only answers to first requests are measured: a later answer may belong to either request.
    """

    def __init__(self) -> None:
        self.seconds = FIRST_WAIT_S
        self._mean: float | None = None
        self._deviation = 0.0
        self._doubled_at = -math.inf

    def measured(self, round_trip_s: float) -> None:
        if self._mean is None:
            self._mean, self._deviation = round_trip_s, round_trip_s / 2
        else:
            self._deviation += (abs(round_trip_s - self._mean) - self._deviation) / 4
            self._mean += (round_trip_s - self._mean) / 8
        self.seconds = min(max(MIN_WAIT_S, self._mean + 4 * self._deviation), MAX_WAIT_S)

    def overdue(self, now: float) -> None:
        if now - self._doubled_at >= self.seconds:
            self.seconds = min(2 * self.seconds, MAX_WAIT_S)
            self._doubled_at = now


@dataclass(slots=True)
class _Request:
    sent_at: float
    due_at: float
    is_first: bool


class SlidingWindow:
    """`advance` gives the numbers to request now, `answered` takes the answers, ``due`` is when to call again.

    ``next_new()``: the next number that was never requested, None if all were requested so far. ``is_missing(number)``:
    whether an answer is still wanted.
    """

    def __init__(
        self,
        next_new: Callable[[], int | None],
        is_missing: Callable[[int], bool],
        *,
        size: int,
        spacing_s: float,
        max_tries: int,
    ) -> None:
        self.timeout = ReplyTimeout()
        self.due = math.inf
        """When `advance` has something to do; infinite: nothing is under way and nothing is left to request."""
        self.given_up: set[int] = set()
        """Numbers that were not answered within their tries."""
        self._next_new = next_new
        self._is_missing = is_missing
        self._size = size
        self._spacing_s = spacing_s
        self._max_tries = max_tries
        self._next_send = -math.inf
        self._in_progress: dict[int, _Request] = {}
        self._tries: dict[int, int] = {}
        self._again: deque[int] = deque()

    def clear(self) -> None:
        """Begin anew with the same peer: its round trips stay known, and the pace is kept."""
        self.due = math.inf
        self._in_progress.clear()
        self._tries.clear()
        self._again.clear()
        self.given_up.clear()

    def __contains__(self, number: int) -> bool:
        """True if a request is under way."""
        return number in self._in_progress

    def answered(self, number: int, now: float, *, measure: bool = True) -> None:
        """An answer came; ``measure``: it is certainly the answer to a request, and so shows the round trip."""
        request = self._in_progress.pop(number, None)
        if measure and request is not None and request.is_first:
            self.timeout.measured(now - request.sent_at)

    def advance(self, now: float) -> list[int]:
        """The numbers to request now; sets ``due``."""
        for number in [n for n, request in self._in_progress.items() if now >= request.due_at]:
            self.timeout.overdue(now)
            del self._in_progress[number]
            if self._tries[number] >= self._max_tries:
                self.given_up.add(number)
            else:
                self._again.append(number)
        self.due = math.inf
        numbers: list[int] = []
        while len(self._in_progress) < self._size:
            if now < self._next_send:
                self.due = self._next_send
                break
            following = self._next()
            if following is None:
                break
            numbers.append(following)
            tries = self._tries[following] = self._tries.get(following, 0) + 1
            self._in_progress[following] = _Request(now, now + self.timeout.seconds, tries == 1)
            self._next_send = now + self._spacing_s
        self.due = min([self.due, *(request.due_at for request in self._in_progress.values())])
        return numbers

    def _next(self) -> int | None:
        while self._again:
            number = self._again.popleft()
            if self._is_missing(number):
                return number
        return self._next_new()
