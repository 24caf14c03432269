"""Room in the routing table: limits on what a flood of forged sources can take.

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

from skygcs.core.routing.channel import Port

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
