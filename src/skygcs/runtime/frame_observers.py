"""Who watches frames that pass the hub: some messages of some sources, or all."""

from __future__ import annotations

from collections.abc import Callable

from skygcs.core.mavlink.frame import Frame
from skygcs.links.base import Channel

FrameObserver = Callable[[Frame, Channel, float], None]

_Entry = tuple[set[int] | None, set[int] | None, FrameObserver]


class FrameObservers:
    """``on_change()`` is called whenever what is watched changes."""

    def __init__(self, on_change: Callable[[], None]) -> None:
        self.msgids: frozenset[int] | None = frozenset()
        """Messages that some observer wants; None: all. To be checked before `show`: most frames are not observed."""
        self._entries: list[_Entry] = []
        self._on_change = on_change

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
        """Give it to each observer that wants it."""
        for msgids, keys, observer in tuple(self._entries):
            if (msgids is None or frame.msgid in msgids) and (keys is None or _has(keys, key)):
                observer(frame, channel, now)

    def _changed(self) -> None:
        wanted: set[int] | None = set()
        for msgids, _, _ in self._entries:
            wanted = None if wanted is None or msgids is None else wanted | msgids
        self.msgids = None if wanted is None else frozenset(wanted)
        self._on_change()


def _has(keys: set[int], key: int) -> bool:
    return key in keys or key & ~0xFF in keys
