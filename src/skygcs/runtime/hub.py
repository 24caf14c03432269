"""Passes every frame from its link to the router, then to links, recorder and vehicles: synchronous, without a queue.

The hub is the links' host. It owns the table of open channels and our own outgoing messages. `core.routing` decides
where a frame goes, the fleet updates the state of its vehicle.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from skygcs.config.channel_policy import channel_policy
from skygcs.config.models import DaemonConfig, FleetConfig, LinkConfig
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame, check
from skygcs.core.mavlink.msgids import SETUP_SIGNING
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.transmit_queue import Outgoing, OwnMessage, Priority
from skygcs.core.routing.router import Router
from skygcs.core.routing.routing_table import RoutingVerdict
from skygcs.core.routing.send_gates import NO_TARGET, SendGates, target_of
from skygcs.core.routing.sysid_translation import SysidTranslator
from skygcs.core.vehicle.gate import Clearance, OutgoingGate, is_exempt, standing
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.links.base import Channel
from skygcs.links.fast_path import new_table
from skygcs.links.reading import ReadingTurns
from skygcs.runtime.channel_statistics import ChannelStatistics, Flows, FrameObservers
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.loop_clock import boot_clock
from skygcs.runtime.recorder import Recorder
from skygcs.runtime.route_reports import RouteReports
from skygcs.runtime.signing_keys import Signing

if TYPE_CHECKING:
    from skygcs.links._fast_path import Table


LINK_PROBE = 0x6C69_6E6B << 16
"""TIMESYNC.ts1 of a question over a deaf link: no clock, and of no other probe of ours."""

MAX_REPLAYED = 4096
"""Sources of recordings, kept apart from live ones; as many as there may be routes."""

MAX_CHANNEL_ID = (1 << 24) - 1
"""Largest channel id in the fast path's table of duplicates; after it, ids of closed channels are reused. A peer that
keeps changing its address reaches it in hours."""

WHOLE_DATAGRAM_BYTES = 1472
"""Frames of one datagram are forwarded in one up to this size, the payload of an Ethernet packet."""

_DROPPED = (RoutingVerdict.DUPLICATE, RoutingVerdict.CONFLICT, RoutingVerdict.FILTERED_IN, RoutingVerdict.OUT_OF_BOUNDS)


class Hub:
    """The links' host: routes every frame, records it, and passes it to the fleet.

    Without `connect` it only routes.
    """

    def __init__(
        self,
        config: FleetConfig,
        dialect: Dialect,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        *,
        recorder: Recorder | None = None,
        signing: Signing | None = None,
    ) -> None:
        """``recorder`` gets every accepted frame and every message of ours."""
        own = config.daemon
        self.reading = ReadingTurns()
        self.fast_path: Table | None = new_table(dialect, recording=recorder is not None)
        self.router = _router_of(own, self.fast_path)
        self._renumbering: dict[int, SysidTranslator] = {}
        """By channel id: translators of the frames sent there."""
        # channels, and what is made of their frames
        self.channels: dict[int, Channel] = {}
        self.observers = FrameObservers()
        self.flows = Flows(
            self.fast_path,
            self.router,
            self.channels,
            self.observers,
            recorder,
            each_frame=self._needs_each_frame,
            on_fault=self.fault,
        )
        self.router.table.on_change = self.observers.on_change = self.flows.forget
        self.statistics = ChannelStatistics(self.channels, self.router, self.flows, loop)
        self.router.selection.received = self.statistics.received
        self.faults = 0
        self.replayed: set[int] = set()
        """Sources (sysid<<8|compid) that exist only in a recording: they take no orders."""
        # ids, fleet and recorder
        self._config = config
        self.dialect = dialect
        self._loop = loop
        self._own = (own.sysid, own.compid)
        self._fleet: Fleet | None = None
        self._reports: RouteReports | None = None
        self._record = None if recorder is None else recorder.offer
        self._signing = signing
        # gates of our own messages
        self.gate = OutgoingGate(loop.time, on_event)
        self.send_gates: SendGates | None = None
        """The gates of vehicles that an extension closes; None: there are none. See `gate_sending`."""
        self.boot_clock = boot_clock(loop)
        """The clock of gates. uvloop reads the loop's own once a turn: too old in a process that was stopped."""
        self._on_event = on_event
        self.asleep: Callable[[], bool] = lambda: False
        """Asked before a message of ours is made: `SleepWatch.check`."""
        self.stale_frames = self._stale_reported = 0  # those that waited during a standstill: only recorded
        self._heartbeat: OwnMessage | None = None
        self._fault_kinds: set[str] = set()
        self._next_id = 1

    def connect(self, fleet: Fleet | None, reports: RouteReports) -> None:
        """Connect the fleet, which gets the vehicles' frames (None: no fleet), and ``reports``, which gets the
        router's notes. Call it once, before links open."""
        self._reports = reports
        self._fleet = self.flows.fleet = fleet
        if fleet is not None:
            self.router.selection.known = fleet.known
            self.router.table.may_fly = fleet.may_fly
            self.router.selection.on_replaced = fleet.replaced
            self.router.selection.on_switched = self._on_switched

    def gate_sending(self, gates: SendGates) -> None:
        """Ask these gates before bytes are sent. Call it once, before links open: raises RuntimeError afterwards, when
        frames could have left without a question."""
        if self.channels or self.send_gates is not None:
            raise RuntimeError("gates come before channels, and once")
        self.send_gates = gates if gates else None

    # -- what links call

    def new_parser(self, config: LinkConfig) -> FrameParser:
        """A parser for one channel."""
        return FrameParser(self.dialect, pass_bad_crc=self._config.daemon.bad_crc == "pass")

    def attach(self, channel: Channel) -> None:
        """Add an open channel to the routes and set its id."""
        channel.id = self._free_id()
        self.channels[channel.id] = channel
        self.statistics.on_attached(channel)
        sysids = frozenset(s for s in self._config.bound_sysids(channel.config).values() if s is not None)
        if channel.config.vehicles:  # the fleet file's checks have found them: an endpoint without any raises
            channel.translator = SysidTranslator(sysids, channel.config.translated_sysid)
            if channel.translator.renumbers:
                self._renumbering[channel.id] = channel.translator
        self.router.open(channel.id, channel_policy(channel.config, self.dialect, sysids))
        if self.send_gates is not None and channel.translator is None:  # behind a bound channel there is a program
            channel.gate = self.may_leave
        if self._signing is not None:
            self._signing.attach(channel)
        if self._heartbeat is not None:
            # not from within the link's own opening: it may not be ready to send yet
            self._loop.call_soon(self._greet, channel, self._heartbeat)

    def _free_id(self) -> int:
        """The next id that no open channel has."""
        while True:
            found, self._next_id = self._next_id, self._next_id % MAX_CHANNEL_ID + 1
            if found not in self.channels:
                return found

    def _greet(self, channel: Channel, heartbeat: OwnMessage) -> None:
        if self.channels.get(channel.id) is channel:
            self._send_on((channel.id,), heartbeat, Priority.HEARTBEAT, "heartbeat")

    def detach(self, channel: Channel, reason: str) -> None:
        """Remove a closed channel and its routes. Idempotent."""
        if self.channels.pop(channel.id, None) is not None:
            self.flows.take()
            self.statistics.on_detached(channel)
            self.router.close(channel.id)
            self._renumbering.pop(channel.id, None)
            if self.send_gates is not None:
                self.send_gates.forget_channel(channel.id)

    def on_frames(self, channel: Channel, frames: list[Frame], now: float) -> None:
        """Handle the frames of one read. Hot: no decoding, no await, no log; a fault is contained in its frame."""
        frames = self._accepted(channel, frames, now)
        if not frames:
            return
        # values that are the same for all frames
        decide, state_sources, flows = self.router.decide, self.router.state_sources, self.flows
        channels, channel_id, sources, label = self.channels, channel.id, channel.sources, channel.link.name
        on_vehicle_frame = None if self._fleet is None else self._fleet.on_frame
        shown = self._shown_of(channel)
        unix_us = time.time_ns() // 1000
        renumbering, observers, record, gates = self._renumbering, self.observers, self._record, self.send_gates
        split = gates is not None or not channel.in_datagrams or len(frames) < 2  # gates check each frame
        together: list[tuple[Frame, tuple[int, ...]]] | None = None if split else []
        for frame in frames:
            raw, key = frame.raw, frame.sysid << 8 | frame.compid
            size = len(raw)
            channel.rx_frames += 1
            channel.rx_bytes += size
            stats = sources.get(key)
            if stats is None:
                stats = self.statistics.new_source(channel, key, frame)
            stats.on_frame(frame.seq, size, now)
            if frame.msgid == SETUP_SIGNING:
                self._on_key(frame.sysid, channel)  # keys are not forwarded, recorded or shown (signing guide)
                continue
            try:
                # route and forward
                decision = decide(channel_id, frame, now)
                counts = True
                if state_sources and key in state_sources:
                    counts = self._counts(channel, frame, decision.verdict, now)
                if gates is not None:
                    self._send_gated(gates, channel_id, frame, decision.destinations)
                elif together is None:
                    for destination in decision.destinations:
                        if destination in renumbering:
                            self._send_as_shown(destination, [frame])
                        else:
                            target = channels[destination]
                            target.send(raw if target.air is None else frame)
                else:
                    together.append((frame, decision.destinations))
                if decision.verdict in _DROPPED:
                    continue
                # record, pass to the fleet and to observers, and open a flow for the next frames
                if record is not None:
                    record(raw, unix_us)
                if counts and frame.info is not None and on_vehicle_frame is not None and (shown is None or shown(key)):
                    on_vehicle_frame(key, frame, label, now)
                if observers.msgids is None or frame.msgid in observers.msgids:
                    observers.show(frame, channel, key, now)
                if shown is None and channel.fast_path is not None:
                    flows.open(channel, frame, key, stats)
            except Exception as error:
                self.fault(error)
        if together:
            self._send_together(together)
        if self.router.table.notes:
            self._drain_notes()

    def _accepted(self, channel: Channel, frames: list[Frame], now: float) -> list[Frame]:
        """The frames that an open channel's signing rule admits, with system ids translated to ours."""
        if channel.id not in self.channels:
            return []  # a callback that was pending when the channel closed
        if channel.signing is not None:
            frames = channel.signing.admit(channel, frames)
            if not frames:
                return []  # it counts as silence
        if channel.translator is not None:
            frames = channel.translator.inward(frames)
        stale = self.reading.stale
        if stale and (channel in stale or channel.link in stale):
            self._only_record(frames)
            return []
        channel.last_rx_at = now
        if self.fast_path is not None and self.fast_path.records_waiting:
            self.flows.take()  # earlier frames are recorded first
        return frames

    def _only_record(self, frames: list[Frame]) -> None:
        """They waited while this process did not run, and are as old as that."""
        self.stale_frames += len(frames)
        if self._record is None:
            return
        self.flows.take()  # earlier frames are recorded first
        unix_us = time.time_ns() // 1000
        for frame in frames:
            if frame.msgid != SETUP_SIGNING:
                self._record(frame.raw, unix_us)

    def _counts(self, channel: Channel, frame: Frame, verdict: RoutingVerdict, now: float) -> bool:
        """True if a frame of a vehicle that is heard on several channels counts for its state. A duplicate that counts
        is shown here, because the frame that came first did not count."""
        copy = verdict is RoutingVerdict.DUPLICATE
        if verdict in _DROPPED and not copy:
            return False
        copy_of = self.router.first_channel_id if copy else None
        counts = self.router.selection.supplies(channel.id, frame, now, copy_of=copy_of)
        if counts and copy and self._fleet is not None:
            self._fleet.on_frame(frame.sysid << 8 | frame.compid, frame, channel.link.name, now)
        return counts

    def _send_together(self, frames: list[tuple[Frame, tuple[int, ...]]]) -> None:
        """Forward the frames of one datagram; a fault ends with them."""
        try:
            self._send_datagram(frames)
        except Exception as error:
            self.fault(error)

    def _send_datagram(self, frames: list[tuple[Frame, tuple[int, ...]]]) -> None:
        """Forward them in one datagram, if all of them go to the same channels."""
        channels = self.channels
        destinations = frames[0][1]
        data = b"".join([frame.raw for frame, _ in frames])
        whole = len(data) <= WHOLE_DATAGRAM_BYTES and all(to == destinations for _, to in frames)
        if whole and all(channels[d].whole_datagrams for d in destinations):
            for destination in destinations:
                if destination in self._renumbering:
                    self._send_as_shown(destination, [frame for frame, _ in frames])
                else:
                    channels[destination].send_whole(data, len(frames))
            return
        for frame, to in frames:
            for destination in to:
                if destination in self._renumbering:
                    self._send_as_shown(destination, [frame])
                else:
                    target = channels[destination]
                    target.send(frame.raw if target.air is None else frame)

    def _send_as_shown(self, channel_id: int, frames: list[Frame]) -> None:
        """Send to a program that knows its vehicle under another id: the frames of one datagram, or one frame."""
        channel, endpoint = self.channels[channel_id], self._renumbering[channel_id]
        shown = [raw for frame in frames if (raw := endpoint.outward(frame)) is not None]
        if len(shown) > 1:
            channel.send_whole(b"".join(shown), len(shown))
        elif shown:
            channel.send(shown[0])

    # -- vehicles that an extension gates

    def may_leave(self, channel_id: int, outgoing: Outgoing) -> bool:
        """True if this may be written to a channel now, by the clock of now: see `core.routing.send_gates`."""
        gates = self.send_gates
        if gates is None:
            return True
        if isinstance(outgoing, OwnMessage):
            if outgoing.exempt:
                return True
            target = target_of(outgoing.info, outgoing.payload)
            if outgoing.to_system and target <= 0:
                target = outgoing.to_system
        else:
            frame = outgoing if isinstance(outgoing, Frame) else check(outgoing, self.dialect.messages)[0]
            if frame is None:
                return False
            target = target_of(frame.info, frame.payload)
        others: set[int] = set()
        if target == NO_TARGET and gates.leads_to_gated(channel_id):
            others = {key >> 8 for key in self.router.table.autopilots_on(channel_id)}
        return gates.passes(channel_id, target, others, self.boot_clock())

    def _send_gated(self, gates: SendGates, source_id: int, frame: Frame, destinations: tuple[int, ...]) -> None:
        """Forward a frame as a frame, so that the channel can check it again when it is written; and note where gated
        vehicles are heard."""
        if (
            gates.gates(frame.sysid)
            and self.router.table.hears(source_id, frame.sysid)
            and gates.hear(source_id, frame.sysid)
        ):
            self.flows.forget()
        for destination in destinations:
            if destination in self._renumbering:
                self._send_as_shown(destination, [frame])
            elif self.may_leave(destination, frame):
                self.channels[destination].send(frame)

    # -- the compiled fast path

    def after_fast_path(self) -> None:
        """See `Flows.take`."""
        self.flows.take()

    def _needs_each_frame(self, channel_id: int) -> bool:
        """True if frames sent to this channel have to be translated, or checked, one by one."""
        gates = self.send_gates
        return channel_id in self._renumbering or (gates is not None and gates.leads_to_gated(channel_id))

    # -- recordings

    def _shown_of(self, channel: Channel) -> Callable[[int], bool] | None:
        """The sources of this channel that are shown to the fleet; None: all, and no recording is played."""
        if channel.config.type == "replay":
            return self._shown_replayed
        if not self.replayed:
            return None
        return self._shown_echo if channel.config.role == "gcs" else self._shown_live

    def _shown_replayed(self, key: int) -> bool:
        if key not in self.replayed and len(self.replayed) < MAX_REPLAYED:
            self.replayed.add(key)
            self.flows.forget()
            self._source_changed(key)
        return key in self.replayed

    def _shown_live(self, key: int) -> bool:
        if key in self.replayed:
            self.replayed.discard(key)
            self._source_changed(key)
        return True

    def _source_changed(self, key: int) -> None:
        if self._fleet is not None:
            self._fleet.source_changed(key)

    def _shown_echo(self, key: int) -> bool:
        """A ground station may send back frames of a recording that it was shown."""
        return key not in self.replayed

    def on_sent(self, channel: Channel, message: OwnMessage, raw: bytes) -> None:
        """Record a message of ours, once for all channels it was written to."""
        if self._record is not None and not message.recorded:
            message.recorded = True
            if self.fast_path is not None and self.fast_path.records_waiting:
                self.flows.take()
            self._record(raw, time.time_ns() // 1000)

    # -- admission of new peers

    def carries_autopilot(self, channel: Channel) -> bool:
        """True if an autopilot is heard on this channel."""
        return bool(self.router.table.autopilots_on(channel.id))

    def leads_to_flying(self, channel: Channel) -> bool:
        """True if this channel is the last way to a vehicle that may be in the air: it is not given up."""
        return self.router.table.leads_to_flying(channel.id)

    def vouches_for(self, config: LinkConfig, frames: list[Frame]) -> bool:
        """True if an unknown peer that sends these frames may be admitted; see `Signing.vouches_for`."""
        return self._signing is None or config.signing is None or self._signing.vouches_for(config.name, frames)

    def woke(self) -> None:
        """This process did not run for a while: what waits to be sent is dropped, and what waits in sockets and ports
        is not routed."""
        self.reading.woke()
        self.flows.forget()
        for channel in list(self.channels.values()):
            channel.drop_waiting()

    def on_event(self, event: Event) -> None:
        """Publish an event of a link."""
        self._on_event(event)

    # -- our own messages

    def send(
        self,
        info: MessageInfo,
        values: Mapping[str, Any],
        sysid: int,
        compid: int,
        priority: Priority,
        /,
        *,
        everywhere: bool = False,
        key: Hashable | None = None,
        clearance: Clearance | None = None,
    ) -> bool:
        """Send a message of ours to one system (or, with sysid 0, to every link that may carry vehicles).

        ``everywhere``: on every channel on which it was heard, as for emergencies. ``clearance``: of the outgoing gate
        (`OutgoingGate.passes`); that of vehicles.stop passes every gate. False if that id was not heard lately, a
        gate keeps it back, or every link refused. Raises ValueError as `pack` does.
        """
        ids = self.channels_to(
            sysid,
            compid,
            everywhere=everywhere or priority is Priority.EMERGENCY,
            setpoint=priority is Priority.SETPOINT,
        )
        message = self._own_message(info, values, sysid, ids, clearance)
        if message is None:
            return False
        return self._send_on(ids, message, priority, key)

    def _own_message(
        self,
        info: MessageInfo,
        values: Mapping[str, Any],
        sysid: int,
        ids: tuple[int, ...],
        clearance: Clearance | None,
    ) -> OwnMessage | None:
        """A message of ours to a system (0: to those on these channels); None if the outgoing gate keeps it back, or it
        was decided on before a standstill. The only place that makes one."""
        if self.asleep() or not self.gate.passes(info.name, values, clearance, lambda: self._reached(sysid, ids)):
            return None
        message = OwnMessage(info, info.pack(values), *self._own)
        message.to_system, message.exempt = sysid, is_exempt(clearance)
        return message

    def _reached(self, sysid: int, ids: tuple[int, ...]) -> list[Vehicle]:
        """The live vehicles that will accept a message to this system, or, with 0, to these channels."""
        if self._fleet is None:
            return []
        if sysid:
            return [vehicle for vehicle in self._fleet.vehicles_of(sysid) if not vehicle.replayed]
        on = set(ids)
        actors = self._fleet.vehicles.values()
        vehicles = (actor.vehicle for actor in actors if on.intersection(self.router.channels_of(actor.vehicle.key)))
        return [vehicle for vehicle in vehicles if not vehicle.replayed]

    def channels_to(
        self, sysid: int, compid: int, *, everywhere: bool = False, setpoint: bool = False
    ) -> tuple[int, ...]:
        """Ids of the channels that a message of ours to this system is sent on; sysid 0: to all vehicles."""
        ids = self.router.route_own(sysid, compid, self._loop.time(), everywhere=everywhere, setpoint=setpoint)
        if sysid == 0:
            ids = tuple(i for i in ids if self.channels[i].config.role != "gcs")
        return ids

    def send_heartbeat(self, info: MessageInfo, values: Mapping[str, Any]) -> None:
        """Send our heartbeat on every channel that is not bound to vehicles, whatever its role; a channel that opens
        later gets the newest one at once."""
        ids = tuple(self.channels)
        message = self._heartbeat = self._own_message(info, values, 0, ids, standing("heartbeat"))
        if message is not None:
            self._send_on(ids, message, Priority.HEARTBEAT, "heartbeat")

    def send_on(
        self,
        ids: Iterable[int],
        info: MessageInfo,
        values: Mapping[str, Any],
        priority: Priority,
        key: Hashable | None = None,
        *,
        clearance: Clearance | None = None,
    ) -> bool:
        """Send a message of ours to exactly these channels, except bound ones; False if none took it. ``clearance``
        as for `send`."""
        channels = tuple(ids)
        message = self._own_message(info, values, _target_in(info, values), channels, clearance)
        return message is not None and self._send_on(channels, message, priority, key)

    def channels_of_link(self, link: str) -> tuple[int, ...]:
        """Ids of a link's open channels."""
        return tuple(c.id for c in self.channels.values() if c.link.name == link)

    def _send_on(self, ids: Iterable[int], message: OwnMessage, priority: Priority, key: Hashable | None) -> bool:
        sent = False
        for channel_id in ids:
            channel = self.channels.get(channel_id)
            # a program bound to vehicles gets no messages of ours
            if channel is not None and channel.translator is None:
                if self.send_gates is not None and not self.may_leave(channel_id, message):
                    continue
                sent |= channel.send(message, priority, key)
        return sent

    # -- a few times a second

    def choose_links(self, now: float) -> None:
        """Change over to the better link of each vehicle that is heard on several."""
        self.router.selection.choose_links(now)
        for key, channel_id in self.router.selection.links_to_probe(now):
            self._probe_link(key, channel_id)
        if self.router.table.notes:
            self._drain_notes()

    def _probe_link(self, key: int, channel_id: int) -> None:
        """Ask this vehicle over a link over which it did not hear us: its answer comes over the same link."""
        if self._fleet is not None and key not in self._fleet.vehicles:
            return  # after a standstill it has to be heard first
        info = self.dialect.by_name["TIMESYNC"]
        address = {"target_system": key >> 8, "target_component": key & 0xFF}
        named = {f.name for f in info.fields}
        values = {"ts1": LINK_PROBE} | {name: value for name, value in address.items() if name in named}
        message = self._own_message(info, values, key >> 8, (channel_id,), None)
        if message is not None:
            self._send_on((channel_id,), message, Priority.COMMAND, None)

    def _on_switched(self, key: int, channel_id: int) -> None:
        """Another channel leads to this vehicle: what waits on the others must not come after what is sent there."""
        for other in self.router.channels_of(key):
            if other != channel_id and other in self.channels:
                self.channels[other].drop_setpoints(key >> 8)
        if self._fleet is not None:
            self._fleet.link_changed(key, channel_id)

    # -- once a second

    def tick(self, now: float) -> None:
        """Expire routes and sample rates."""
        self.flows.take()
        self.router.expire(now)
        if self.router.table.notes:
            self._drain_notes()
        self.statistics.sample(now)
        if self.stale_frames != self._stale_reported and not self.reading.stale:
            self._report_stale()

    def _report_stale(self) -> None:
        number, self._stale_reported = self.stale_frames - self._stale_reported, self.stale_frames
        text = f"{number} frames had waited while skygcs stood still: they are recorded, and were not used"
        self._on_event(Event("warning", None, None, text, {"stale_frames": number}))

    def on_reboot(self, event: Event) -> None:
        """A vehicle has restarted."""
        if self._fleet is not None and event.sysid is not None:
            for vehicle in self._fleet.vehicles_of(event.sysid):
                self.statistics.restart_source(vehicle.key)

    def _on_key(self, sysid: int, channel: Channel) -> None:
        if self._reports is not None:
            self._reports.on_key(sysid, channel)

    def _drain_notes(self) -> None:
        notes = self.router.table.notes
        while notes:
            note = notes.popleft()
            if self._reports is not None:
                self._reports.on_note(note, self.channels.get(note.channel_id), self.channels.get(note.present_id))

    def fault(self, error: Exception) -> None:
        """Contain an exception in a frame or a tick, which is our bug: count it, and report it once per kind."""
        self.faults += 1
        kind = f"{type(error).__name__}: {error}"[:200]
        if kind not in self._fault_kinds and len(self._fault_kinds) < 64:
            self._fault_kinds.add(kind)
            self._on_event(Event("fault", None, None, f"internal fault, please report it: {kind}", {}))


def _router_of(own: DaemonConfig, duplicates: Table | None) -> Router:
    return Router(
        own.sysid,
        own.compid,
        route_timeout_s=own.route_timeout_s,
        vehicle_timeout_s=own.vehicle_timeout_s,
        duplicates=duplicates,
    )


def _target_in(info: MessageInfo, values: Mapping[str, Any]) -> int:
    """The target system that a message names; 0 for all, and for a message without such a field."""
    at = info.target_system_offset
    name = next((field.name for field in info.fields if field.offset == at), None)
    return int(values.get(name, 0) or 0) if name is not None else 0
