"""The routing table: its channels, and the rules between two of them (see the table in `core.routing.router`); on which
channels each source was heard, and what a flood of forged sources can take of it; and the answers of the router:
verdicts, destinations, changes of the table.

A source has a route to each channel on which it was heard, until it is silent there for the route timeout, the channel
closes, its system reboots, or an autopilot needs its room. An autopilot that has a channel of its own is *heard
directly*: what ground stations and recordings send of it are echoes, and give no route.

A sender can forge 65,000 sources. So that one channel cannot starve another:

    a channel                   keeps at most MAX_CHANNEL_ROUTES sources
    all channels of a link      keep at most MAX_LINK_ROUTES together; KEPT_ROUTES of each channel are its own
    a link                      takes no room from another link; the number of links is the operator's
    a full channel or link      refuses further sources, and keeps the earlier ones until they are silent
    an autopilot's heartbeat    takes the place of the source that was silent for longest, of its own channel if that is
                                full, else of the channel of its link that has most; never of another autopilot
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from enum import StrEnum

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.routing.filters import ChannelPolicy

# --- answers of the router --------------------------------------------------------------------------------------------


class RoutingVerdict(StrEnum):
    """The verdict on a frame. Values are the names of the counters. (A plain Enum computes its hash in Python.)"""

    FORWARDED = "forwarded"
    LOCAL = "local"
    NOBODY = "nobody_else"
    UNKNOWN_TARGET = "unknown_target"
    DUPLICATE = "duplicate"
    CONFLICT = "conflict"
    FILTERED_IN = "filtered_in"
    OUT_OF_BOUNDS = "out_of_bounds"
    """From a link bound to vehicles, and addressed to another system."""


@dataclass(frozen=True, slots=True)
class Decision:
    """``destinations``: channel ids. ``local``: it is also for us (addressed to us, or to all)."""

    verdict: RoutingVerdict
    destinations: tuple[int, ...] = ()
    local: bool = False


@dataclass(frozen=True, slots=True)
class ForwardingEntry:
    """The destinations of all further frames like one: `Router.forwarding_entry`."""

    destinations: tuple[int, ...]
    heard: dict[int, float]
    """The router's time of the last frame by sysid << 8 | compid; the fast path writes it."""


@dataclass(frozen=True, slots=True)
class RouteNote:
    """A change worth a log line: learned, expired, cleared, crowded (and over), conflict, echo, a target that was
    out_of_bounds, and for a vehicle's channels (`core.routing.state_source`): duplicate (and over), ignored, switched,
    replaced.
    """

    kind: str
    sysid: int
    compid: int
    channel_id: int
    target: int = 0
    """out_of_bounds: the addressed system; 0: all."""
    present_id: int = 0
    """The vehicle's present channel; for switched and replaced the one before; 0: closed."""
    why: str = ""
    """duplicate and ignored: what contradicted."""
    count: int = 0
    """duplicate and ignored: the number of ignored frames."""


# --- channels ---------------------------------------------------------------------------------------------------------


# Kinds of broadcast, as bits: each has its own cached list of destinations per channel.
TELEMETRY = 1
UNKNOWN_ID = 2
OF_RADIO = 4
KIND_BITS = 3


class Port:
    """One channel in the routing table."""

    __slots__ = (
        "boot_ms",
        "bound",
        "broadcast",
        "conflict_at",
        "echoes",
        "filter_in",
        "filter_out",
        "filtered_in",
        "filtered_out",
        "heard",
        "id",
        "limited",
        "limiter_in",
        "limiter_out",
        "of_system",
        "out_of_bounds",
        "policy",
        "refused",
        "routes_evicted",
        "routes_refused",
        "vehicles",
    )

    def __init__(self, channel_id: int, policy: ChannelPolicy) -> None:
        self.id = channel_id
        self.policy = policy
        self.bound = policy.vehicles
        self.filter_in = policy.filter_in or None
        self.filter_out = policy.filter_out or None
        self.limiter_in = policy.limiter_in() or None
        self.limiter_out = policy.limiter_out() or None
        self.heard: dict[int, float] = {}
        self.of_system: dict[int, set[int]] = {}
        """The sources in ``heard`` by system."""
        self.echoes: set[int] = set()
        self.boot_ms: dict[int, int] = {}
        self.vehicles: set[int] = set()
        self.broadcast: dict[int, tuple[Decision, tuple[Port, ...]]] = {}
        self.conflict_at = float("-inf")
        self.routes_refused = 0
        self.routes_evicted = 0
        self.filtered_in = 0
        self.filtered_out = 0
        self.limited = 0
        self.out_of_bounds = 0
        self.refused: set[int] = set()
        """Targets out of bounds that were reported."""

    def may_hear(self, sysid: int) -> bool:
        """True if frames of this system may be sent there."""
        return not self.bound or sysid in self.bound

    @property
    def restricts_out(self) -> bool:
        """True if each frame to it must be checked."""
        return self.filter_out is not None or self.limiter_out is not None

    def may_forward(self, port: Port) -> bool:
        """True if frames from here may go there."""
        if port is self or port.policy.replayed or (self.policy.replayed and port.policy.role != "gcs"):
            return False
        return self.policy.group is None or self.policy.group != port.policy.group

    def takes_broadcast(self, port: Port, kind: int) -> bool:
        """True if a frame without a target from here goes there; ``kind``: the bits above."""
        if not self.may_forward(port):
            return False
        if kind & TELEMETRY and port.policy.carries_vehicles:
            return False
        if kind & UNKNOWN_ID and not port.policy.forward_unknown:
            return False
        if self.bound and not self._speaks_of_its_own_to(port):
            return False
        return not (kind & OF_RADIO and (port.policy.carries_vehicles or port.vehicles or port.bound))

    def _speaks_of_its_own_to(self, port: Port) -> bool:
        """True if a broadcast of a bound channel reaches only its own vehicles on this one."""
        if port.bound or any(autopilot >> 8 not in self.bound for autopilot in port.vehicles):
            return False
        return bool(port.vehicles) or not port.policy.carries_vehicles


# --- table ------------------------------------------------------------------------------------------------------------


MAX_CHANNEL_ROUTES = 1024
"""250 vehicles on one radio with four components each: autopilot, camera, gimbal, companion."""

MAX_LINK_ROUTES = 4096
"""Four such channels; some 1.5 MB."""

KEPT_ROUTES = 16
"""Kept for each channel, whatever its link's others take: an autopilot and the components of one vehicle."""

AMPLE_SHARE = 0.9
CROWDED_QUIET_S = 10.0
"""A link with a full channel counts as crowded until all are no fuller than this, and is reported no more often than
this: not for each source, nor for each client that connects, floods and goes."""

MAX_NOTES = 256

ROUTE_NOTES = 64
ROUTE_NOTES_PER_S = 1.0
"""Reports of learned or expired routes of one link: the start of a large fleet, then one a second. A flood of forged
sources would displace all other events of the daemon; reports left out are counted."""


class RouteRoom:
    """Counts the routes of each link, and chooses the route that a new one replaces."""

    __slots__ = ("_notes", "_of_link", "_reported_at", "crowded", "evicted", "refused")

    def __init__(self) -> None:
        self._of_link: dict[str, int] = {}
        self._notes: dict[str, tuple[float, float]] = {}
        self._reported_at: dict[str, float] = {}
        self.crowded: set[str] = set()
        """Links reported as crowded, until it is reported that there is room again."""
        self.refused = 0
        """Frames of sources for which there was no room."""
        self.evicted = 0
        """Sources that were replaced by an autopilot."""

    def added(self, port: Port) -> None:
        """A route was learned on this channel."""
        link = port.policy.link
        self._of_link[link] = self._of_link.get(link, 0) + 1

    def removed(self, port: Port) -> None:
        """A route of this channel was forgotten."""
        link = port.policy.link
        left = self._of_link[link] - 1
        if left:
            self._of_link[link] = left
        else:
            del self._of_link[link]

    def is_free(self, port: Port) -> bool:
        """True if this channel may keep one more source."""
        known = len(port.heard)
        if known >= MAX_CHANNEL_ROUTES:
            return False
        return known < KEPT_ROUTES or self._of_link.get(port.policy.link, 0) < MAX_LINK_ROUTES

    def gives_way(self, port: Port, ports: Iterable[Port]) -> tuple[Port, int] | None:
        """Channel and source that an autopilot, new on ``port``, replaces; None: none can be replaced."""
        if len(port.heard) >= MAX_CHANNEL_ROUTES:
            crowded = port
        else:
            of_link = [p for p in ports if p.policy.link == port.policy.link]
            crowded = max(of_link, key=_others, default=port)
        if not _others(crowded):
            return None
        return crowded, min((s for s in crowded.heard if s not in crowded.vehicles), key=crowded.heard.__getitem__)

    def became_crowded(self, link: str, now: float) -> bool:
        """There was no room for a source of this link. Returns whether to report it."""
        if link in self.crowded or now - self._reported_at.get(link, float("-inf")) < CROWDED_QUIET_S:
            return False
        self._reported_at[link] = now
        self.crowded.add(link)
        return True

    def became_ample(self, ports: Iterable[Port]) -> list[str]:
        """Links that are no longer crowded, each once."""
        full = {p.policy.link for p in ports if len(p.heard) > AMPLE_SHARE * MAX_CHANNEL_ROUTES}
        full |= {link for link, number in self._of_link.items() if number > AMPLE_SHARE * MAX_LINK_ROUTES}
        over = sorted(self.crowded - full)
        self.crowded -= set(over)
        return over

    def may_note(self, link: str, now: float) -> bool:
        """True if one more learned or expired route of this link may be reported; counts it then."""
        left, as_of = self._notes.get(link, (float(ROUTE_NOTES), now))
        left = min(float(ROUTE_NOTES), left + (now - as_of) * ROUTE_NOTES_PER_S)
        self._notes[link] = (left - 1.0 if left >= 1.0 else left), now
        return left >= 1.0


def _others(port: Port) -> int:
    """Sources of a channel that are not autopilots."""
    return len(port.heard) - len(port.vehicles)


class RoutingTable:
    """Routes by channel, by source (sysid<<8|compid) and by system. The router reads them for every frame; what
    changes them is here."""

    def __init__(self) -> None:
        self.ports: dict[int, Port] = {}
        self.by_source: dict[int, list[Port]] = {}
        self.by_system: dict[int, list[Port]] = {}
        self.heard_directly: set[int] = set()
        """Autopilots heard on their own links: from a ground station or a recording their frames are echoes."""
        self.room = RouteRoom()
        self.notes: deque[RouteNote] = deque(maxlen=MAX_NOTES)
        self.unreported_routes = 0
        """Routes learned or expired that were not reported."""
        self.on_change: Callable[[], None] = lambda: None
        """Called whenever a cached decision may have become wrong."""
        self.through_station: Callable[[int], bool] = lambda source: False
        """True if this vehicle's state comes through a ground station."""
        self.may_fly: Callable[[int], bool] = lambda source: False
        """True if this is a vehicle that may be in the air: its last route stays."""

    # -- channels and vehicles

    def close(self, port: Port) -> None:
        """The channel is gone, and all its routes with it."""
        del self.ports[port.id]
        for source in list(port.heard):
            self.forget(port, source)

    def topology_changed(self, source: int | None = None) -> None:
        """Note that what a channel may send has changed: because of this source, or (None) because a channel came or
        went."""
        self.on_change()
        for port in self.ports.values():
            port.broadcast.clear()
        if source is not None:  # the others are as they were: a flood of sources costs each only its own
            if self._is_heard_directly(source):
                self.heard_directly.add(source)
            else:
                self.heard_directly.discard(source)
            return
        vehicles = {source for port in self.ports.values() for source in port.vehicles}
        self.heard_directly.clear()
        self.heard_directly.update(filter(self._is_heard_directly, vehicles))

    def _is_heard_directly(self, source: int) -> bool:
        """True if a vehicle is heard over a channel of its own, not only through a ground station or in a recording."""
        if not any(
            source in port.vehicles and port.policy.role != "gcs" and not port.policy.replayed
            for port in self.by_source.get(source, ())
        ):
            return False
        return not self.through_station(source)

    def is_station(self, channel_id: int | None) -> bool:
        """True if this is the channel of a ground station."""
        port = self.ports.get(channel_id or 0)
        return port is not None and port.policy.role == "gcs"

    # -- learning and forgetting

    def learn(self, port: Port, source: int, frame: Frame, now: float) -> None:
        """A new route, if there is room for it."""
        if not self.room.is_free(port) and not self._make_room(port, source, frame, now):
            return
        port.heard[source] = now
        port.of_system.setdefault(source >> 8, set()).add(source)
        self.room.added(port)
        ports = self.by_source.setdefault(source, [])
        if ports:
            self.on_change()
        ports.append(port)
        systems = self.by_system.setdefault(source >> 8, [])
        if port not in systems:
            systems.append(port)
        self._note_route("learned", source, port, now)

    def _make_room(self, port: Port, source: int, frame: Frame, now: float) -> bool:
        """True if a new source may be kept on a full channel: an autopilot may, if another source can be removed."""
        if self.room.became_crowded(port.policy.link, now):
            self.note("crowded", source, port)
        place = None
        if frame.msgid == HEARTBEAT and discovers(frame):
            place = self.room.gives_way(port, self.ports.values())
        if place is None:
            self.room.refused += 1
            port.routes_refused += 1
            return False
        crowded, silent = place
        self.room.evicted += 1
        crowded.routes_evicted += 1
        self.forget(crowded, silent)
        return True

    def forget(self, port: Port, source: int) -> None:
        """Remove a route."""
        self.on_change()
        del port.heard[source]
        port.boot_ms.pop(source, None)
        self.room.removed(port)
        _remove(self.by_source, source, port)
        system = source >> 8
        port.of_system[system].discard(source)
        if not port.of_system[system]:
            del port.of_system[system]
            _remove(self.by_system, system, port)
        if source in port.vehicles:
            port.vehicles.discard(source)
            self.topology_changed(source)

    def drop_echo_routes(self, source: int) -> None:
        """Drop routes through ground stations and recordings, by which a vehicle may have been heard first."""
        if source not in self.heard_directly:
            return
        for port in self.ports.values():
            if source in port.heard and (port.policy.role == "gcs" or port.policy.replayed):
                self.forget(port, source)

    def expire(self, before: float, now: float) -> None:
        """Forget routes that were not heard since ``before``, but not the last way to a vehicle that may fly."""
        for port in self.ports.values():
            for source in [s for s, at in port.heard.items() if at < before and not self.last_to_flying(port, s)]:
                self.forget(port, source)
                self._note_route("expired", source, port, now)
        if self.room.crowded:
            for link in self.room.became_ample(self.ports.values()):
                for port in [p for p in self.ports.values() if p.policy.link == link][:1]:
                    self.note("crowded_over", 0, port)

    # -- reports

    def _note_route(self, kind: str, source: int, port: Port, now: float) -> None:
        """Report a route that came or went, up to the link's rate of such reports."""
        if self.room.may_note(port.policy.link, now):
            self.note(kind, source, port)
        else:
            self.unreported_routes += 1

    def note_problem(self, kind: str, source: int, port: Port, now: float, target: int = 0) -> None:
        """The same for problems, with a rate of their own: a flood of learned routes hides none."""
        if self.room.may_note(f"{port.policy.link}: wrong", now):
            self.note(kind, source, port, target)

    def note(self, kind: str, source: int, port: Port, target: int = 0) -> None:
        """Report something without a limit of its rate."""
        self.notes.append(RouteNote(kind, source >> 8, source & 0xFF, port.id, target))

    # -- questions

    def last_to_flying(self, port: Port, source: int) -> bool:
        """True if no other channel has heard this source later, and it may be in the air."""
        if source not in port.vehicles or not self.may_fly(source):
            return False
        return all(p.heard[source] <= port.heard.get(source, -math.inf) for p in self.by_source.get(source, ()))

    def leads_to_flying(self, channel_id: int) -> bool:
        """True if this is the last way to a vehicle that may be in the air."""
        port = self.ports.get(channel_id)
        return port is not None and any(self.last_to_flying(port, source) for source in port.vehicles)

    def autopilots_on(self, channel_id: int) -> Collection[int]:
        """The autopilots (sysid<<8|compid) that are heard on a channel."""
        port = self.ports.get(channel_id)
        return () if port is None else port.vehicles

    def hears(self, channel_id: int, system: int) -> bool:
        """True if there is a route to this system over this channel."""
        port = self.ports.get(channel_id)
        return port is not None and system in port.of_system

    def routes(self) -> list[tuple[int, int, int, float]]:
        """(sysid, compid, channel id, last heard at), sorted."""
        rows = [(s >> 8, s & 0xFF, p.id, at) for p in self.ports.values() for s, at in p.heard.items()]
        return sorted(rows)


def _remove(table: dict[int, list[Port]], key: int, port: Port) -> None:
    ports = table[key]
    ports.remove(port)
    if not ports:
        del table[key]
