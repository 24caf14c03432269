"""The routing table, and every routing rule: on which channels a source was heard, and where a frame goes.

Rules (https://mavlink.io/en/guide/routing.html, and what a ground router of many vehicles needs on top):

    frame                                   goes to
    ------------------------------------    -----------------------------------------------------------------------
    no target, or target system 0           every other channel (not: same group; not: telemetry of a vehicle to
                                            channels of role vehicle or radio; not: RADIO_STATUS to vehicles)
    id not in the dialect                   as without a target; to a radio only if the link allows it; makes no route
    target = our system and component       us
    target = our system, component 0        us, and where others with our system id were heard
    target = our system, other component    where that component was heard
    target = other system                   where that component was heard, else where that system was heard;
                                            of channels that hear the same frames twice only the better one
    target never heard                      nowhere, counted
    source = our own id                     nowhere: an echo, or a conflict of ids; counted, reported, not learned
    an autopilot's, from a gcs channel,     nowhere: an echo of what the ground station was sent
    though it is heard elsewhere            (from a bound channel: also if it is heard nowhere else)
    a recording's (replayed channel)        without a target: ground stations (role gcs); with one: nowhere. Nothing
                                            of what is alive elsewhere, and nothing is ever sent to the recording

A channel may be bound to vehicles (`ChannelPolicy.vehicles`): the program behind it sees only those. Then also:

    to it, from another system              nowhere: other vehicles, other ground stations, RADIO_STATUS, our own
    from it, target = one of its vehicles   as above
    from it, target = any other, ours too   nowhere; counted as out_of_bounds, reported once for each target
    from it, target system 0                its vehicle (`SysidTranslator` has put its id there); out of bounds if there
                                            are several
    from it, no target or id not known      us; channels that are not bound and on which no autopilot of another system
                                            is heard, those of role vehicle or radio only if one of its own is

Many programs use one id (pymavlink is 255/0): so a frame from a bound channel is never taken for a copy, and an answer
goes where that id was heard and the answering system may be heard.

Never back to the channel it came from. SYSTEM_TIME going back means the system rebooted: its routes are cleared.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Collection
from functools import partial

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import DEFAULT_LOST_S, discovers
from skygcs.core.mavlink.msgids import HEARTBEAT, RADIO, RADIO_STATUS, SYSTEM_TIME
from skygcs.core.routing.channel import KIND_BITS, OF_RADIO, TELEMETRY, UNKNOWN_ID, Port
from skygcs.core.routing.decision import Decision, ForwardingEntry, RouteNote, RoutingVerdict
from skygcs.core.routing.duplicates import CHANNEL_SILENT_S, DuplicateFilter, FirstHeard, ParallelChannels
from skygcs.core.routing.filters import ChannelPolicy
from skygcs.core.routing.state_source import Known, SourceReport, StateSource
from skygcs.core.routing.table_room import RouteRoom

FORGOTTEN_S = 10.0
"""A vehicle is on one channel again when no other one has had a frame with its ids for this time."""

MAX_NOTES = 256
CONFLICT_QUIET_S = 60.0
"""A conflict is reported again only after this time without one on the same channel."""

BOOT_JITTER_MS = 3000
"""SYSTEM_TIME may come late by as much over two links; what went back by less is no reboot ..."""

HEARD_NOW_S = 2.0
"""Two heartbeats: a source that was heard on a channel within this is there."""

JUST_BOOTED_MS = 10_000
"""... unless it shows a system that has only just started."""

_DUPLICATE = Decision(RoutingVerdict.DUPLICATE)
_CONFLICT = Decision(RoutingVerdict.CONFLICT)
_FILTERED_IN = Decision(RoutingVerdict.FILTERED_IN)
_UNKNOWN_TARGET = Decision(RoutingVerdict.UNKNOWN_TARGET)
_NOBODY = Decision(RoutingVerdict.NOBODY)
_OUT_OF_BOUNDS = Decision(RoutingVerdict.OUT_OF_BOUNDS)


class Router:
    """The routing table. Channels are opened and closed by the host; `decide` learns from a frame and routes it."""

    def __init__(
        self,
        own_sysid: int,
        own_compid: int,
        *,
        route_timeout_s: float = 60.0,
        vehicle_timeout_s: float = DEFAULT_LOST_S,
        duplicates: FirstHeard | None = None,
    ) -> None:
        """``duplicates``: the memory of recent frames; None: a `DuplicateFilter`."""
        # identity of the daemon, timeouts
        self._own_sysid = own_sysid
        self._own_source = own_sysid << 8 | own_compid
        self._own_compid = own_compid
        self._route_timeout_s = route_timeout_s
        self._vehicle_timeout_s = vehicle_timeout_s
        # ports, and the routes that lead to them
        self._ports: dict[int, Port] = {}
        self._by_source: dict[int, list[Port]] = {}
        self._by_system: dict[int, list[Port]] = {}
        self._duplicates: FirstHeard = DuplicateFilter() if duplicates is None else duplicates
        self.on_change: Callable[[], None] = lambda: None
        """Called whenever an answer of `forwarding_entry`, also None, may have become wrong."""
        # parallel links and copies of frames
        self._dedup = False
        self._any_bound = False
        self._parallel: dict[int, ParallelChannels] = {}
        self._heard_directly: set[int] = set()
        """Autopilots heard on their own links: from a ground station or a recording their frames are echoes."""
        self._first_channel_id = 0
        """The channel on which the last copy was heard first."""
        # choice of the channel of each vehicle's state
        self.state_sources: dict[int, StateSource] = {}
        """By sysid<<8|compid: the vehicles that are heard on several channels, or were just now; see `supplies`."""
        # facts and callbacks of the fleet
        self.known: Callable[[int], Known | None] = lambda source: None
        """The last frames of a vehicle whose state is kept; None for any other source."""
        self.on_replaced: Callable[[int], None] = lambda source: None
        """Called when another vehicle has taken a known one's place (or the same one restarted on another channel),
        before its first frame counts."""
        self.on_switched: Callable[[int, int], None] = lambda source, channel_id: None
        """Called when a vehicle's state comes over this channel from now on, which also gets its orders."""
        self.may_fly: Callable[[int], bool] = lambda source: False
        """True if this is a vehicle that may be in the air: its last route stays (`core.vehicle.supply`)."""
        self.received: Callable[[int, int], tuple[int, int] | None] = lambda channel_id, source: None
        """Frames received and lost of a source on a channel; None: not counted."""
        # bounds and counters
        self._room = RouteRoom()
        self.counters: dict[RoutingVerdict, int] = dict.fromkeys(RoutingVerdict, 0)
        self.unreported_routes = 0
        """Routes learned or expired that were not reported."""
        self.notes: deque[RouteNote] = deque(maxlen=MAX_NOTES)

    # -- channels

    def open(self, channel_id: int, policy: ChannelPolicy) -> None:
        """A channel exists from now on. Raises ValueError if the id is taken."""
        if channel_id in self._ports:
            raise ValueError(f"channel {channel_id} is open already")
        self._ports[channel_id] = Port(channel_id, policy)
        self._topology_changed()

    def close(self, channel_id: int) -> None:
        """The channel is gone, and all its routes with it. Unknown ids are ignored."""
        port = self._ports.pop(channel_id, None)
        if port is None:
            return
        for state in self.state_sources.values():
            state.closed(channel_id)
        for source in list(port.heard):
            self._forget(port, source)
        for system, parallel in list(self._parallel.items()):
            parallel.forget(channel_id)
            if len(parallel.channel_ids) < 2:
                del self._parallel[system]
        self._topology_changed()

    def _topology_changed(self, source: int | None = None) -> None:
        """Note that what a channel may send has changed: because of this source, or (None) because a channel came or
        went."""
        self.on_change()
        for port in self._ports.values():
            port.broadcast.clear()
        if source is not None:  # the others are as they were: a flood of sources costs each only its own
            if self._is_heard_directly(source):
                self._heard_directly.add(source)
            else:
                self._heard_directly.discard(source)
            return
        self._dedup = len(self._ports) > 1
        self._any_bound = any(port.bound for port in self._ports.values())
        self._heard_directly = {
            source for port in self._ports.values() for source in port.vehicles if self._is_heard_directly(source)
        }

    def _is_heard_directly(self, source: int) -> bool:
        """True if a vehicle is heard over a channel of its own, not only through a ground station or in a recording."""
        if not any(
            source in port.vehicles and port.policy.role != "gcs" and not port.policy.replayed
            for port in self._by_source.get(source, ())
        ):
            return False
        return source not in self.state_sources or not self._is_station(self.state_sources[source].present_id)

    def _is_station(self, channel_id: int | None) -> bool:
        """True if this is the channel of a ground station."""
        port = self._ports.get(channel_id or 0)
        return port is not None and port.policy.role == "gcs"

    # -- one frame

    def decide(self, channel_id: int, frame: Frame, now: float) -> Decision:
        """Learn from one received frame and decide where it goes. Hot: one call per frame."""
        port = self._ports[channel_id]
        source = frame.sysid << 8 | frame.compid
        # frames that are not learned from: our own id, filtered, echoes
        if source == self._own_source:
            return _CONFLICT if port.policy.replayed else self._conflict(port, frame, now)
        if port.filter_in is not None and not port.filter_in.passes(frame.msgid, frame.sysid, frame.compid):
            port.filtered_in += 1
            return self._counted(_FILTERED_IN)
        if source in self._heard_directly and (port.policy.role == "gcs" or port.policy.replayed):
            return self._echo(port, source, now)
        if port.bound and frame.msgid == HEARTBEAT and discovers(frame):
            return self._echo(port, source, now)
        # learn the route, the vehicle and its clock
        info = frame.info
        if info is not None:
            if frame.msgid == SYSTEM_TIME:
                self._check_reboot(port, frame, source, now)
            if source in port.heard:
                port.heard[source] = now
            else:
                self._learn(port, source, frame, now)
            if frame.msgid == HEARTBEAT:
                self._check_vehicle(port, frame, source, now)
        # drop copies, and what this channel must not send
        if self._dedup and not port.bound and self._is_copy(port, frame, source, now):
            return self._counted(_DUPLICATE)
        system, component = frame.target()
        if port.bound and system not in port.bound and (system or _has_target(frame)):
            return self._not_permitted(port, source, system, now)
        if port.limiter_in is not None and not port.limiter_in.passes(
            source, frame.msgid, len(frame.raw), system != 0, now
        ):
            port.limited += 1
            return self._counted(_FILTERED_IN)
        # find its destinations
        if system == 0:
            decision = self._broadcast(port, frame, source, now)
        elif port.policy.replayed:
            decision = _NOBODY
        else:
            decision = self._targeted(port, frame, system, component, now)
        self.counters[decision.verdict] += 1
        return decision

    def forwarding_entry(self, channel_id: int, frame: Frame) -> ForwardingEntry | None:
        """The decision for all further frames of this source and message that have no target and are no copies (and,
        for heartbeats, have the same payload), until `on_change`. None: `decide` must be called for each.
        """
        port = self._ports[channel_id]
        source = frame.sysid << 8 | frame.compid
        if frame.info is None or frame.msgid == SYSTEM_TIME or port.policy.replayed or not self._dedup:
            return None
        if source in self.state_sources:
            return None  # each of its frames is compared
        if port.bound:
            return None  # the fast path would take equal frames of another program for copies
        if source == self._own_source or source not in port.heard or frame.sysid in self._parallel:
            return None
        if len(self._by_source[source]) > 1:
            return None  # only their order shows which channel's frame is the newest
        if source in self._heard_directly and port.policy.role == "gcs":
            return None
        if port.limiter_in is not None:
            return None
        if port.filter_in is not None and not port.filter_in.passes(frame.msgid, frame.sysid, frame.compid):
            return None
        decision, checked = self._broadcast_to(port, frame, source)
        for other in checked:
            if other.limiter_out is not None or other.filter_out is None:
                return None
            if not other.filter_out.passes(frame.msgid, frame.sysid, frame.compid):
                return None
        return ForwardingEntry(decision.destinations, port.heard)

    def _counted(self, decision: Decision) -> Decision:
        self.counters[decision.verdict] += 1
        return decision

    def _broadcast(self, port: Port, frame: Frame, source: int, now: float) -> Decision:
        decision, checked = self._broadcast_to(port, frame, source)
        if not checked:
            return decision
        return self._restricted(decision, frame, source, False, now)

    def _broadcast_to(self, port: Port, frame: Frame, source: int) -> tuple[Decision, tuple[Port, ...]]:
        kind = 0
        if frame.info is None:
            kind = UNKNOWN_ID
        elif frame.msgid == RADIO_STATUS or frame.msgid == RADIO:
            kind = OF_RADIO
        if port.policy.carries_vehicles or source in port.vehicles:
            kind |= TELEMETRY
        if self._any_bound:
            kind |= frame.sysid << KIND_BITS
        cached = port.broadcast.get(kind)
        if cached is None:
            cached = port.broadcast[kind] = self._broadcast_ports(port, kind, frame.sysid)
        return cached

    def _broadcast_ports(self, port: Port, kind: int, sysid: int) -> tuple[Decision, tuple[Port, ...]]:
        """The decision for this kind of broadcast of a system, and its destinations that have filters or limits."""
        ports = [p for p in self._ports.values() if p.may_hear(sysid) and port.takes_broadcast(p, kind)]
        verdict = RoutingVerdict.FORWARDED if ports else RoutingVerdict.LOCAL
        decision = Decision(verdict, tuple(p.id for p in ports), local=True)
        return decision, tuple(p for p in ports if p.restricts_out)

    def _targeted(self, port: Port, frame: Frame, system: int, component: int, now: float) -> Decision:
        ports: list[Port] | None
        local = False
        if system == self._own_sysid:
            local = component in (0, self._own_compid)
            if component == self._own_compid:
                ports = []
            elif component == 0:
                ports = self._by_system.get(system)
            else:
                ports = self._by_source.get(system << 8 | component)
        else:
            ports = (component and self._by_source.get(system << 8 | component)) or self._by_system.get(system)
        if not ports:
            return Decision(RoutingVerdict.LOCAL, (), local=True) if local else _UNKNOWN_TARGET
        if len(ports) > 1 and system in self._parallel:
            ports = self._preferred(ports, system, now)
        ids = tuple(p.id for p in ports if port.may_forward(p) and p.may_hear(frame.sysid))
        if not ids:
            return Decision(RoutingVerdict.LOCAL, (), local=True) if local else _NOBODY
        decision = Decision(RoutingVerdict.FORWARDED, ids, local)
        if any(p.restricts_out for p in ports):
            return self._restricted(decision, frame, frame.sysid << 8 | frame.compid, True, now)
        return decision

    def _restricted(self, decision: Decision, frame: Frame, source: int, targeted: bool, now: float) -> Decision:
        """The decision without the channels whose filters or limits keep this frame out."""
        passed = []
        for channel_id in decision.destinations:
            port = self._ports[channel_id]
            if port.filter_out is not None and not port.filter_out.passes(frame.msgid, frame.sysid, frame.compid):
                port.filtered_out += 1
            elif port.limiter_out is not None and not port.limiter_out.passes(
                source, frame.msgid, len(frame.raw), targeted, now
            ):
                port.limited += 1
            else:
                passed.append(channel_id)
        if len(passed) == len(decision.destinations):
            return decision
        if passed:
            return Decision(RoutingVerdict.FORWARDED, tuple(passed), decision.local)
        return Decision(RoutingVerdict.LOCAL if decision.local else RoutingVerdict.NOBODY, (), decision.local)

    def _preferred(self, ports: list[Port], system: int, now: float) -> list[Port]:
        """Without parallel channels but one: the one that supplies the vehicle's state, or the better one."""
        parallel = self._parallel[system]
        best = next((s.present_id for key, s in self.state_sources.items() if key >> 8 == system), None)
        if best is None:
            best = parallel.choose({p.id: self._last_heard(p, system) for p in ports}, now)
        if best is None:
            return ports
        same = parallel.channel_ids
        return [p for p in ports if p.id == best or p.id not in same]

    @staticmethod
    def _last_heard(port: Port, system: int) -> float:
        return max((port.heard[source] for source in port.of_system.get(system, ())), default=float("-inf"))

    # -- our own messages

    def route_own(
        self, sysid: int, compid: int, now: float, *, everywhere: bool = False, setpoint: bool = False
    ) -> tuple[int, ...]:
        """Channels for a message of ours: all for system 0; else the best one to that component or system, or
        the one that supplies the vehicle's state.

        A ``setpoint`` also takes another one while that one is in doubt. ``everywhere`` (emergencies) takes every
        channel on which it was heard. () if it was never heard. Never one that is bound to vehicles.
        """
        if sysid == 0:
            return tuple(p.id for p in self._ports.values() if not p.policy.replayed and not p.bound)
        ports = self._by_source.get(sysid << 8 | compid) or self._by_system.get(sysid) or []
        if len(ports) == 1 and not self.state_sources:  # nearly always, and for every setpoint: 0.25 us instead of 0.85
            port = ports[0]
            return () if port.policy.replayed or port.bound else (port.id,)
        ports = [p for p in ports if not p.policy.replayed and not p.bound]
        ports = [p for p in ports if p.policy.role != "gcs"] or ports
        if not ports:
            return ()
        if everywhere:
            return tuple(p.id for p in ports)
        state = self.state_sources.get(sysid << 8 | compid)
        if state is not None:
            ports = [p for p in ports if p.id == state.present_id] or [p for p in ports if state.may_be(p.id)]
        if setpoint and state is not None and (other := state.stand_in(now)) is not None:
            return tuple(dict.fromkeys((*(p.id for p in ports), other)))
        if state is not None or len(ports) == 1:
            return () if not ports else (max(ports, key=lambda p: self._last_heard(p, sysid)).id,)
        heard = {p.id: self._last_heard(p, sysid) for p in ports}
        parallel = self._parallel.get(sysid)
        best = parallel.choose(heard, now) if parallel is not None else None
        return (best if best is not None else max(heard, key=lambda c: heard[c]),)

    # -- learning and forgetting

    def _learn(self, port: Port, source: int, frame: Frame, now: float) -> None:
        if source >> 8 == 0:
            return  # system 0 is "all" as a target: a route to it would catch every broadcast
        self._share_state(port, source, now)
        if not self._room.is_free(port) and not self._make_room(port, source, frame, now):
            return
        port.heard[source] = now
        port.of_system.setdefault(source >> 8, set()).add(source)
        self._room.added(port)
        ports = self._by_source.setdefault(source, [])
        if ports:
            self.on_change()
        ports.append(port)
        systems = self._by_system.setdefault(source >> 8, [])
        if port not in systems:
            systems.append(port)
        self._note_route("learned", source, port, now)

    def _make_room(self, port: Port, source: int, frame: Frame, now: float) -> bool:
        """True if a new source may be kept on a full channel: an autopilot may, if another source can be removed."""
        if self._room.became_crowded(port.policy.link, now):
            self._note("crowded", source, port)
        place = None
        if frame.msgid == HEARTBEAT and discovers(frame):
            place = self._room.gives_way(port, self._ports.values())
        if place is None:
            self._room.refused += 1
            port.routes_refused += 1
            return False
        crowded, silent = place
        self._room.evicted += 1
        crowded.routes_evicted += 1
        self._forget(crowded, silent)
        return True

    def _forget(self, port: Port, source: int) -> None:
        self.on_change()
        del port.heard[source]
        port.boot_ms.pop(source, None)
        self._room.removed(port)
        _remove(self._by_source, source, port)
        system = source >> 8
        port.of_system[system].discard(source)
        if not port.of_system[system]:
            del port.of_system[system]
            _remove(self._by_system, system, port)
        if source in port.vehicles:
            port.vehicles.discard(source)
            self._topology_changed(source)

    # -- vehicles on several channels

    def _share_state(self, port: Port, source: int, now: float) -> None:
        """A channel has frames of a source for the first time: if it is a vehicle that others hear, or that was heard
        before, one of them supplies its state from now on."""
        if source in self.state_sources or port.policy.replayed:
            return
        others = [p for p in self._by_source.get(source, ()) if p is not port and not p.policy.replayed and not p.bound]
        replayed = any(p.policy.replayed for p in self._by_source.get(source, ()))  # ground stations echo it
        hearing = [p for p in others if source in p.vehicles and not (replayed and p.policy.role == "gcs")]
        known = self.known(source)
        if hearing:
            before = max(hearing, key=lambda p: p.heard[source])
            lost_s, cost = self._vehicle_timeout_s, before.policy.cost
            state = StateSource(before.id, before.policy.link, known, now, lost_s=lost_s, cost=cost)
        elif known is not None and not others:
            state = StateSource(None, "", known, now, lost_s=self._vehicle_timeout_s)
        else:
            return
        self.state_sources[source] = state
        self._topology_changed(source)

    def supplies(self, channel_id: int, frame: Frame, now: float, *, copy: bool) -> bool:
        """True if this frame, of one of `state_sources`, counts for the vehicle's state; call it after `decide`.
        ``copy``: the verdict was DUPLICATE."""
        port = self._ports[channel_id]
        source = frame.sysid << 8 | frame.compid
        state = self.state_sources[source]
        if port.policy.replayed or port.bound or frame.info is None:
            return False
        if source in self._heard_directly and port.policy.role == "gcs":
            return False
        of, cost = self._first_channel_id if copy else None, port.policy.cost
        counts = state.accepts(channel_id, port.policy.link, frame, now, of=of, cost=cost)
        handed_back = not counts and port.policy.role != "gcs" and self._is_station(state.present_id)
        if handed_back and state.is_original(channel_id):
            state.take_over(channel_id, now)
            counts = True
        if state.reports:
            self._report(source, state)
        return counts

    def _report(self, source: int, state: StateSource) -> None:
        reports, state.reports = state.reports, []
        for report in reports:
            if not report.quiet:
                self._note_report(source, report)
            if report.kind in ("switched", "replaced"):
                self._topology_changed(source)
                self._drop_echo_routes(source)
                self.on_switched(source, report.channel_id or 0)
            if report.kind == "replaced":
                self.on_replaced(source)

    def _note_report(self, source: int, report: SourceReport) -> None:
        channel_id, present_id = report.channel_id or 0, report.present_id or 0
        note = RouteNote(
            report.kind,
            source >> 8,
            source & 0xFF,
            channel_id,
            present_id=present_id,
            why=report.why,
            count=report.count,
        )
        self.notes.append(note)

    def _tick_state(self, source: int, state: StateSource, now: float) -> None:
        state.tick(now)
        if state.reports:
            self._report(source, state)
        ports = self._by_source.get(source, [])
        alone = not ports or (len(ports) == 1 and ports[0].id == state.present_id)
        if alone and not state.duplicate and now - state.heard_elsewhere_at() > FORGOTTEN_S:
            del self.state_sources[source]
            self._topology_changed(source)

    def choose_links(self, now: float) -> None:
        """Assess the links to each vehicle that is heard on several, and change over to better ones. Call it some times
        a second."""
        for source, state in list(self.state_sources.items()):
            state.choose(partial(self._received, source), now)
            if state.reports:
                self._report(source, state)

    def uplink_lost(self, source: int) -> None:
        """This vehicle does not hear us over the link that is used; without effect if it is heard on one only."""
        if (state := self.state_sources.get(source)) is not None:
            state.uplink_lost()

    def links_to_probe(self, now: float) -> list[tuple[int, int]]:
        """Vehicles and channels over which they did not hear us and are to be asked again now."""
        return [(source, i) for source, state in self.state_sources.items() for i in state.to_probe(now)]

    def _received(self, source: int, channel_id: int) -> tuple[int, int] | None:
        return self.received(channel_id, source)

    def expire(self, now: float) -> None:
        """Forget routes that were not heard for the route timeout. Call it about once a second."""
        limit = now - self._route_timeout_s
        for port in self._ports.values():
            for source in [s for s, at in port.heard.items() if at < limit and not self._leads_to_flying(port, s)]:
                self._forget(port, source)
                self._note_route("expired", source, port, now)
        if self._room.crowded:
            for link in self._room.became_ample(self._ports.values()):
                for port in [p for p in self._ports.values() if p.policy.link == link][:1]:
                    self._note("crowded_over", 0, port)
        for source, state in list(self.state_sources.items()):
            self._tick_state(source, state, now)

    def _check_reboot(self, port: Port, frame: Frame, source: int, now: float) -> None:
        """The routing guide: SYSTEM_TIME with a smaller time_boot_ms clears the system's routes. Routes with frames
        within HEARD_NOW_S stay, unless the clock is that of the channel that supplies the vehicle's state: any sender
        can forge a clock, and a forged one must not keep orders from a vehicle."""
        boot_ms = struct.unpack_from("<I", frame.payload + bytes(12), 8)[0]
        before = port.boot_ms.get(source, 0)
        state = self.state_sources.get(source)
        estimated = state is None or state.present_id in (None, port.id)
        if estimated and boot_ms < before and (boot_ms < JUST_BOOTED_MS or boot_ms < before - BOOT_JITTER_MS):
            system = source >> 8
            # programs with one id behind bound channels each have their own clock
            for other in [port] if port.bound else [p for p in self._ports.values() if not p.bound]:
                for known in sorted(other.of_system.get(system, ())):
                    there = state is None and now - other.heard[known] <= HEARD_NOW_S
                    if (other, known) != (port, source) and not there:
                        self._forget(other, known)
            if not port.bound:
                self._parallel.pop(system, None)
            self.on_change()
            self._note_some("cleared", source, port, now)
        if source in port.heard:
            port.boot_ms[source] = boot_ms

    def _check_vehicle(self, port: Port, frame: Frame, source: int, now: float) -> None:
        """A heartbeat of an autopilot: what this source broadcasts from here is telemetry of a vehicle."""
        if source not in port.heard or not discovers(frame):
            return
        if source not in port.vehicles:
            port.vehicles.add(source)
            if len(self._by_source[source]) > 1:
                self._share_state_of_new(port, source, now)
            self._topology_changed(source)
            self._drop_echo_routes(source)

    def _share_state_of_new(self, port: Port, source: int, now: float) -> None:
        """A source heard on several channels was found to be a vehicle on this one."""
        if source in self.state_sources or port.policy.replayed or port.bound:
            return
        if any(p is not port and not p.policy.replayed and not p.bound for p in self._by_source[source]):
            lost_s, cost = self._vehicle_timeout_s, port.policy.cost
            state = StateSource(port.id, port.policy.link, None, now, lost_s=lost_s, cost=cost)
            self.state_sources[source] = state

    def _drop_echo_routes(self, source: int) -> None:
        """Drop routes through ground stations and recordings, by which a vehicle may have been heard first."""
        if source not in self._heard_directly:
            return
        for port in self._ports.values():
            if source in port.heard and (port.policy.role == "gcs" or port.policy.replayed):
                self._forget(port, source)

    def _echo(self, port: Port, source: int, now: float) -> Decision:
        if source not in port.echoes and len(port.echoes) < MAX_NOTES:
            port.echoes.add(source)
            self._note_some("echo", source, port, now)
        return self._counted(_DUPLICATE)

    def _is_copy(self, port: Port, frame: Frame, source: int, now: float) -> bool:
        # one int, as the fast path keeps it
        first = self._duplicates.first_heard_on(source << 24 | frame.seq << 16 | frame.crc, port.id, now)
        system = source >> 8
        parallel = self._parallel.get(system)
        copy = first != port.id and first in self._ports
        self._first_channel_id = first
        if copy and parallel is None:
            self.on_change()
            parallel = self._parallel[system] = ParallelChannels(first)
            parallel.on_frame(first, copy=False)
        if parallel is not None:
            parallel.on_frame(port.id, copy=copy)
            if parallel.over:
                self._end_parallel(system, now)
        return copy

    def _end_parallel(self, system: int, now: float) -> None:
        """SCORE_FRAMES frames came without copies. A channel that was silent meanwhile loses its routes to it."""
        parallel = self._parallel.pop(system)
        self.on_change()
        for port in list(self._by_system.get(system, ())):
            if port.id in parallel.channel_ids and now - self._last_heard(port, system) > CHANNEL_SILENT_S / 2:
                for source in sorted(port.of_system.get(system, ())):
                    self._forget(port, source)

    def _conflict(self, port: Port, frame: Frame, now: float) -> Decision:
        if now - port.conflict_at > CONFLICT_QUIET_S:
            self._note_some("conflict", frame.sysid << 8 | frame.compid, port, now)
        port.conflict_at = now
        return self._counted(_CONFLICT)

    def _not_permitted(self, port: Port, source: int, target: int, now: float) -> Decision:
        """Reject a frame addressed outside the channel's vehicles."""
        port.out_of_bounds += 1
        if target not in port.refused:
            port.refused.add(target)
            self._note_some("out_of_bounds", source, port, now, target)
        return self._counted(_OUT_OF_BOUNDS)

    def _note_route(self, kind: str, source: int, port: Port, now: float) -> None:
        """Report a route that came or went, up to the link's rate of such reports."""
        if self._room.may_note(port.policy.link, now):
            self._note(kind, source, port)
        else:
            self.unreported_routes += 1

    def _note_some(self, kind: str, source: int, port: Port, now: float, target: int = 0) -> None:
        """The same for problems, with a rate of their own: a flood of learned routes hides none."""
        if self._room.may_note(f"{port.policy.link}: wrong", now):
            self._note(kind, source, port, target)

    def _note(self, kind: str, source: int, port: Port, target: int = 0) -> None:
        self.notes.append(RouteNote(kind, source >> 8, source & 0xFF, port.id, target))

    # -- status

    @property
    def refused_routes(self) -> int:
        """Frames of sources for which the table had no room (`core.routing.table_room`)."""
        return self._room.refused

    @property
    def evicted_routes(self) -> int:
        """Sources that were removed for an autopilot."""
        return self._room.evicted

    @property
    def duplicates(self) -> set[int]:
        """Autopilot ids (sysid<<8|compid) that two vehicles use."""
        return {source for source, state in self.state_sources.items() if state.duplicate}

    def channels_of(self, source: int) -> tuple[int, ...]:
        """Ids of the channels on which this sysid<<8|compid is heard; for a vehicle, the one that supplies its state
        comes first."""
        ports = self._by_source.get(source, [])
        state = self.state_sources.get(source)
        if state is not None:
            ports = sorted(ports, key=lambda p: p.id != state.present_id)
        return tuple(p.id for p in ports)

    def leads_to_flying(self, channel_id: int) -> bool:
        """True if this is the last way to a vehicle that may be in the air."""
        port = self._ports.get(channel_id)
        return port is not None and any(self._leads_to_flying(port, source) for source in port.vehicles)

    def _leads_to_flying(self, port: Port, source: int) -> bool:
        """True if no other channel has heard this source later, and it may be in the air."""
        if source not in port.vehicles or not self.may_fly(source):
            return False
        return all(p.heard[source] <= port.heard.get(source, -math.inf) for p in self._by_source.get(source, ()))

    def autopilots_on(self, channel_id: int) -> Collection[int]:
        """The autopilots (sysid<<8|compid) that are heard on a channel."""
        port = self._ports.get(channel_id)
        return () if port is None else port.vehicles

    def hears(self, channel_id: int, system: int) -> bool:
        """True if there is a route to this system over this channel."""
        port = self._ports.get(channel_id)
        return port is not None and system in port.of_system

    def routes(self) -> list[tuple[int, int, int, float]]:
        """(sysid, compid, channel id, last heard at), sorted."""
        rows = [(s >> 8, s & 0xFF, p.id, at) for p in self._ports.values() for s, at in p.heard.items()]
        return sorted(rows)

    def port_counters(self, channel_id: int) -> dict[str, int]:
        """Counts of frames that one channel rejected: by filters, limits and its vehicles."""
        port = self._ports.get(channel_id)
        if port is None:
            return {}
        kept = {"filtered_in": port.filtered_in, "filtered_out": port.filtered_out, "rate_limited": port.limited}
        kept |= {"routes_refused": port.routes_refused, "routes_evicted": port.routes_evicted}
        return kept | {"out_of_bounds": port.out_of_bounds} if port.bound else kept


def _has_target(frame: Frame) -> bool:
    """True if the message has a target field, whatever its value."""
    return frame.info is not None and frame.info.target_system_offset >= 0


def _remove(table: dict[int, list[Port]], key: int, port: Port) -> None:
    ports = table[key]
    ports.remove(port)
    if not ports:
        del table[key]
