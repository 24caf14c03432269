"""``HOST:PORT`` in files that a person writes."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator


def host_and_port(text: str) -> tuple[str, int]:
    """Host and port of ``HOST:PORT`` or ``[IPV6]:PORT``. Raises ValueError in a person's words."""
    host, colon, port = text.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    if not colon or not host or (":" in host and not bracketed):
        raise ValueError(f'"{text}" is not an address: write HOST:PORT, or [IPV6]:PORT')
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and 0 < int(port) < 65536):
        raise ValueError(f'"{text}": the port must be a number from 1 to 65535')
    return (host[1:-1] if bracketed else host), int(port)


def _checked(text: str) -> str:
    host_and_port(text)
    return text


HostAndPort = Annotated[str, AfterValidator(_checked)]
"""``HOST:PORT`` or ``[IPV6]:PORT``, as written."""
