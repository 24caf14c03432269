"""Which of the ground stations that mDNS has found a companion sends to. Pure.

    the present one                                     then
    ------------------------------------------------    ----------------------------------------
    is heard                                            it stays, whatever else is announced
    is silent for GROUND_SILENT_S, others are there     the next one, in the order of the names
    is silent, and there is no other                    it stays: it may come back
    is announced with another address, and is silent    its new address

A ground station may have several addresses, of which one is reachable from here: each counts as one of the others.
Nobody is authenticated by mDNS.
"""

from __future__ import annotations

import ipaddress
from typing import NamedTuple

GROUND_SILENT_S = 5.0
"""A ground station sends a heartbeat a second as soon as it has heard us."""

MAX_STATIONS = 16
MAX_ADDRESSES = 8
"""Most addresses of one station. Announcements beyond are counted and ignored: anyone in the network can make them."""


class Candidate(NamedTuple):
    """One address of one ground station."""

    name: str
    transport: str
    host: str
    port: int


class GroundChoice:
    """``only``: the name of the one station to follow; None: any."""

    def __init__(self, only: str | None = None) -> None:
        self.present: Candidate | None = None
        self.ignored = 0
        """Announcements that were not taken in."""
        self._only = only
        self._stations: dict[str, tuple[Candidate, ...]] = {}
        self._since = 0.0

    @property
    def candidates(self) -> list[Candidate]:
        """All addresses that are announced now."""
        return [candidate for name in sorted(self._stations) for candidate in self._stations[name]]

    def found(self, name: str, transport: str, hosts: list[str], port: int) -> None:
        """A station is announced, with these addresses."""
        usable = [host for host in hosts if _usable(host)][:MAX_ADDRESSES]
        full = len(self._stations) >= MAX_STATIONS and name not in self._stations
        wanted = self._only is None or name == self._only
        if not wanted or full or not usable or transport not in ("udp", "tcp") or not 0 < port < 65536:
            self.ignored += 1
            return
        self._stations[name] = tuple(Candidate(name, transport, host, port) for host in usable)

    def gone(self, name: str) -> None:
        """A station is announced no longer."""
        self._stations.pop(name, None)

    def decide(self, now: float, silent_s: float) -> Candidate | None:
        """The receiver from now on; None: no candidate is known. ``silent_s``: for how long the present one was not
        heard."""
        candidates = self.candidates
        if self.present is not None and min(silent_s, now - self._since) < GROUND_SILENT_S:
            return self.present
        if not candidates:
            return self.present
        if self.present in candidates:
            following = candidates[(candidates.index(self.present) + 1) % len(candidates)]
        else:
            following = candidates[0]
        if following != self.present:
            self.present, self._since = following, now
        return self.present


def _usable(host: str) -> bool:
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return False
    return not (address.is_unspecified or address.is_multicast)
