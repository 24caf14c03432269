"""Flows: frames of one source and message to which no rule has to be applied, so that the compiled fast path forwards
them by itself (`links/_fast_path.c`). Here they are opened, closed when a rule changes, and counted afterwards.
Beside them the observers that want to see frames of some messages and sources, such as a client that watches a message.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.routing.router import Router
from skygcs.core.routing.routing_table import RoutingVerdict
from skygcs.core.routing.source_statistics import SourceStats
from skygcs.links.base import Channel, ForwardingPath, StateUpdate
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.recorder import Recorder

if TYPE_CHECKING:
    from skygcs.links._fast_path import Table


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


MAX_NEGATIVE_CACHE = 16384
"""Size of the negative cache: sources and messages without a flow. What a full cache does not take is looked
at each time."""


class Flows:
    """The flows of all channels.

    ``table``: None if there is no compiled fast path; then there are none. ``each_frame(channel_id)``: True if each
    frame that goes to this channel has to be handled. ``on_fault``: gets an exception of a vehicle's state. Whoever
    changes a route, an observer or such a rule calls `forget`.
    """

    def __init__(
        self,
        table: Table | None,
        router: Router,
        channels: Mapping[int, Channel],
        observers: FrameObservers,
        recorder: Recorder | None,
        *,
        each_frame: Callable[[int], bool],
        on_fault: Callable[[Exception], None],
    ) -> None:
        self.fleet: Fleet | None = None
        """Whose vehicles' states the fast path updates; None: no state is kept."""
        self._table = table
        self._router = router
        self._channels = channels
        self._observers = observers
        self._recorder = recorder
        self._each_frame = each_frame
        self._on_fault = on_fault
        self._negative_cache: set[int] = set()

    def take(self) -> None:
        """Count and record the fast path's frames since the last call. Call it before reading channels or sources."""
        if self._table is None:
            return
        forwarded, local, records, count = self._table.take()
        if forwarded:
            self._router.counters[RoutingVerdict.FORWARDED] += forwarded
        if local:
            self._router.counters[RoutingVerdict.LOCAL] += local
        if count and self._recorder is not None:
            self._recorder.offer_many(records, count)

    def forget(self) -> None:
        """Close all flows and clear the negative cache: a route or an observer changed."""
        if self._table is not None:
            self._table.invalidate()
            self._negative_cache.clear()

    def open(self, channel: Channel, frame: Frame, key: int, stats: SourceStats) -> None:
        """Open a flow for further frames like this one, if no rule has to be applied to them."""
        mark = channel.id << 40 | key << 24 | frame.msgid
        if mark in self._negative_cache or frame.target()[0] or channel.signing is not None:
            return  # with a signing key each frame's stamp has to be checked
        path = self._path_of(channel, frame, key, stats)
        if path is not None:
            channel.add_flow(frame, path)
        elif len(self._negative_cache) < MAX_NEGATIVE_CACHE:
            self._negative_cache.add(mark)

    def _path_of(self, channel: Channel, frame: Frame, key: int, stats: SourceStats) -> ForwardingPath | None:
        entry = self._router.forwarding_entry(channel.id, frame)
        if entry is None or channel.sources.get(key) is not stats:
            return None
        if self._observers.watch(frame.msgid, key):
            return None
        if any(map(self._each_frame, entry.destinations)):
            return None
        outs = tuple(out for d in entry.destinations if (out := self._channels[d].out) is not None)
        if len(outs) != len(entry.destinations):
            return None
        update: StateUpdate | None = StateUpdate()
        if self.fleet is not None:
            update = self.fleet.state_update_only(key, frame, channel.link.name)
        if update is None:
            return None
        if frame.msgid != HEARTBEAT:
            return ForwardingPath(outs, stats, entry.heard, update)
        if update.again is not None:
            update = update._replace(again=partial(self._on_heartbeats, update.again))
        return ForwardingPath(outs, stats, entry.heard, update, steady=frame.payload)

    def _on_heartbeats(self, again: Callable[[float], None], now: float) -> None:
        """Heartbeats equal to the last one came on the fast path."""
        try:
            again(now)
        except Exception as error:
            self._on_fault(error)
