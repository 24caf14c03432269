"""The vehicle's own clock: how long it has been up, and when it starts again."""

from __future__ import annotations

JITTER_MS = 3000
"""Frames of one vehicle over two links, or queued in a radio, arrive up to this much out of order."""

WRAP_MS = 1 << 32
WRAP_MARGIN_MS = 600_000
"""time_boot_ms is 32 bits: it starts at 0 again after 49.7 days, which is no reboot."""

QUARREL_S = 20.0
QUARREL_COUNT = 3
"""So many reboots in so short a time are two vehicles that share one system id."""


class BootClock:
    """Fed with every time_boot_ms looked at; `on_boot_ms` says whether the vehicle has started anew since the last."""

    __slots__ = ("_at", "_boot_ms", "_recent", "quarrel")

    def __init__(self) -> None:
        self._boot_ms: int | None = None
        self._at = 0.0
        self._recent: list[float] = []
        self.quarrel = False
        """Two clocks seem to speak under this id."""

    def on_boot_ms(self, boot_ms: int, now: float) -> bool:
        last = self._boot_ms
        if last is None or boot_ms >= last:
            self._boot_ms, self._at = boot_ms, now
            return False
        if last - boot_ms <= JITTER_MS:
            return False
        self._boot_ms, self._at = boot_ms, now
        if last > WRAP_MS - WRAP_MARGIN_MS and boot_ms < WRAP_MARGIN_MS:
            return False
        self._recent = [at for at in self._recent if now - at < QUARREL_S] + [now]
        self.quarrel = len(self._recent) >= QUARREL_COUNT
        return True

    def forget(self) -> None:
        """A boot text told of the reboot: the next time_boot_ms is a new beginning, not a second reboot."""
        self._boot_ms = None

    def uptime_s(self, now: float) -> float | None:
        return None if self._boot_ms is None else self._boot_ms / 1000 + (now - self._at)
