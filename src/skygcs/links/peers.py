"""Peers of UDP and TCP links: their addresses (names to socket addresses and back), and their admission to a server, by
the networks of `allow_from` and by the number of peers.

Reports are bounded: a few addresses that are not allowed, and each change between full and not full.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any

from skygcs.core.routing.peer_places import Peer, PeerPlaces
from skygcs.errors import LinkError
from skygcs.events import Event
from skygcs.links.base import Link

# --- addresses --------------------------------------------------------------------------------------------------------

Address = tuple[Any, ...]
"""Address in the form of the socket module: (host, port) for IPv4, (host, port, flow, scope) for IPv6."""

_IPV4_MAPPED = "::ffff:"


async def resolve(
    loop: asyncio.AbstractEventLoop, host: str, port: int, kind: socket.SocketKind
) -> list[tuple[int, Address]]:
    """(family, address) of a numeric address or a name, IPv4 first. Raises LinkError. Never blocks the loop.

    IPv4 first because autopilots, radios and companions listen on 0.0.0.0, and UDP does not report that no program
    listens on ::1 when "localhost" names both.
    """
    try:
        # no look-up: does not block. As bytes: for a text Python imports the tables of international names, 0.5 MB
        found = socket.getaddrinfo(host.encode("ascii"), port, type=kind, flags=socket.AI_NUMERICHOST)
    except (OSError, UnicodeError):
        try:
            found = await loop.getaddrinfo(host, port, type=kind)
        except (OSError, UnicodeError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise LinkError(f"{host}: the name has no address ({reason.lower()}); check spelling and network") from None
    return sorted(((info[0], info[4]) for info in found), key=lambda item: item[0] != socket.AF_INET)


def format_address(address: Address) -> str:
    """ "192.168.1.7:14550" or "[fe80::1%2]:14550"; an IPv4 peer of an IPv6 socket is shown as IPv4."""
    host, port = format_host(address), address[1]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def format_host(address: Address) -> str:
    """The address without its port; an IPv4 peer of an IPv6 socket is shown as IPv4."""
    return str(address[0]).removeprefix(_IPV4_MAPPED)


# --- admission --------------------------------------------------------------------------------------------------------


MAX_REMEMBERED = 1024
"""Addresses whose result is cached; above it the cache is cleared."""

MAX_REPORTED = 8
"""Addresses of one link that are reported as not allowed, each once; counted are all."""

AMPLE_SHARE = 0.9
FULL_QUIET_S = 10.0
"""A server that was full counts as such until no more of its places are taken than this, and is reported no more often
than that: no event per peer, nor per client that connects and goes."""


class AllowedNetworks:
    """``allow_from``: whether an address lies in one of the networks; without any, all do."""

    def __init__(self, networks: Sequence[str] | None) -> None:
        self._networks = None if networks is None else [ipaddress.ip_network(text) for text in networks]
        self._remembered: dict[str, bool] = {}

    def __contains__(self, host: str) -> bool:
        if self._networks is None:
            return True
        allowed = self._remembered.get(host)
        if allowed is None:
            if len(self._remembered) >= MAX_REMEMBERED:
                self._remembered.clear()
            allowed = self._remembered[host] = self._lies_in_one(host)
        return allowed

    def _lies_in_one(self, host: str) -> bool:
        assert self._networks is not None
        try:
            address = ipaddress.ip_address(host.partition("%")[0])
        except ValueError:
            return False
        return any(address in network for network in self._networks)


class Admission:
    """Decides about newcomers to one server link, counts and reports."""

    def __init__(
        self, link: Link, places: int, networks: Sequence[str] | None, peers: Callable[[], Iterable[Peer]]
    ) -> None:
        self.places = PeerPlaces(places, peers)
        self.not_allowed = 0
        """Datagrams or connections from addresses that ``allow_from`` does not name."""
        self.refused = 0
        """The same for peers that found no place."""
        self.put_out = 0
        """Peers that were replaced by others."""
        self._link = link
        self._networks = AllowedNetworks(networks)
        self._reported: set[str] = set()
        self._full = False
        self._reported_at = float("-inf")

    def allows(self, address: Address) -> bool:
        """True if ``allow_from`` allows this address. Call it before anything from it is parsed."""
        host = format_host(address)
        if host in self._networks:
            return True
        self.not_allowed += 1
        if host not in self._reported and len(self._reported) < MAX_REPORTED:
            self._reported.add(host)
            self._report(
                f"{format_address(address)} is not in allow_from: dropped, as all that comes from {host}",
                {"change": "not_allowed", "address": host},
            )
        return False

    def place_for(self, address: Address, *, autopilot: bool, now: float) -> tuple[bool, Hashable]:
        """Return whether this newcomer gets a place although all are taken, and which peer has to go for it first."""
        judgement = self.places.judge(format_host(address), autopilot=autopilot, now=now)
        if not judgement.admitted:
            self.refused += 1
        elif judgement.put_out is not None:
            self.put_out += 1
        quiet = now - self._reported_at < FULL_QUIET_S
        if not (self._full or quiet) and (judgement.put_out is not None or not judgement.admitted):
            self._full = True
            self._reported_at = now
            became = "took the place of another" if judgement.admitted else "was refused"
            self._report(
                f"all {self.places.places} places are taken: {format_address(address)} {became}; a silent peer "
                "without an autopilot is replaced first, an autopilot that is heard never; allow_from keeps "
                "strangers out",
                {"change": "full", "address": format_host(address), "places": self.places.places},
            )
        return judgement

    def left(self, number: int) -> None:
        """A peer has gone; so many are there now."""
        self.places.changed()
        if self._full and number <= AMPLE_SHARE * self.places.places:
            self._full = False
            self._report("there are free places again", {"change": "not_full"})

    def _report(self, text: str, data: dict[str, object]) -> None:
        name = self._link.name
        self._link.host.on_event(Event("warning", None, None, f"links.{name}: {text}", {"link": name, **data}))
