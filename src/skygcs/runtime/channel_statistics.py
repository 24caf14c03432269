"""Frames that pass the hub: who observes them, which of them the compiled fast path forwards, and how many there are.

*Flows* are frames of one source and message to which no rule has to be applied, so that the fast path forwards them by
itself (`links/_fast_path.c`). Here they are opened, closed when a rule changes, and counted afterwards. *Observers*
want to see frames of some messages and sources, such as a client that watches a message. *Statistics* are counters of
each channel and each source on it: kept while a channel is closed, bounded, and shown. The counters are the channel's
own (`Channel.totals`, `SourceStats`), because every frame increases them.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Mapping, Set
from functools import partial
from typing import TYPE_CHECKING, Any

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.routing.router import Router
from skygcs.core.routing.routing_table import RoutingVerdict
from skygcs.core.routing.source_statistics import SourceStats
from skygcs.links.base import MAX_SOURCES_PER_CHANNEL, Channel, ForwardingPath, StateUpdate
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.recorder import Recorder

if TYPE_CHECKING:
    from skygcs.links._fast_path import Table


FrameObserver = Callable[[Frame, Channel, float], None]

_Entry = tuple[Set[int] | None, Set[int] | None, FrameObserver]


class FrameObservers:
    """Observers of frames. ``on_change()``, if it is set, is called whenever the set of observed messages changes."""

    def __init__(self) -> None:
        self.on_change: Callable[[], None] = lambda: None
        self.msgids: frozenset[int] | None = frozenset()
        """Messages that some observer wants; None: all. Checked before `show`, because most frames are not observed."""
        self._entries: list[_Entry] = []

    def add(self, msgids: Set[int] | None, keys: Set[int] | None, observer: FrameObserver) -> Callable[[], None]:
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


def _has(keys: Set[int], key: int) -> bool:
    return key in keys or key & ~0xFF in keys


MAX_NEGATIVE_CACHE = 16384
"""Size of the negative cache: sources and messages without a flow. What a full cache does not take is looked
at each time."""


class Flows:
    """The flows of all channels.

    ``table``: None without the compiled fast path; there are no flows then. ``each_frame(channel_id)``: True if each
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


OTHER_SOURCES = -1
"""Key under which a channel's further sources are counted together once its table is full."""

MAX_CLOSED_CHANNELS = 256
"""Closed channels whose counters per source are kept, in case the radio is plugged in again or the peer comes back."""

MAX_CLOSED_SOURCES = 2048
"""Sources of all closed channels together, 300 bytes each: programs that come and go must not accumulate."""


class ChannelStatistics:
    """Statistics of the open ``channels`` and of those that have closed."""

    def __init__(
        self, channels: Mapping[int, Channel], router: Router, flows: Flows, loop: asyncio.AbstractEventLoop
    ) -> None:
        self._channels = channels
        self._router = router
        self._flows = flows
        self._loop = loop
        self._closed_channels: dict[tuple[str, str], dict[int, SourceStats]] = {}
        """By link and peer, the sources of channels that have closed."""
        self._closed_totals: dict[str, Counter[str]] = {}
        """By link, the counters of its channels that have closed."""

    # -- channels and sources that come and go

    def on_attached(self, channel: Channel) -> None:
        """A channel is open: its sources continue where they were when it closed."""
        closed = self._closed_channels.pop((channel.link.name, channel.peer), None)
        if closed is not None:
            for stats in closed.values():
                stats.resume()  # frames sent while the channel was closed are not losses of the link
            channel.sources = closed

    def on_detached(self, channel: Channel) -> None:
        """A channel has closed: keep what it counted, as long as there is room."""
        self._add_to_totals(channel)
        closed = self._closed_channels
        closed[channel.link.name, channel.peer] = channel.sources
        kept = sum(map(len, closed.values()))
        while len(closed) > MAX_CLOSED_CHANNELS or (kept > MAX_CLOSED_SOURCES and len(closed) > 1):
            kept -= len(closed.pop(next(iter(closed))))

    def _add_to_totals(self, channel: Channel) -> None:
        """Keep the counters of a channel that closes: those of its link must not decrease."""
        totals = self._closed_totals.pop(channel.link.name, Counter())
        totals.update(channel.totals())
        self._closed_totals[channel.link.name] = totals
        while len(self._closed_totals) > MAX_CLOSED_CHANNELS:
            del self._closed_totals[next(iter(self._closed_totals))]

    def new_source(self, channel: Channel, key: int, frame: Frame) -> SourceStats:
        """Counters of a source that is new on a channel, for the channel's table: its own, or those of all further
        sources once the table is full."""
        if len(channel.sources) >= MAX_SOURCES_PER_CHANNEL and not self._drop_source(channel, frame):
            key = OTHER_SOURCES
            known = channel.sources.get(key)
            if known is not None:
                return known
        stats = channel.sources[key] = SourceStats(frame.sysid, frame.compid)
        if key == OTHER_SOURCES:
            stats.counts_loss = False
        return stats

    def _drop_source(self, channel: Channel, frame: Frame) -> bool:
        """Make room for an autopilot in a full table: replace the other source that was silent for longest. True if
        done."""
        if frame.msgid != HEARTBEAT or not discovers(frame):
            return False
        autopilots = self._router.table.autopilots_on(channel.id)
        others = [key for key in channel.sources if key not in autopilots and key != OTHER_SOURCES]
        if not others:
            return False
        del channel.sources[min(others, key=lambda key: channel.sources[key].last_at)]
        self._flows.forget()  # a flow may count for it
        return True

    def restart_source(self, key: int) -> None:
        """A system rebooted: its sequence numbers restart on every channel."""
        self._flows.take()  # it would overwrite them with its own counters
        for channel in self._channels.values():
            stats = channel.sources.get(key)
            if stats is not None:
                stats.restart()

    def sample(self, now: float) -> None:
        """Sample the rates of all sources; to be called once a second."""
        for channel in self._channels.values():
            for stats in channel.sources.values():
                stats.sample(now)

    # -- what is read

    def received(self, channel_id: int, key: int) -> tuple[int, int] | None:
        """Frames of a source on a channel and how many were lost; None if it is not heard there."""
        channel = self._channels.get(channel_id)
        stats = None if channel is None else channel.sources.get(key)
        return None if stats is None else (stats.frames, stats.lost)

    def link_totals(self, link: str) -> Counter[str]:
        """Counters of a link (`CHANNEL_TOTALS`) since the daemon's start: its open channels and those that closed."""
        totals = Counter(self._closed_totals.get(link, {}))
        for channel in self._channels.values():
            if channel.link.name == link:
                totals.update(channel.totals())
        return totals

    def link_quality(self, key: int) -> dict[str, Any]:
        """Loss and rate of a source (sysid << 8 | compid), by link; on a link with several peers of the peer that
        supplies its state. Of a vehicle that is heard on several links also which is chosen, and the health of each."""
        found = {}
        state = self._router.state_sources.get(key)
        for channel_id in self._router.channels_of(key):
            channel = self._channels[channel_id]
            stats = channel.sources.get(key)
            if stats is not None and channel.link.name not in found:
                found[channel.link.name] = stats.as_dict(self._loop.time())
                if state is not None:
                    found[channel.link.name] |= state.link_status(channel_id, self._loop.time())
                if channel.config.type == "replay":
                    found[channel.link.name]["replayed"] = True
        return found

    def router_stats(self) -> dict[str, Any]:
        """Counters of decisions and the route table."""
        self._flows.take()
        router, now = self._router, self._loop.time()
        return {
            "counters": {verdict.value: count for verdict, count in router.counters.items()},
            "refused_routes": router.table.room.refused,
            "evicted_routes": router.table.room.evicted,
            "unreported_routes": router.table.unreported_routes,
            "routes": [
                {
                    "sysid": sysid,
                    "compid": compid,
                    "link": self._channels[cid].link.name,
                    "peer": self._channels[cid].peer,
                    "age_s": round(now - at, 2),
                }
                for sysid, compid, cid, at in router.table.routes()
                if cid in self._channels
            ],
        }

    def channel_status(self, channel: Channel) -> dict[str, Any]:
        """Counters of a channel and of each source on it."""
        now = self._loop.time()
        return {
            "id": channel.id,
            "peer": channel.peer,
            "last_rx_age_s": round(now - channel.last_rx_at, 2),
            **channel.counters(),
            **self._router.port_counters(channel.id),
            "sources": {
                f"{key >> 8}/{key & 0xFF}" if key >= 0 else "others": stats.as_dict(now)
                for key, stats in channel.sources.items()
            },
        }
