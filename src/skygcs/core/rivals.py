"""Two vehicles with one system id, found by their heartbeats.

One vehicle may well be heard on two channels: it has two radios, or two receivers hear it. It is two vehicles if both
channels belong to one link (two UDP peers on one port), or if they show two different modes or arming states at once,
for longer than news of one vehicle takes over its slower link.
"""

from __future__ import annotations

from typing import Literal

BEAT_FRESH_S = 2.5
"""Two lost heartbeats: a channel on which the last one is older does not hear the vehicle now."""

RIVALS_AFTER_S = 4.0
"""A mode change shows on a slow link within one or two heartbeats, and a vehicle that moved is silent on its old
channel; what lasts longer is two vehicles."""

MAX_WATCHED = 1024
"""Autopilots watched; four times as many as there can be vehicles."""

Change = Literal["duplicate", "duplicate_over"]


class RivalWatch:
    """Feed it every heartbeat of an autopilot; ``duplicates`` holds the sysid<<8|compid claimed by two vehicles."""

    __slots__ = ("_beats", "_since", "duplicates")

    def __init__(self) -> None:
        self.duplicates: set[int] = set()
        self._beats: dict[int, dict[int, tuple[float, str, bytes]]] = {}
        self._since: dict[int, float] = {}

    def on_beat(
        self, source: int, channel_id: int, link: str, shown: bytes, *, copies: bool, now: float
    ) -> Change | None:
        """``shown``: the heartbeat's mode and arming bytes. ``copies``: these channels carry the same frames twice."""
        beats = self._beats.get(source)
        if beats is None:
            if len(self._beats) >= MAX_WATCHED:
                return None
            beats = self._beats[source] = {}
        beats[channel_id] = (now, link, shown)
        if len(beats) == 1:
            return None
        for other in [c for c, (at, _, _) in beats.items() if now - at > BEAT_FRESH_S]:
            del beats[other]
        rivals = [(where, what) for c, (_, where, what) in beats.items() if c != channel_id]
        if not copies and any(where == link or what != shown for where, what in rivals):
            since = self._since.setdefault(source, now)
            if now - since >= RIVALS_AFTER_S and source not in self.duplicates:
                self.duplicates.add(source)
                return "duplicate"
            return None
        self._since.pop(source, None)
        if source in self.duplicates and not rivals:
            self.duplicates.discard(source)
            return "duplicate_over"
        return None

    def forget(self, channel_id: int) -> None:
        """The channel is gone."""
        for beats in self._beats.values():
            beats.pop(channel_id, None)
