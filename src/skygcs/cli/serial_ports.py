"""Serial ports of commands: the daemon lends those of its links, and what to do about one that cannot be opened."""

from __future__ import annotations

import contextlib
import errno
import os
import termios
from collections.abc import AsyncIterator, Sequence
from typing import Any

from skygcs.cli.connection import client, fail
from skygcs.cli.render import say
from skygcs.errors import DaemonUnreachable, RefusedError, RpcError
from skygcs.rpc.client import Client

AIRBORNE = frozenset({"in_air", "takeoff", "landing"})
"""Values of a vehicle's `landed`."""

_BAUD = {
    getattr(termios, f"B{rate}"): rate
    for rate in (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 1000000)
    if hasattr(termios, f"B{rate}")
}


@contextlib.asynccontextmanager
async def lent(devices: Sequence[str], *, changes: bool, force: bool) -> AsyncIterator[None]:
    """Close the daemon's links at these ports while the body runs, if a daemon runs and has them open.

    Raises RefusedError while one of its vehicles is armed, unless ``force``, in two cases: the vehicle would lose its
    link, or a radio is changed (a second radio with the fleet's network id could disturb the link).
    """
    async with contextlib.AsyncExitStack() as stack:
        try:
            gcs = await stack.enter_async_context(client())
        except DaemonUnreachable:
            gcs = None
        links = [] if gcs is None else _on_ports(await gcs.call("links.list"), devices)
        if gcs is not None and (links or changes):
            await _refuse_while_armed(gcs, links, force)
        for link in links:
            assert gcs is not None
            await gcs.call("links.change", name=link, link={"enabled": False})
            stack.push_async_callback(_reopen, gcs, link)
            say(f"link {link}: closed in the daemon for now", err=True)
        yield


def _on_ports(rows: Sequence[dict[str, Any]], devices: Sequence[str]) -> list[str]:
    """Links that have one of these devices open; symlinks are resolved."""
    wanted = {os.path.realpath(device) for device in devices}
    return [
        row["name"]
        for row in rows
        if (row["type"] == "serial" and any(os.path.realpath(c["peer"]) in wanted for c in row["channels"]))
        or (row["type"] == "xbee" and row["state"] == "up" and os.path.realpath(row["device"]) in wanted)
    ]


async def _refuse_while_armed(gcs: Client, links: Sequence[str], force: bool) -> None:
    """A vehicle that is lost may be flying: its last known state counts."""
    vehicles = await gcs.call("vehicles.list")
    armed = [v["name"] for v in vehicles if v["armed"] or v["duplicate_sysid"] or v["landed"] in AIRBORNE]
    if not armed or force:
        return
    what = f"link {', '.join(links)} would be closed" if links else "a changed radio could disturb its network"
    raise RefusedError(
        f"{', '.join(armed)} {'is' if len(armed) == 1 else 'are'} armed, and {what}; land and disarm first "
        "(--force: without this check)"
    )


async def _reopen(gcs: Client, link: str) -> None:
    try:
        await gcs.call("links.change", name=link, link={"enabled": True})
    except RpcError as error:
        fail(f"link {link} stays closed in the daemon ({error}); open it: skygcs-cli links change {link} enabled=true")
        return
    say(f"link {link}: open again", err=True)


def explain(error: Exception) -> str:
    """Return what to do about a port that cannot be opened, or failed."""
    code = error.errno if isinstance(error, OSError) else error.args[0] if isinstance(error, termios.error) else None
    match code:
        case errno.ENOENT | errno.ENODEV | errno.ENXIO:
            return "no such device; plug it in, or correct the name (ls -l /dev/serial/by-id)"
        case errno.EACCES | errno.EPERM:
            return "permission denied; add yourself to the group that owns it (ls -l shows it; usually dialout)"
        case errno.EAGAIN | errno.EBUSY:
            return "in use by another program; stop that one first (fuser -v shows it)"
        case errno.ENOTTY | errno.EISDIR:
            return "not a serial port"
        case errno.EIO:
            return "the port disappeared: the radio was unplugged, or lost its power"
    if "Inappropriate ioctl" in str(error) or "Could not configure" in str(error):
        return "not a serial port"
    return str(error)


def port_rate(descriptor: int) -> int:
    """The rate that was set at a pty; 0 for a rate that no radio has."""
    return _BAUD.get(termios.tcgetattr(descriptor)[5], 0)


def set_port_rate(descriptor: int, baud: int) -> None:
    """Set the initial rate of a pty."""
    attributes = termios.tcgetattr(descriptor)
    code = next(code for code, rate in _BAUD.items() if rate == baud)
    attributes[4] = attributes[5] = code
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
