"""All parameters of one vehicle, complete or said to be incomplete, without flooding the link.

Rule: everything that decides how a list of parameters goes on is in this file.

    state      what came                                      next       effects
    --------   --------------------------------------------   --------   -------------------------------------------
    IDLE       start                                          FILLING    requests, from index 0 on (BURST: one
                                                                         PARAM_REQUEST_LIST, if asked for)
    BURST      a value                                        BURST      Report
    BURST      timer: nothing new for a while                 FILLING    requests of the indices that are missing
    FILLING    a value                                        FILLING    Report, the next requests
    FILLING    timer: an answer overdue, or its turn          FILLING    requests
    FILLING    timer: silent too long, or given up            DONE       Finish: timeout or incomplete
    FILLING    the list is not the one it was                 DRAINING   - (what is still on its way belongs to the old)
    DRAINING   timer                                          FILLING    requests, from index 0 on
    BURST, FILLING   the last value                           DONE       Finish: accepted
    not DONE   stop (cancelled, vehicle lost, ...)            DONE       Finish: as given
    DONE       anything                                       DONE       -

Requests go one index each, a few of them under way at a time, not faster than the bytes a second that the answers may
take; on a link that nothing limits, as fast as they are answered. The burst is what ground stations commonly do; on a
radio that several vehicles share it drowns everything else, and most of it is lost (QGroundControl #6847: 60 %).

A vehicle's list changes when a feature is turned on or off: then param_count differs, or an index has another name, and
all indices may have moved. That is believed when no answer of the old list has come for LATE_VALUE_S. A change that
leaves count and indices as they are is seen by PX4's hash only (`HASH_NAME`), before and after.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from skygcs.core.mavlink.param_encoding import HASH_NAME, Param, ParamType, ParamValue
from skygcs.core.protocols.base import Effect, Finish, ProgressReport, ProtocolMachine, Send, SlidingWindow
from skygcs.core.protocols.parameter import LATE_VALUE_S

VALUE_BYTES = 37
"""PARAM_VALUE as a whole MAVLink 2 frame, which is what a request brings down."""

BYTES_PER_S = 2880.0
"""Half of what 57600 baud carry; the other half stays for telemetry."""

WINDOW = 8
"""Requests under way. ArduPilot queues 20 and forgets what does not fit; at 57600 baud eight answers are 50 ms."""

WIDE_WINDOW = 16
"""The same on a link that nothing limits, where the time of a round trip is all that counts."""

BURST_QUIET_S = 2.0
"""A burst in which nothing new came for so long is over: ArduPilot slows down to a value every 0.5 s at worst."""

MAX_TRIES = 20
"""Requests of one index. With 20 % lost each way, one index in 700 million needs more."""

SILENCE_S = 30.0
"""A vehicle that says nothing of its parameters for so long will not."""

MAX_COUNT = 10_000
"""ArduPilot has some 1500 parameters, PX4 some 1800; a count beyond this is not one."""

MAX_RESTARTS = 4
MAX_NAMED = 10
"""Missing indices named in the message."""


@dataclass(frozen=True, slots=True)
class ListProgress:
    """How far a list is; ``count`` and ``remaining_s`` are None while not known."""

    received: int
    count: int | None
    sent: int
    elapsed_s: float
    remaining_s: float | None


@dataclass(frozen=True, slots=True)
class ListOutcome:
    """``params`` in the vehicle's own order; all of them if ``ok``.

    ``result`` is accepted, incomplete, timeout, changing (the list was another one every time), cancelled or lost.
    """

    ok: bool
    result: str
    message: str
    params: tuple[Param, ...]
    count: int | None
    sent: int
    elapsed_s: float


class ListState(Enum):
    IDLE = auto()
    BURST = auto()
    FILLING = auto()
    DRAINING = auto()
    DONE = auto()


class ParamList(ProtocolMachine):
    """See the table at the top. Only PARAM_VALUEs of this vehicle may be handed in.

    ``bytes_per_s``: what the answers may take of the link; None: as fast as the window lets them. ``stops_burst``: the
    vehicle stops a burst on request (PX4).
    """

    def __init__(
        self,
        *,
        burst: bool = False,
        window: int = WINDOW,
        bytes_per_s: float | None = BYTES_PER_S,
        stops_burst: bool = False,
    ) -> None:
        # state and outcome
        self.state = ListState.IDLE
        self.outcome: ListOutcome | None = None
        self.count: int | None = None
        self.sent = 0
        """Messages sent: at most 1 + (MAX_RESTARTS + 1) * MAX_TRIES for each parameter."""
        # requests
        self._burst = burst
        self._stops_burst = stops_burst
        spacing_s = 0.0 if bytes_per_s is None else VALUE_BYTES / bytes_per_s
        self._requests = SlidingWindow(
            self._next_index, self._is_missing, size=window, spacing_s=spacing_s, max_tries=MAX_TRIES
        )
        # times and counters
        self._started = 0.0
        self._began = 0.0
        self._heard = 0.0
        self._matched = 0.0
        self._strangers = 0
        self._restarts = 0
        self._percent = -1
        # parameters so far
        self._names: dict[int, str] = {}
        self._params: dict[str, Param] = {}
        self._index_of: dict[str, int] = {}
        self._requested = 0
        """Indices below this were requested, or came."""

    @property
    def done(self) -> bool:
        return self.state is ListState.DONE

    def progress(self, now: float) -> ListProgress:
        received, remaining_s = len(self._names), None
        if self.count is not None and received >= 5 and now > self._began:
            remaining_s = (self.count - received) * (now - self._began) / received
        return ListProgress(received, self.count, self.sent, now - self._started, remaining_s)

    def start(self, now: float) -> tuple[Effect, ...]:
        assert self.state is ListState.IDLE, "start is called once"
        self._started = self._began = self._heard = self._matched = now
        if not self._burst:
            self.state = ListState.FILLING
            return self._fill(now)
        self.state = ListState.BURST
        self.deadline = now + BURST_QUIET_S
        self.sent += 1
        return (Send("PARAM_REQUEST_LIST", {}),)

    def on_value(self, value: ParamValue, now: float) -> tuple[Effect, ...]:
        """Any PARAM_VALUE of this vehicle."""
        if self.state not in (ListState.BURST, ListState.FILLING) or not 0 < value.count <= MAX_COUNT:
            return ()
        # a value out of the list: somebody reads or sets single ones
        param, index = value.param, value.index
        if index is None:
            if param.name in self._params:  # somebody has set it meanwhile
                self._params[param.name] = param
            return ()
        self._heard = now
        if self.count is None:
            self.count = value.count
        # a value of another list: the vehicle restarted, or has changed its number of parameters
        if value.count != self.count or self._contradicts(index, param.name):
            self._strangers += 1
            late = now - self._matched >= LATE_VALUE_S
            return self._restart(now) if late and self._strangers > 1 else ()
        # a value of this list
        self._matched = now
        self._strangers = 0
        self._requests.answered(index, now)
        new = index not in self._names
        self._names[index] = param.name
        self._index_of[param.name] = index
        self._params[param.name] = param
        if len(self._names) == self.count:
            return self._finish(now, "accepted", f"{self.count} parameters")
        if self.state is ListState.BURST:
            if new:
                self.deadline = now + BURST_QUIET_S
            return self._report()
        return self._report() + self._fill(now)

    def on_timer(self, now: float) -> tuple[Effect, ...]:
        if self.deadline is None or now < self.deadline:
            return ()
        if self.state is ListState.DRAINING:
            self._began = self._heard = self._matched = now
        self.state = ListState.FILLING
        return self._fill(now)

    def stop(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        """End it from outside; a burst that the vehicle does not stop on request goes on, and the message says so."""
        if self.state in (ListState.IDLE, ListState.DONE):
            return ()
        if self.state is not ListState.BURST:
            return self._finish(now, result, message)
        if not self._stops_burst:
            return self._finish(now, result, f"{message}; it goes on sending its list to the end")
        stop = Send("PARAM_SET", {"param_id": HASH_NAME, "param_value": 0, "param_type": int(ParamType.UINT32)})
        return (stop, *self._finish(now, result, message))

    def _contradicts(self, index: int, name: str) -> bool:
        """True if it does not fit what came before: the vehicle counts its parameters anew."""
        return self._names.get(index, name) != name or self._index_of.get(name, index) != index

    def _restart(self, now: float) -> tuple[Effect, ...]:
        if self._restarts == MAX_RESTARTS:
            text = f"its list of parameters was another one {MAX_RESTARTS + 1} times; is somebody else changing it?"
            return self._finish(now, "changing", text)
        self._restarts += 1
        self.state = ListState.DRAINING
        self.deadline = now + LATE_VALUE_S
        self.count = None
        self._strangers = 0
        self._percent = -1
        for table in (self._names, self._params, self._index_of):
            table.clear()
        self._requests.clear()
        self._requested = 0
        return ()

    def _fill(self, now: float) -> tuple[Effect, ...]:
        """Ask for what is missing, as many as may be under way, in their turns; sets the deadline."""
        if now >= self._heard + SILENCE_S:  # as the deadline is reckoned: a rounding must not ask for it again
            text = f"nothing more of its parameters came for {SILENCE_S:.0f} s{self._missing()}"
            return self._finish(now, "incomplete" if self._names else "timeout", text)
        indices = self._requests.advance(now)
        if self._requests.due == math.inf:
            return self._finish(now, "incomplete", f"incomplete after {MAX_TRIES} requests each{self._missing()}")
        self.deadline = min(self._requests.due, self._heard + SILENCE_S)
        self.sent += len(indices)
        return tuple(Send("PARAM_REQUEST_READ", {"param_id": "", "param_index": index}) for index in indices)

    def _next_index(self) -> int | None:
        """The next index that was not requested yet; only 0 while it is not known how many there are."""
        while self._requested in self._names:
            self._requested += 1
        if self._requested >= (self.count or 1):
            return None
        self._requested += 1
        return self._requested - 1

    def _is_missing(self, index: int) -> bool:
        return index not in self._names

    def _report(self) -> tuple[Effect, ...]:
        assert self.count is not None
        percent = 100 * len(self._names) // self.count
        if percent == self._percent:
            return ()
        self._percent = percent
        return (ProgressReport(percent),)

    def _missing(self) -> str:
        if self.count is None:
            return ""
        missing = [i for i in range(self.count) if i not in self._names]
        more = ", …" if len(missing) > MAX_NAMED else ""
        named = ", ".join(map(str, missing[:MAX_NAMED]))
        return f"; {len(missing)} of {self.count} are missing (index {named}{more})"

    def _finish(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        self.state = ListState.DONE
        self.deadline = None
        params = tuple(self._params[self._names[i]] for i in sorted(self._names))
        elapsed_s = now - self._started
        self.outcome = ListOutcome(result == "accepted", result, message, params, self.count, self.sent, elapsed_s)
        return (Finish(),)
