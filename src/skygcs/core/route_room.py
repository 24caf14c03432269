"""Room in the routing table: what a flood of forged sources may take, and what it may not.

Sources come from outside, and anybody can write any of 65,000 of them into frames. So that one channel cannot starve
another:

    a channel                   keeps at most MAX_CHANNEL_ROUTES sources
    all channels of a link      keep at most MAX_LINK_ROUTES together; KEPT_ROUTES of each channel are its own
    a link                      takes no room from another link; the number of links is the operator's
    a full channel or link      refuses further sources, and keeps the earlier ones until they are silent
    an autopilot's heartbeat    takes the place of the source that was silent for longest, of its own channel if that is
                                full, else of the channel of its link that has most; never of another autopilot
"""

from __future__ import annotations

from collections.abc import Iterable

from skygcs.core.route_port import Port

MAX_CHANNEL_ROUTES = 1024
"""250 vehicles on one radio with four components each: autopilot, camera, gimbal, companion."""

MAX_LINK_ROUTES = 4096
"""Four such channels; some 1.5 MB."""

KEPT_ROUTES = 16
"""Of each channel, whatever its link's others take: an autopilot and all that is on board of one vehicle."""

AMPLE_SHARE = 0.9
"""A channel that was full counts as such until it, and its link, are no fuller than this: no event per source."""


class RouteRoom:
    """Counts the routes of each link, and says which route gives way to a new one."""

    __slots__ = ("_of_link", "evicted", "refused")

    def __init__(self) -> None:
        self._of_link: dict[str, int] = {}
        self.refused = 0
        """Frames of sources that found no room."""
        self.evicted = 0
        """Sources that gave way to an autopilot."""

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
        """Whether this channel may keep one more source."""
        known = len(port.heard)
        if known >= MAX_CHANNEL_ROUTES:
            return False
        return known < KEPT_ROUTES or self._of_link.get(port.policy.link, 0) < MAX_LINK_ROUTES

    def gives_way(self, port: Port, ports: Iterable[Port]) -> tuple[Port, int] | None:
        """Channel and source that an autopilot, new on ``port``, takes the place of; None: nothing gives way."""
        if len(port.heard) >= MAX_CHANNEL_ROUTES:
            crowded = port
        else:
            of_link = [p for p in ports if p.policy.link == port.policy.link]
            crowded = max(of_link, key=_others, default=port)
        if not _others(crowded):
            return None
        return crowded, min((s for s in crowded.heard if s not in crowded.vehicles), key=crowded.heard.__getitem__)

    def is_ample(self, port: Port) -> bool:
        """Whether a channel that was full is so no longer."""
        in_link = self._of_link.get(port.policy.link, 0)
        return len(port.heard) <= AMPLE_SHARE * MAX_CHANNEL_ROUTES and in_link <= AMPLE_SHARE * MAX_LINK_ROUTES


def _others(port: Port) -> int:
    """Sources of a channel that are no autopilots."""
    return len(port.heard) - len(port.vehicles)
