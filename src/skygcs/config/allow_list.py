"""Which hosts and origins requests may name: exact lists, so that another site's page, or another name that leads to
this machine (DNS rebinding, 127.evil.com), reaches nothing. Pure."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass

from skygcs.config.web import LOOPBACK, address_problem
from skygcs.errors import RefusedError


@dataclass(frozen=True, slots=True)
class AllowList:
    """The exact values of Host and Origin that are accepted."""

    hosts: frozenset[str]
    origins: frozenset[str]

    def refusal(self, host: str | None, origin: str | None, *, websocket: bool, site: str | None = None) -> str | None:
        """Why a request is refused; None if it is not. ``site``: Sec-Fetch-Site. A WebSocket must have an origin."""
        if host is None or host not in self.hosts:
            return "this Host is not served here"
        if origin is None:
            if websocket:
                return "a WebSocket needs an Origin"
        elif origin not in self.origins:
            return "this Origin may not use it"
        if websocket and site not in (None, "same-origin"):
            return "another site may not use it"
        return None


def allow_list(address: str, port: int, names: Sequence[str], *, tls: bool) -> AllowList:
    """The list for a server at ``address``; ``names``: further host names that its certificate has."""
    own = ["127.0.0.1", "localhost", "[::1]"] if address in LOOPBACK else []
    if address not in LOOPBACK and not _is_wildcard(address):
        own.append(f"[{address}]" if ":" in address else address)
    scheme, default_port = ("https", 443) if tls else ("http", 80)
    hosts = {f"{name}:{port}" for name in (*own, *names)}
    if port == default_port:
        hosts |= {*own, *names}
    return AllowList(frozenset(hosts), frozenset(f"{scheme}://{host}" for host in hosts))


def check_address(address: str, names: Sequence[str], *, tls: bool) -> None:
    """Raise RefusedError where serving ``address`` would let others listen in, or nobody would be let in."""
    problem = address_problem(address, names, tls=tls)
    if problem is not None:
        raise RefusedError(f"web.host {problem}")


def _is_wildcard(address: str) -> bool:
    return ipaddress.ip_address(address).is_unspecified
