"""Every routing rule: where a frame goes. On which channels a source was heard: `core.routing.routing_table`.

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

Copies of frames: the same (sysid, compid, seq, CRC) heard on another channel a moment ago.

Copies on the *same* channel pass: some senders never count their seq up, and their repeated commands are meant.
"""

from __future__ import annotations

import struct
from collections.abc import Hashable
from typing import Protocol

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import DEFAULT_LOST_S, discovers
from skygcs.core.mavlink.msgids import HEARTBEAT, RADIO, RADIO_STATUS, SYSTEM_TIME
from skygcs.core.routing.filters import ChannelPolicy
from skygcs.core.routing.routing_table import (
    KIND_BITS,
    MAX_NOTES,
    OF_RADIO,
    TELEMETRY,
    UNKNOWN_ID,
    Decision,
    ForwardingEntry,
    Port,
    RoutingTable,
    RoutingVerdict,
)
from skygcs.core.routing.source_selection import SourceSelection

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
    """Routes frames. Channels are opened and closed by the host; `decide` learns from a frame and routes it."""

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
        # routes, and the choice of the channel of each vehicle's state
        self.table = RoutingTable()
        self.selection = SourceSelection(self.table, vehicle_timeout_s)
        # the same collections, without a further step for every frame
        self._ports = self.table.ports
        self._by_source = self.table.by_source
        self._by_system = self.table.by_system
        self._heard_directly = self.table.heard_directly
        self.state_sources = self.selection.sources
        """By sysid<<8|compid: the vehicles that are heard on several channels, or were just now."""
        # copies of frames, and parallel links
        self._duplicates: FirstHeard = DuplicateFilter() if duplicates is None else duplicates
        self._dedup = False
        self._any_bound = False
        self._parallel: dict[int, ParallelChannels] = {}
        self.first_channel_id = 0
        """The channel on which the last copy was heard first."""
        self.counters: dict[RoutingVerdict, int] = dict.fromkeys(RoutingVerdict, 0)

    # -- channels

    def open(self, channel_id: int, policy: ChannelPolicy) -> None:
        """A channel exists from now on. Raises ValueError if the id is taken."""
        if channel_id in self._ports:
            raise ValueError(f"channel {channel_id} is open already")
        self._ports[channel_id] = Port(channel_id, policy)
        self._channels_changed()

    def close(self, channel_id: int) -> None:
        """The channel is gone, and all its routes with it. Unknown ids are ignored."""
        port = self._ports.get(channel_id)
        if port is None:
            return
        self.selection.closed(channel_id)
        self.table.close(port)
        for system, parallel in list(self._parallel.items()):
            parallel.forget(channel_id)
            if len(parallel.channel_ids) < 2:
                del self._parallel[system]
        self._channels_changed()

    def _channels_changed(self) -> None:
        self.table.topology_changed()
        self._dedup = len(self._ports) > 1
        self._any_bound = any(port.bound for port in self._ports.values())

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
        for heartbeats, have the same payload), until the table's `on_change`. None: `decide` must be called for each.
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
        self.selection.heard_first(port, source, now)
        self.table.learn(port, source, frame, now)

    def expire(self, now: float) -> None:
        """Forget routes that were not heard for the route timeout. Call it about once a second."""
        self.table.expire(now - self._route_timeout_s, now)
        self.selection.tick(now)

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
                        self.table.forget(other, known)
            if not port.bound:
                self._parallel.pop(system, None)
            self.table.on_change()
            self.table.note_problem("cleared", source, port, now)
        if source in port.heard:
            port.boot_ms[source] = boot_ms

    def _check_vehicle(self, port: Port, frame: Frame, source: int, now: float) -> None:
        """A heartbeat of an autopilot: what this source broadcasts from here is telemetry of a vehicle."""
        if source not in port.heard or not discovers(frame):
            return
        if source not in port.vehicles:
            port.vehicles.add(source)
            if len(self._by_source[source]) > 1:
                self.selection.found_vehicle(port, source, now)
            self.table.topology_changed(source)
            self.table.drop_echo_routes(source)

    def _echo(self, port: Port, source: int, now: float) -> Decision:
        if source not in port.echoes and len(port.echoes) < MAX_NOTES:
            port.echoes.add(source)
            self.table.note_problem("echo", source, port, now)
        return self._counted(_DUPLICATE)

    def _is_copy(self, port: Port, frame: Frame, source: int, now: float) -> bool:
        # one int, as the fast path keeps it
        first = self._duplicates.first_heard_on(source << 24 | frame.seq << 16 | frame.crc, port.id, now)
        system = source >> 8
        parallel = self._parallel.get(system)
        copy = first != port.id and first in self._ports
        self.first_channel_id = first
        if copy and parallel is None:
            self.table.on_change()
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
        self.table.on_change()
        for port in list(self._by_system.get(system, ())):
            if port.id in parallel.channel_ids and now - self._last_heard(port, system) > CHANNEL_SILENT_S / 2:
                for source in sorted(port.of_system.get(system, ())):
                    self.table.forget(port, source)

    def _conflict(self, port: Port, frame: Frame, now: float) -> Decision:
        if now - port.conflict_at > CONFLICT_QUIET_S:
            self.table.note_problem("conflict", frame.sysid << 8 | frame.compid, port, now)
        port.conflict_at = now
        return self._counted(_CONFLICT)

    def _not_permitted(self, port: Port, source: int, target: int, now: float) -> Decision:
        """Reject a frame addressed outside the channel's vehicles."""
        port.out_of_bounds += 1
        if target not in port.refused:
            port.refused.add(target)
            self.table.note_problem("out_of_bounds", source, port, now, target)
        return self._counted(_OUT_OF_BOUNDS)

    # -- status

    def channels_of(self, source: int) -> tuple[int, ...]:
        """Ids of the channels on which this sysid<<8|compid is heard; for a vehicle, the one that supplies its state
        comes first."""
        ports = self._by_source.get(source, [])
        state = self.state_sources.get(source)
        if state is not None:
            ports = sorted(ports, key=lambda p: p.id != state.present_id)
        return tuple(p.id for p in ports)

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
            late_s = now - self._turn_at  # below 0: full before its time
            self._old = self._new if late_s < WINDOW_S else {}
            self._new = {}
            self._turn_at = (self._turn_at if 0.0 <= late_s < WINDOW_S else now) + WINDOW_S
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
        """Forget a channel that is gone."""
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
