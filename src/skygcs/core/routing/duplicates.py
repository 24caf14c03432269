"""Copies of frames: the same (sysid, compid, seq, CRC) heard on another channel a moment ago.

Copies on the *same* channel pass: some senders never count their seq up, and their repeated commands are meant.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Protocol

WINDOW_S = 1.0
"""How long a frame is remembered, at least (at most twice that). Two radios on one antenna mast differ by one TDM round
at most (some 0.4 s with five nodes at 64 kbps, 0.8 s with ten); a source would need 256 frames/s to reuse a seq within
it, and equal CRCs on top."""

MAX_REMEMBERED = 65536
"""Bound of one generation: 65,000 frames within a second are more than the process can route."""

SCORE_FRAMES = 64
"""Distinct frames by which parallel channels are compared: a third of a second of telemetry at full rate, half a minute
at 2 Hz."""

COPIES_SHARE = 0.3
"""Least share of copies among a system's frames for its channels to count as parallel: of two radios on one mast the
worse one still hears this much, or it is no use."""

BETTER_BY = 0.1
"""A channel is preferred only if it hears this share more of the frames, so that equal ones do not alternate."""

CHANNEL_SILENT_S = 2.0
"""A channel that has heard nothing of the system for this time, while another has, is not preferred."""


class FirstHeard(Protocol):
    """A memory of frames as `DuplicateFilter`; keys are sysid, compid, seq and CRC in one number."""

    def first_heard_on(self, key: int, channel_id: int, now: float, /) -> int: ...


class DuplicateFilter:
    """Remembers frames for a short window, in two generations, so that forgetting costs nothing per frame."""

    __slots__ = ("_new", "_old", "_turn_at")

    def __init__(self) -> None:
        self._new: dict[Hashable, int] = {}
        self._old: dict[Hashable, int] = {}
        self._turn_at = 0.0

    def first_heard_on(self, key: Hashable, channel_id: int, now: float) -> int:
        """The channel on which this frame was heard first; ``channel_id`` itself if it is new (then remembered)."""
        if now >= self._turn_at or len(self._new) >= MAX_REMEMBERED:
            self._old = self._new if now < self._turn_at + WINDOW_S else {}
            self._new = {}
            self._turn_at = now + WINDOW_S
        first = self._new.get(key)
        if first is None:
            first = self._old.get(key)
        if first is None:
            self._new[key] = channel_id
            return channel_id
        return first


class ParallelChannels:
    """The channels over which one system is heard twice, and the one that hears it best.

    ``active`` once copies were COPIES_SHARE of the last SCORE_FRAMES frames: two ground stations of one id now and then
    send equal heartbeats, and are no parallel channels. ``over`` when a whole count went by without enough copies.
    """

    __slots__ = ("_copies", "_distinct", "_heard", "_share", "active", "best", "over")

    def __init__(self, best: int) -> None:
        self.best = best
        self.active = False
        self.over = False
        self._copies = 0
        self._distinct = 0
        self._heard: dict[int, int] = {}
        self._share: dict[int, float] = {}

    @property
    def channel_ids(self) -> set[int]:
        """Channels known to carry copies."""
        return set(self._share) | set(self._heard)

    def on_frame(self, channel_id: int, copy: bool) -> None:
        """Count one frame of the system, a first or a copy, and every SCORE_FRAMES distinct ones judge again."""
        self._heard[channel_id] = self._heard.get(channel_id, 0) + 1
        if copy:
            self._copies += 1
            return
        self._distinct += 1
        if self._distinct < SCORE_FRAMES:
            return
        self.active = self._copies >= COPIES_SHARE * self._distinct
        self.over = not self.active
        self._share = {c: self._heard.get(c, 0) / self._distinct for c in self.channel_ids}
        champion = max(self._share, key=lambda c: self._share[c])
        if self._share[champion] > self._share.get(self.best, 0.0) + BETTER_BY:
            self.best = champion
        self._copies = self._distinct = 0
        self._heard = {}

    def forget(self, channel_id: int) -> None:
        """The channel is gone."""
        self._heard.pop(channel_id, None)
        self._share.pop(channel_id, None)
        if self.best == channel_id:
            left = self.channel_ids
            self.best = max(left, key=lambda c: self._share.get(c, 0.0)) if left else 0

    def choose(self, candidates: dict[int, float], now: float) -> int | None:
        """The one of ``candidates`` (channel id -> last heard at) to send on; None if they are not parallel."""
        known = [c for c in candidates if c in self._share or c in self._heard]
        if not self.active or len(known) < 2:
            return None
        fresh = [c for c in known if now - candidates[c] <= CHANNEL_SILENT_S]
        if self.best in fresh or not fresh:
            return self.best if self.best in known else known[0]
        return max(fresh, key=lambda c: candidates[c])
