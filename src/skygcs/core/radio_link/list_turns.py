"""One vehicle's parameter list at a time over one radio.

A list is some 900 PARAM_VALUEs of 37 bytes: 33 kB down, a minute of 57600 baud if nothing else came. A station that
meets ten vehicles asks all ten for it within a second, and again every few seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from skygcs.core.radio_link.admission_frames import ThirdPartyFrame

SILENCE_S = 5.0
"""A list whose values have ceased for so long is through, or as much of it as came: what is missing is asked for one by
one. An ArduPilot whose radio is full pauses for up to a few rounds."""

FIRST_VALUE_S = 10.0
"""As long may it take until the first value: the request waits for its turn, and is lost sometimes."""

RESEND_S = 4.0
"""After so long without any value a repeat of the request is sent again: the first was lost. QGC repeats every 5 s."""

LONGEST_S = 900.0
"""Somebody who goes on asking one vehicle for single values is no reason for the others to wait longer than this."""

ALL_COMPONENTS_ANSWER = 1
"""Of a list that was asked of all components (0), the autopilot's values are counted."""

NO_INDEX = 0xFFFF
"""param_index of a value that is no part of a list."""

MAX_WAITING = 254
"""Vehicles there can be."""

Vehicle = tuple[int, int]
"""Target system and component of a request."""


class Asked(Enum):
    """What becomes of a request for a list."""

    SEND = "send"
    HOLD = "hold"
    SWALLOW = "swallow"


@dataclass(slots=True)
class _Running:
    frame: ThirdPartyFrame
    began_at: float
    sent_at: float
    value_at: float | None = None
    count: int = 0
    seen: int = 0
    indices: bytearray = field(default_factory=bytearray)


class ParamLists:
    """`ask` for each request, `heard` for each PARAM_VALUE, `due` when `next_at` has come."""

    __slots__ = ("_running", "_waiting", "abandoned", "finished", "unfinished")

    def __init__(self) -> None:
        self._running: _Running | None = None
        self._waiting: dict[Vehicle, ThirdPartyFrame] = {}
        self.finished = 0
        """Of which every index was seen."""
        self.unfinished = 0
        """That ended before that."""
        self.abandoned = 0
        """That waited until nobody was there any more who wanted them."""

    def ask(self, frame: ThirdPartyFrame, now: float) -> Asked:
        """A request of somebody for the list of its target, which is one system."""
        self._end(now)
        vehicle = frame.target, frame.component
        running = self._running
        if running is None and not self._waiting:
            self._start(frame, now)
            return Asked.SEND
        if running is not None and vehicle == (running.frame.target, running.frame.component):
            if running.value_at is None and now - running.sent_at >= RESEND_S:
                running.sent_at = now
                return Asked.SEND
            return Asked.SWALLOW
        known = vehicle in self._waiting
        if known or len(self._waiting) < MAX_WAITING:
            self._waiting[vehicle] = frame  # keeps the turn of the one before
        return Asked.SWALLOW if known else Asked.HOLD

    def heard(self, system: int, component: int, index: int, count: int, now: float) -> None:
        """A PARAM_VALUE came down; ``count`` is how many there are."""
        running = self._running
        if running is None or system != running.frame.target or not 0 <= index < min(count, NO_INDEX):
            return
        if component != (running.frame.component or ALL_COMPONENTS_ANSWER):
            return
        running.value_at = now
        running.count = count
        octet, bit = divmod(index, 8)
        indices = running.indices
        if octet >= len(indices):
            indices.extend(bytes(octet + 1 - len(indices)))
        if not indices[octet] & 1 << bit:
            indices[octet] |= 1 << bit
            running.seen += 1

    def due(self, now: float, wanted: Callable[[int], bool]) -> ThirdPartyFrame | None:
        """The request that may be sent now. ``wanted``: whether somebody by that source is still there."""
        self._end(now)
        while self._running is None and self._waiting:
            frame = self._waiting.pop(next(iter(self._waiting)))
            if wanted(frame.source):
                self._start(frame, now)
                return frame
            self.abandoned += 1
        return None

    def next_at(self, now: float) -> float | None:
        """When `due` may give something; None: not before somebody asks."""
        if not self._waiting:
            return None
        return now if self._running is None else max(now, self._ends_at(self._running))

    @property
    def waiting(self) -> list[int]:
        """Systems whose lists wait, in the order of their turns."""
        return [system for system, _ in self._waiting]

    @property
    def running(self) -> tuple[int, int, int] | None:
        """System whose list comes, values seen and values there are (0: not known yet)."""
        running = self._running
        return None if running is None else (running.frame.target, running.seen, running.count)

    def clear(self) -> int:
        """Forget all of them (the link went down); how many waited."""
        gone = len(self._waiting)
        self._running = None
        self._waiting.clear()
        return gone

    def status(self, now: float) -> dict[str, Any]:
        self._end(now)
        running = self._running
        return {
            "running": None
            if running is None
            else {
                "sysid": running.frame.target,
                "seen": running.seen,
                "count": running.count,
                "age_s": round(now - running.began_at, 1),
            },
            "waiting": self.waiting,
            "finished": self.finished,
            "unfinished": self.unfinished,
            "abandoned": self.abandoned,
        }

    def _start(self, frame: ThirdPartyFrame, now: float) -> None:
        self._running = _Running(frame, now, now)

    def _ends_at(self, running: _Running) -> float:
        if running.count and running.seen >= running.count:
            return running.began_at
        if running.value_at is None:
            return min(running.sent_at, running.began_at + FIRST_VALUE_S) + FIRST_VALUE_S  # repeats end, too
        return min(running.value_at + SILENCE_S, running.began_at + LONGEST_S)

    def _end(self, now: float) -> None:
        running = self._running
        if running is None or now < self._ends_at(running):
            return
        if running.count and running.seen >= running.count:
            self.finished += 1
        else:
            self.unfinished += 1
        self._running = None
