"""Observers that want to see frames of some messages and sources, such as a client that watches a message."""

from __future__ import annotations

from collections.abc import Callable

from skygcs.core.mavlink.frame import Frame
from skygcs.links.base import Channel

FrameObserver = Callable[[Frame, Channel, float], None]

_Entry = tuple[set[int] | None, set[int] | None, FrameObserver]


class FrameObservers:
    """Observers of frames. ``on_change()``, if it is set, is called whenever the set of observed messages changes."""

    def __init__(self) -> None:
        self.on_change: Callable[[], None] = lambda: None
        self.msgids: frozenset[int] | None = frozenset()
        """Messages that some observer wants; None: all. Checked before `show`, because most frames are not observed."""
        self._entries: list[_Entry] = []

    def add(self, msgids: set[int] | None, keys: set[int] | None, observer: FrameObserver) -> Callable[[], None]:
        """Hand frames of these ids and sources (sysid<<8|compid, component 0: the whole system; None: all) to
        ``observer``; returns how to stop it."""
        entry = (msgids, keys, observer)
        self._entries.append(entry)
        self._changed()

        def remove() -> None:
            if entry in self._entries:
                self._entries.remove(entry)
                self._changed()

        return remove

    def watch(self, msgid: int, key: int) -> bool:
        """True if an observer wants frames of this message and source."""
        return any((m is None or msgid in m) and (k is None or _has(k, key)) for m, k, _ in self._entries)

    def show(self, frame: Frame, channel: Channel, key: int, now: float) -> None:
        """Pass a frame to each observer that wants it."""
        for msgids, keys, observer in tuple(self._entries):
            if (msgids is None or frame.msgid in msgids) and (keys is None or _has(keys, key)):
                observer(frame, channel, now)

    def _changed(self) -> None:
        wanted: set[int] | None = set()
        for msgids, _, _ in self._entries:
            wanted = None if wanted is None or msgids is None else wanted | msgids
        self.msgids = None if wanted is None else frozenset(wanted)
        self.on_change()


def _has(keys: set[int], key: int) -> bool:
    return key in keys or key & ~0xFF in keys
