"""How much one page may ask: rates, requests that wait, the size of a message. Pure.

An order that ends a flight has an allowance of its own, so that no flood of other requests is in front of it.
"""

from __future__ import annotations

from skygcs.core.token_bucket import TokenBucket
from skygcs.spelling import is_number

MAX_MESSAGE_BYTES = 4 << 20
"""A plan for a fleet of 50 with its trajectories is some 2 MB as text."""

REQUESTS_PER_S, REQUEST_BURST = 50.0, 200.0
"""A page asks a few times a second; opening a panel asks ten times at once."""

ENDING_PER_S, ENDING_BURST = 20.0, 40.0
"""Bounds of STOP and its like: a key that repeats sends 30 a second."""

MAX_WAITING, MAX_ENDING_WAITING = 16, 16
"""Requests without an answer yet: of a page, and those that end a flight of a browser with all its pages. The daemon
takes 64 of the latter from all."""

MAX_REFUSED = 2000
"""Refused requests after which the page is closed: it does not read the refusals."""

MAX_ID_CHARS, MAX_ID = 64, 1 << 63
"""Bounds of a request's id, which its answer repeats; answers that are not read wait."""

READ_BYTES_PER_S, READ_MESSAGES_PER_S, READ_AHEAD_S = 4 << 20, 200.0, 3.0
"""A page is read from so quickly on the average, and for so long without a pause: 12 MiB or 600 messages. To read and
refuse takes 20 µs a message and 20 ms for 4 MiB, in which nobody else's STOP is passed on."""

DEADLINE_MAX_S = 30.0
"""An order may not lie about for longer than STOP repeats itself."""


class PageLimits:
    """The allowance of one page."""

    def __init__(self, now: float) -> None:
        self._requests = TokenBucket(REQUESTS_PER_S, REQUEST_BURST, now)
        self._ending = TokenBucket(ENDING_PER_S, ENDING_BURST, now)
        self._waiting = self.ending_waiting = 0
        self.refused = 0
        self._read_until = now - READ_AHEAD_S

    def pause_s(self, size: int, now: float) -> float:
        """After a message of ``size`` bytes, whatever was in it: how long not to read from the page."""
        began = max(self._read_until, now - READ_AHEAD_S)
        self._read_until = began + size / READ_BYTES_PER_S + 1.0 / READ_MESSAGES_PER_S
        return max(self._read_until - now, 0.0)

    @property
    def exceeded(self) -> bool:
        """True if the page has to be closed."""
        return self.refused >= MAX_REFUSED

    def begin(self, now: float, *, ends_flight: bool, others: int = 0) -> str | None:
        """Why a request is refused; None: it may go, and `end` is called when it was answered. ``others``: those that
        end a flight and wait on other pages of the same browser."""
        bucket, waiting, most = (
            (self._ending, self.ending_waiting + others, MAX_ENDING_WAITING)
            if ends_flight
            else (self._requests, self._waiting, MAX_WAITING)
        )
        if not bucket.take(now):
            self.refused += 1
            return f"at most {bucket.rate:g} requests a second; this one was not carried out"
        if waiting >= most:
            self.refused += 1
            return f"at most {most} requests may wait for their answer; this one was not carried out"
        if ends_flight:
            self.ending_waiting += 1
        else:
            self._waiting += 1
        return None

    def end(self, *, ends_flight: bool) -> None:
        """A request was answered."""
        if ends_flight:
            self.ending_waiting -= 1
        else:
            self._waiting -= 1


def deadline_problem(deadline_s: object, now: float) -> str | None:
    """Why an order with this deadline is not carried out; None: it is in time."""
    if not is_number(deadline_s):
        return "an order needs deadline_s, in the clock of web.hello"
    if not deadline_s <= now + DEADLINE_MAX_S:
        return f"deadline_s is more than {DEADLINE_MAX_S:g} s ahead"
    if deadline_s < now:
        return f"came {now - max(deadline_s, 0.0):.1f} s after its deadline; it was not carried out"
    return None
