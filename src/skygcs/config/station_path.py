"""Where the station socket of a bridge is: beside the daemon's. Lean: every command of skygcs-cli imports it."""

from __future__ import annotations

STATION_SUFFIX = ".federation"


def station_socket(address: str) -> str:
    """The path of the station socket, for that of the daemon's socket or its own."""
    return address if address.endswith(STATION_SUFFIX) else address + STATION_SUFFIX
