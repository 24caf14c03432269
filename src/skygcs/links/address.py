"""Internet addresses: names to socket addresses and back."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

from skygcs.errors import LinkError

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
