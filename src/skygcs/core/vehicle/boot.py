"""Finds reboots by the vehicle's time_boot_ms.

time_boot_ms ...                                            interpretation
--------------------------------------------------------    ------------------------------------------------
goes back by less than JITTER_MS                            frames out of order
goes back at the 32-bit wrap                                nothing
goes back after a silence of SILENCE_S or more              a reboot: a start takes seconds
goes back just after the old clock was heard, and the       a reboot, reported CONFIRM_S later
old clock is not heard again
... and the old clock is heard again                        two vehicles with one system id: no reboot
is shorter than the silence before it, and behind the       a reboot, reported CONFIRM_S later: it was started
old clock by more than JITTER_MS, and goes on at the        during the silence
rate of time
... and it comes up with the old clock                      frames that a radio had kept: no reboot
"""

from __future__ import annotations

JITTER_MS = 3000
"""Frames of one vehicle over two links, or queued in a radio, arrive up to this much out of order."""

WRAP_MS = 1 << 32
WRAP_MARGIN_MS = 600_000
"""time_boot_ms has 32 bits: it wraps to 0 after 49.7 days."""

SILENCE_S = 2.5
"""No autopilot restarts faster (ArduPilot and PX4 take 3 s and more until they send again); with two vehicles frames
come more often."""

CONFIRM_S = 2.5
"""How long a clock that went back without a silence must be the only one heard to count as a reboot."""

STEADY_MS = 1250
"""How exactly a clock that may have begun in a silence must go on at the rate of time, for CONFIRM_S: frames that were
kept come faster than they were sent, at more than 1.5 times the rate."""

TWO_CLOCKS_S = 10.0
"""When only one of two clocks was heard for this time, there is one vehicle again."""


class BootClock:
    """`on_boot_ms` takes each time_boot_ms that is read and returns whether the vehicle has restarted since the
    last."""

    __slots__ = ("_at", "_before", "_boot_ms", "_two_at", "_young", "went_back_at")

    def __init__(self) -> None:
        self._boot_ms: int | None = None
        self._at = 0.0
        self._before: tuple[int, float] | None = None
        """The clock as it was before it went back, and when that was heard last."""
        self._young: tuple[int, float] | None = None
        """A clock that may have begun in the silence after `_before`: a value, and when it came."""
        self._two_at = float("-inf")
        self.went_back_at: float | None = None
        """Since when there may be a second clock; None: there is one clock. While set, every clock must be read."""

    def on_boot_ms(self, boot_ms: int, now: float) -> bool:
        if self._young is not None:
            return self._is_steady(boot_ms, now, self._young)
        if self._before is not None and self._is_the_one_before(boot_ms, now):
            self._two_at = now
            self._before = self.went_back_at = None
            self._boot_ms, self._at = boot_ms, now
            return False
        last, silent_s = self._boot_ms, now - self._at
        if last is not None and self._began_in_silence(boot_ms, silent_s):
            self._before, self._young, self.went_back_at = (last, self._at), (boot_ms, now), now
            self._boot_ms, self._at = boot_ms, now
            return False
        if last is None or boot_ms >= last:
            self._boot_ms, self._at = boot_ms, now
            return self._confirmed(now) if silent_s < SILENCE_S else self._found_alone(now)
        if last - boot_ms <= JITTER_MS:
            return self._confirmed(now)
        wrapped = last > WRAP_MS - WRAP_MARGIN_MS and boot_ms < WRAP_MARGIN_MS
        before, self._boot_ms, self._at = (last, self._at), boot_ms, now
        if wrapped:
            return False
        if now - before[1] >= SILENCE_S:
            self._before = self.went_back_at = None
            return True
        self._before, self.went_back_at = before, now
        return False

    def _began_in_silence(self, boot_ms: int, silent_s: float) -> bool:
        """True if its clock began during the silence before this value."""
        silent_ms, last = 1000 * silent_s, self._boot_ms
        if last is None or silent_s < SILENCE_S or last > WRAP_MS - WRAP_MARGIN_MS:
            return False
        return last - JITTER_MS <= boot_ms <= silent_ms and boot_ms < last + silent_ms - JITTER_MS

    def _is_steady(self, boot_ms: int, now: float, young: tuple[int, float]) -> bool:
        """True if the clock that may have begun in a silence has; while that is not decided, and if not, False."""
        assert self._before is not None
        self._boot_ms, self._at = boot_ms, now
        if abs(_ahead_ms(boot_ms, now, self._before)) <= JITTER_MS:
            self._young = self._before = self.went_back_at = None
            return False
        if now - young[1] < CONFIRM_S:
            return False
        if abs(_ahead_ms(boot_ms, now, young)) > STEADY_MS:
            self._young = boot_ms, now
            return False
        self._young = self._before = self.went_back_at = None
        return True

    def _is_the_one_before(self, boot_ms: int, now: float) -> bool:
        """True if this value continues the old clock rather than the new one."""
        assert self._before is not None and self._boot_ms is not None
        ahead_ms = _ahead_ms(boot_ms, now, self._before)
        return abs(ahead_ms) < abs(_ahead_ms(boot_ms, now, (self._boot_ms, self._at)))

    def _confirmed(self, now: float) -> bool:
        if self.went_back_at is None or now - self.went_back_at < CONFIRM_S:
            return False
        return self._found_alone(now)

    def _found_alone(self, now: float) -> bool:
        """The clock that went back is the only one. True if that is a reboot, not the remaining one of two vehicles."""
        went_back = self.went_back_at is not None and not self.two_clocks(now)
        self._before = self.went_back_at = None
        return went_back

    def two_clocks(self, now: float) -> bool:
        """True if the clocks show two vehicles with this id."""
        return now - self._two_at < TWO_CLOCKS_S

    def forget(self) -> None:
        """A boot text reported the reboot: the next time_boot_ms starts a new clock and is not a second reboot."""
        self._boot_ms = None
        self._before = self._young = self.went_back_at = None

    def uptime_s(self, now: float) -> float | None:
        return None if self._boot_ms is None else self._boot_ms / 1000 + (now - self._at)


def _ahead_ms(boot_ms: int, now: float, clock: tuple[int, float]) -> float:
    """How far a value is ahead of a clock that had another one at another time, ms."""
    return boot_ms - clock[0] - 1000 * (now - clock[1])
