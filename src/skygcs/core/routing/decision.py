"""The router's answers: the verdict on a frame, its destinations, and changes of the table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


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
