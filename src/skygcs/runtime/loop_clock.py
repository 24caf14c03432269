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

`ControlClock` ticks on absolute deadlines: a late one does not move the next, and missed ones are skipped and counted.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

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


# --- control clock ----------------------------------------------------------------------------------------------------


LATE_S = 0.005
"""A tick this long after its deadline is counted as late: a quarter of a period at 50 Hz."""

TICKS_KEPT = 500
"""Number of ticks whose lateness is kept for percentiles: ten seconds at 50 Hz."""

SPREAD_S = 0.05
"""Time over which clocks started together are spread: a period at 20 Hz, in which fifty vehicles have 1 ms each."""


class ControlClock:
    """Calls ``tick(now)`` every ``period_s()`` seconds between `start` and `stop`.

    The period may change from tick to tick. ``tick`` must not raise. ``phase`` (0..1) is the part of a period, of
    SPREAD_S at most, that the first tick waits: clocks that are started together tick one after the other.
    ``running_clocks`` has it while it runs.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        tick: Callable[[float], None],
        period_s: Callable[[], float],
        *,
        phase: float = 0.0,
        running_clocks: set[ControlClock] | None = None,
    ) -> None:
        self.ticks = 0
        self.late = 0
        self.skipped = 0
        self._loop = loop
        self._tick = tick
        self._period_s = period_s
        self._phase = phase
        self._running_clocks = set() if running_clocks is None else running_clocks
        self._due = 0.0
        self._pace_s = 0.0
        """The period when the next deadline was set."""
        self._handle: asyncio.TimerHandle | None = None
        self._lateness_s: deque[float] = deque(maxlen=TICKS_KEPT)

    @property
    def running(self) -> bool:
        return self._handle is not None

    @property
    def due(self) -> float:
        """Time at which the next tick is due, or was if it is late. Only while the clock runs."""
        return self._due

    def start(self) -> None:
        """Start; the first tick comes at once, or ``phase`` later. Without effect while it runs."""
        if self._handle is None:
            self._pace_s = self._period_s()
            self._due = self._loop.time() + self._phase * min(self._pace_s, SPREAD_S)
            self._handle = self._loop.call_at(self._due, self._run)
            self._running_clocks.add(self)

    def stop(self) -> None:
        """Stop ticking. Idempotent."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
            self._running_clocks.discard(self)

    def lateness_p99_s(self) -> float | None:
        """99th percentile of the last ticks; None before the first."""
        if not self._lateness_s:
            return None
        ordered = sorted(self._lateness_s)
        return ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))]

    def as_dict(self) -> dict[str, Any]:
        p99_s = self.lateness_p99_s()
        return {
            "ticks": self.ticks,
            "late": self.late,
            "skipped": self.skipped,
            "lateness_p99_s": None if p99_s is None else round(p99_s, 6),
        }

    def _run(self) -> None:
        now, handle = self._loop.time(), self._handle
        lateness_s = now - self._due if now > self._due else 0.0
        self.ticks += 1
        self.late += lateness_s > LATE_S
        self._lateness_s.append(lateness_s)
        try:
            self._tick(now)
        finally:
            if self._handle is handle:  # it was neither stopped nor restarted
                self._handle = self._loop.call_at(self._next(now), self._run)

    def _next(self, now: float) -> float:
        """The next deadline after ``now``; deadlines that have passed are skipped. A longer period holds from the next
        tick on, a shorter one at once."""
        before_s, self._pace_s = self._pace_s, self._period_s()
        self._due += before_s
        if self._due <= now:
            missed = int((now - self._due) / before_s) + 1
            self.skipped += missed
            self._due += missed * before_s
        if self._pace_s < before_s and self._due > now + self._pace_s:
            self._due = now + self._pace_s
        return self._due
