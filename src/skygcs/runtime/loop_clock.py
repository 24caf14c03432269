"""Clocks of the daemon: exact where uvloop rounds to whole milliseconds, one for gates, and what a sleep does to them.

    clock              while this computer sleeps    read by
    ---------------    --------------------------    -------------------------------------------------------
    CLOCK_MONOTONIC    stands still                  both loops (`exact_clock`): states, deadlines
    CLOCK_BOOTTIME     goes on                       gates, and what counts across computers (`boot_clock`)

`SleepWatch` notices that this computer slept or this process stood still: what came before, or waited meanwhile, looks
fresh.

    slept         what the second clock gains on the first is the time that was slept
    stood still   the clock went on, and nothing was done, though a timer is due every BEAT_S: the process was stopped
                  (SIGSTOP, a paused container, a debugger), or had no processor or memory for so long
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import NamedTuple

from skygcs.config.files import boot_s

SAME_WITHIN_S = 10.0
"""uvloop's clock is that of the begin of the turn, in whole milliseconds; a turn takes no 10 s."""

EARLY_S = 0.001
"""uvloop's clock has whole milliseconds and rounds delays: a timer may fire up to half a millisecond early."""

LEAST_SLEEP_S = 0.5
"""A shorter sleep is no older than a late message. The two clocks are otherwise equal to the microsecond."""

PAIRED_WITHIN_S = 0.01
PAIRED_TRIES = 100
"""Clocks that are read further apart than this are no pair. Two readings take a microsecond; one try in a hundred is
not interrupted, however busy the computer is."""

BEAT_S = 0.5
"""Period of `SleepWatch.beat`."""

STOOD_STILL_S = 4.0
"""A longer pause is a standstill. By then autopilots have acted without us (PX4 after COM_OF_LOSS_T, 1 s,
ArduCopter after GUID_TIMEOUT, 3 s), and the guard would hold, as no state may be older than 2 s; the worst turn of a
daemon with 236 vehicles and five greedy clients takes half of it."""


def exact_clock(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """Return the clock that `loop.time` counts, without the rounding of uvloop: CLOCK_MONOTONIC, as both loops use it.
    A loop in virtual time keeps its own."""
    return time.monotonic if abs(loop.time() - time.monotonic()) < SAME_WITHIN_S else loop.time


def boot_clock(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """A clock that all processes of this machine read alike and that runs on while the machine sleeps, read anew at
    each call: CLOCK_BOOTTIME. A loop in virtual time keeps its own."""
    if exact_clock(loop) == loop.time:
        return loop.time
    return boot_s


def slept_s() -> float:
    """How long this computer has slept since it was started. The two clocks are read again if the process was stopped
    between them, which would look like a sleep."""
    for _ in range(PAIRED_TRIES):
        before_s = time.monotonic()
        booted_s = boot_s()
        if time.monotonic() - before_s < PAIRED_WITHIN_S:
            break
    return booted_s - before_s


class DeadlineTimer:
    """Calls ``ring()`` once at the time it is `set` for, or later, never before. An owner of several deadlines sets it
    to the earliest whenever one of them may have changed, and after each ring.

    The time is kept here because uvloop returns a plain Handle without ``when`` for a time that is almost due.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, ring: Callable[[], None]) -> None:
        self._loop = loop
        self._ring = ring
        self._timer: asyncio.Handle | None = None
        self._due: float | None = None

    @property
    def due(self) -> float | None:
        """Time at which the timer is due; None: it is not set."""
        return self._due

    def set(self, due: float | None) -> None:
        """Set it to this loop time; None: do not ring."""
        if due == self._due:
            return
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._due = due
        if due is not None:
            self._timer = self._loop.call_at(due, self._rang)

    def _rang(self) -> None:
        due = self._due
        if due is not None and self._loop.time() < due:
            # not at once: the loop would spin until its clock has advanced
            self._timer = self._loop.call_later(EARLY_S, self._rang)
            return
        self._timer = self._due = None
        self._ring()


PAUSED = "this computer slept, or skygcs stood still"
"""Begin of a sentence for a person, where it is not known for how long."""


class Standstill(NamedTuple):
    """A pause in which this process did nothing. ``slept``: the loop's clock stood still with it."""

    seconds: float
    slept: bool

    @property
    def missed_s(self) -> float:
        """Seconds of the pause that the loop's clock has not counted."""
        return self.seconds if self.slept else 0.0

    @property
    def name(self) -> str:
        """Noun for a person, as after "before"."""
        return "a sleep of this computer" if self.slept else "a standstill of skygcs"

    @property
    def text(self) -> str:
        """Begin of a sentence for a person."""
        if self.slept:
            return f"this computer slept for {self.seconds:.0f} s"
        return f"skygcs stood still for {self.seconds:.0f} s (it was stopped, or this computer overloaded)"


class SleepWatch:
    """Call `check` before anything is done with a state, an input or a deadline of before. ``on_woke`` is called once
    after each pause, by the loop and so amid nothing; until it has returned, everything is held back.

    A standstill is measured from the `check` before, so a long turn of the loop that asks again and again is not one.
    It is noticed from the first `beat` on.
    """

    def __init__(
        self,
        on_woke: Callable[[Standstill], None],
        loop: asyncio.AbstractEventLoop,
        slept_s: Callable[[], float] = slept_s,
    ) -> None:
        self.clock = boot_clock(loop)
        """Counts sleeps and standstills alike, so that one reading shows that there was neither."""
        self.slept_s = slept_s
        self._on_woke = on_woke
        self._loop = loop
        self._known_s = slept_s()
        self._checked_at = self.clock()
        self._beats = False
        self._untold = 0

    def beat(self) -> None:
        """Call it every BEAT_S, by a timer of the loop."""
        self.check()
        self._beats = True

    def check(self) -> bool:
        """True if the computer has slept, or the process stood still, and ``on_woke`` has not returned since: what was
        decided on, read or asked for before must not be acted on. Hot: one reading of a clock."""
        now = self.clock()
        gap_s, self._checked_at = now - self._checked_at, now
        if gap_s >= LEAST_SLEEP_S:
            self._look(gap_s)
        return self._untold > 0

    def _look(self, gap_s: float) -> None:
        slept_s = self.slept_s()
        seconds = slept_s - self._known_s
        if seconds >= LEAST_SLEEP_S:
            self._known_s = slept_s
            pause = Standstill(seconds, slept=True)
        elif self._beats and gap_s >= STOOD_STILL_S:
            pause = Standstill(gap_s, slept=False)
        else:
            return
        self._untold += 1
        self._loop.call_soon(self._tell, pause)

    def _tell(self, pause: Standstill) -> None:
        try:
            self._on_woke(pause)
        finally:
            self._untold -= 1
