"""The vehicle's own clock: how long it has been up, and when it starts again.

time_boot_ms goes back ...                                  means
--------------------------------------------------------    ------------------------------------------------
by less than JITTER_MS                                      frames out of order
at the 32-bit wrap                                          nothing
after a silence of SILENCE_S or more                        a reboot: it takes seconds
while the clock before was heard just now, and that one     a reboot, found CONFIRM_S later
is not heard again
... and that one is heard again                             two vehicles with one system id: no reboot
"""

from __future__ import annotations

JITTER_MS = 3000
"""Frames of one vehicle over two links, or queued in a radio, arrive up to this much out of order."""

WRAP_MS = 1 << 32
WRAP_MARGIN_MS = 600_000
"""time_boot_ms is 32 bits: it starts at 0 again after 49.7 days, which is no reboot."""

SILENCE_S = 2.5
"""No autopilot restarts faster (ArduPilot and PX4 take 3 s and more until they send again); what two vehicles send
comes more often."""

CONFIRM_S = 2.5
"""A clock that went back without a silence has to be the only one for so long."""

TWO_CLOCKS_S = 10.0
"""Two clocks are one again when only one was heard for so long."""


class BootClock:
    """Fed with every time_boot_ms looked at; `on_boot_ms` says whether the vehicle has started anew since the last."""

    __slots__ = ("_at", "_before", "_boot_ms", "_two_at", "went_back_at")

    def __init__(self) -> None:
        self._boot_ms: int | None = None
        self._at = 0.0
        self._before: tuple[int, float] | None = None
        """The clock before it went back, and when that was heard last."""
        self._two_at = float("-inf")
        self.went_back_at: float | None = None
        """Since when there may be another clock; None: there is one. Look closely meanwhile."""

    def on_boot_ms(self, boot_ms: int, now: float) -> bool:
        if self._before is not None and self._is_the_one_before(boot_ms, now):
            self._two_at = now
            self._before = self.went_back_at = None
            self._boot_ms, self._at = boot_ms, now
            return False
        last = self._boot_ms
        if last is None or boot_ms >= last:
            silent_s = now - self._at
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

    def _is_the_one_before(self, boot_ms: int, now: float) -> bool:
        """Whether this continues the clock that was there before, rather than the new one."""
        assert self._before is not None and self._boot_ms is not None
        before_ms, at = self._before
        off_before = abs(boot_ms - before_ms - 1000 * (now - at))
        return off_before < abs(boot_ms - self._boot_ms - 1000 * (now - self._at))

    def _confirmed(self, now: float) -> bool:
        if self.went_back_at is None or now - self.went_back_at < CONFIRM_S:
            return False
        return self._found_alone(now)

    def _found_alone(self, now: float) -> bool:
        """The clock that went back is the only one; whether that is a reboot, not the one of two that is left."""
        went_back = self.went_back_at is not None and not self.two_clocks(now)
        self._before = self.went_back_at = None
        return went_back

    def two_clocks(self, now: float) -> bool:
        """Whether two vehicles speak under this id, by their clocks."""
        return now - self._two_at < TWO_CLOCKS_S

    def forget(self) -> None:
        """A boot text reported the reboot: the next time_boot_ms is a new beginning, not a second reboot."""
        self._boot_ms = None
        self._before = self.went_back_at = None

    def uptime_s(self, now: float) -> float | None:
        return None if self._boot_ms is None else self._boot_ms / 1000 + (now - self._at)
