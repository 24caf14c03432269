"""One vehicle's bulk answer at a time over one radio: a parameter list, or a file.

A list is some 900 PARAM_VALUEs of 37 bytes: 33 kB down, a minute of 57600 baud if nothing else came. A station that
meets ten vehicles requests all ten lists within a second, and again every few seconds. A BurstReadFile is one frame up
and a whole file down, as fast as the vehicle chooses.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from skygcs.core.radio_link.admission_frames import ThirdPartyFrame

SILENCE_S = 5.0
"""A list without a new value for so long has ended: what is missing is requested one by one. An ArduPilot whose radio
is full pauses for up to a few rounds."""

FIRST_VALUE_S = 10.0
"""Until the first value of a list: the request waits for its turn, and is lost sometimes."""

RESEND_S = 4.0
"""After so long without any value the request is sent again: the first was lost. QGC repeats its request every 5 s,
five times in all, so a request that waited for its turn has no repeat of its own: the gate repeats that one itself."""

LONGEST_LIST_S = 900.0
"""A program that goes on requesting single values of one vehicle does not keep the others waiting longer than this."""

FILE_SILENCE_S = 3.0
"""A file of which nothing went up or came down for so long has ended: stations repeat a request after a second."""

LONGEST_FILE_S = 300.0
"""After so long the next request takes the turn, from any sender."""

ALL_COMPONENTS_ANSWER = 1
"""The autopilot. Its values are counted in a list that was requested of all components (0)."""

MAX_WAITING = 254
"""Largest number of vehicles."""


class TurnGate:
    """One system at a time has the turn, while it is heard and for at most ``longest_s``."""

    __slots__ = ("_ends_at", "_longest_s", "_silence_s", "_since", "_system")

    def __init__(self, silence_s: float, longest_s: float) -> None:
        self._silence_s = silence_s
        self._longest_s = longest_s
        self._system: int | None = None
        self._since = 0.0
        self._ends_at = 0.0

    def enter(self, system: int, now: float) -> bool:
        """Return whether this system has the turn, or takes it because no system has it."""
        running = self.running(now)
        if running is None:
            self.begin(system, now, self._silence_s)
        elif running == system:
            self.heard(system, now)
        return running in (None, system)

    def begin(self, system: int, now: float, first_s: float) -> None:
        """This system's turn; ``first_s``: how long to wait until something is heard."""
        self._system, self._since, self._ends_at = system, now, now + first_s

    def heard(self, system: int, now: float) -> None:
        """Extend the turn: a part of its answer came."""
        if system == self.running(now):
            self._ends_at = min(now + self._silence_s, self._since + self._longest_s)

    def running(self, now: float) -> int | None:
        """The system whose turn it is."""
        return self._system if now < self._ends_at else None

    @property
    def ends_at(self) -> float:
        """When the turn ends if nothing more is heard."""
        return self._ends_at

    def end(self) -> None:
        self._system, self._ends_at = None, 0.0


class ParameterListGate:
    """`ask` for each request of a list, `heard` for each PARAM_VALUE, `due` when `next_at` has come."""

    __slots__ = (
        "_count",
        "_frame",
        "_indices",
        "_sent_at",
        "_since",
        "_turn",
        "_waited",
        "_waiting",
        "abandoned",
        "finished",
        "unfinished",
    )

    def __init__(self) -> None:
        self._turn = TurnGate(SILENCE_S, LONGEST_LIST_S)
        self._frame: ThirdPartyFrame | None = None
        self._since = self._sent_at = 0.0
        self._waited = False
        """The running list's request waited for its turn; its sender has perhaps stopped repeating it."""
        self._count = 0
        self._indices = 0
        """A bit for each index that came."""
        self._waiting: dict[tuple[int, int], ThirdPartyFrame] = {}
        """By target system and component, in the order of their turns."""
        self.finished = 0
        """Lists of which every value came."""
        self.unfinished = 0
        """Lists that ended before that."""
        self.abandoned = 0
        """Requests that waited until their sender had gone."""

    def ask(self, frame: ThirdPartyFrame, now: float) -> Literal["send", "hold", "repeat"]:
        """A request for the list of one system; "hold": it waits, "repeat": its list comes or is waited for already."""
        self._end(now)
        vehicle, running = (frame.target, frame.component), self._frame
        if running is None and not self._waiting:
            self._begin(frame, now)
            return "send"
        if running is not None and vehicle == (running.target, running.component):
            if self._count or now - self._sent_at < RESEND_S:
                return "repeat"
            self._sent_at = now
            return "send"
        known = vehicle in self._waiting
        if known or len(self._waiting) < MAX_WAITING:
            self._waiting[vehicle] = frame  # keeps the turn of the one before
        return "repeat" if known else "hold"

    def heard(self, system: int, component: int, index: int, count: int, now: float) -> None:
        """A PARAM_VALUE came down; ``count`` is how many there are. The list has ended when every index came."""
        running = self._frame
        if running is None or system != running.target or not 0 <= index < count:
            return
        if component == (running.component or ALL_COMPONENTS_ANSWER):
            self._turn.heard(system, now)
            self._indices |= 1 << index
            self._count = count

    def due(self, now: float, is_there: Callable[[int], bool]) -> ThirdPartyFrame | None:
        """The request that may be sent now, for the first time or again. ``is_there``: whether a source still sends."""
        self._end(now)
        if self._frame is not None and (resend_at := self._resend_at) is not None and now >= resend_at:
            self._sent_at = now
            return self._frame
        while self._frame is None and self._waiting:
            frame = self._waiting.pop(next(iter(self._waiting)))
            if is_there(frame.source):
                self._begin(frame, now)
                self._waited = True
                return frame
            self.abandoned += 1
        return None

    def next_at(self, now: float) -> float | None:
        """When `due` may give something; None: not before somebody asks."""
        times: list[float] = []
        if self._frame is not None and (resend_at := self._resend_at) is not None:
            times.append(resend_at)
        if self._waiting:
            times.append(now if self._frame is None or self._is_complete else self._turn.ends_at)
        return max(now, min(times)) if times else None

    @property
    def waiting(self) -> list[int]:
        """Systems whose lists wait, in the order of their turns."""
        return [system for system, _ in self._waiting]

    @property
    def running(self) -> tuple[int, int, int] | None:
        """System whose list comes, values seen and values there are (0: not known yet)."""
        return None if self._frame is None else (self._frame.target, self._indices.bit_count(), self._count)

    def clear(self) -> int:
        """Forget all of them (the link went down); how many waited."""
        gone = len(self._waiting)
        self._frame = None
        self._turn.end()
        self._waiting.clear()
        return gone

    def status(self, now: float) -> dict[str, Any]:
        self._end(now)
        running = None
        if self._frame is not None:
            age_s = round(now - self._since, 1)
            running = {
                "sysid": self._frame.target,
                "seen": self._indices.bit_count(),
                "count": self._count,
                "age_s": age_s,
            }
        return {
            "running": running,
            "waiting": self.waiting,
            "finished": self.finished,
            "unfinished": self.unfinished,
            "abandoned": self.abandoned,
        }

    @property
    def _resend_at(self) -> float | None:
        """When the running list's request is sent again; None: its values come, or its sender repeats it."""
        at = self._sent_at + RESEND_S
        return at if self._waited and not self._count and at < self._turn.ends_at else None

    @property
    def _is_complete(self) -> bool:
        return 0 < self._count <= self._indices.bit_count()

    def _begin(self, frame: ThirdPartyFrame, now: float) -> None:
        self._frame, self._since, self._sent_at = frame, now, now
        self._waited = False
        self._indices = self._count = 0
        self._turn.begin(frame.target, now, FIRST_VALUE_S)

    def _end(self, now: float) -> None:
        if self._frame is None or (self._turn.running(now) is not None and not self._is_complete):
            return
        self.finished += self._is_complete
        self.unfinished += not self._is_complete
        self._frame = None
        self._turn.end()
