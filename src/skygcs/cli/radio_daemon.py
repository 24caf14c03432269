"""What a running daemon has to do with a radio's port: it lends it, and it knows who is armed."""

from __future__ import annotations

import contextlib
import os
from collections.abc import AsyncIterator, Sequence
from typing import Any

import typer

from skygcs.cli.connection import client, fail
from skygcs.errors import DaemonUnreachable, RefusedError, RpcError
from skygcs.rpc.client import Client

AIRBORNE = frozenset({"in_air", "takeoff", "landing"})
"""Values of a vehicle's `landed`."""


@contextlib.asynccontextmanager
async def lent(devices: Sequence[str], *, changes: bool, force: bool) -> AsyncIterator[None]:
    """The daemon keeps off these ports for the time of the body, if one runs and has them open.

    Raises RefusedError while a vehicle of it is armed, unless forced: where it would lose the radio, and where a radio
    is to be changed (another one on the fleet's network id would break in).
    """
    async with contextlib.AsyncExitStack() as stack:
        try:
            gcs = await stack.enter_async_context(client())
        except DaemonUnreachable:
            gcs = None
        links = [] if gcs is None else await _links_on(gcs, devices)
        if gcs is not None and (links or changes):
            await _refuse_while_armed(gcs, links, force)
        for link in links:
            assert gcs is not None
            await gcs.call("links.change", name=link, link={"enabled": False})
            stack.push_async_callback(_reopen, gcs, link)
            typer.echo(f"link {link}: closed in the daemon meanwhile", err=True)
        yield


async def _links_on(gcs: Client, devices: Sequence[str]) -> list[str]:
    return _on_ports(await gcs.call("links.list"), devices)


def _on_ports(rows: Sequence[dict[str, Any]], devices: Sequence[str]) -> list[str]:
    """Links that have one of these devices open, by whatever name either calls it."""
    wanted = {os.path.realpath(device) for device in devices}
    return [
        row["name"]
        for row in rows
        if row["type"] == "serial" and any(os.path.realpath(c["peer"]) in wanted for c in row["channels"])
    ]


async def _refuse_while_armed(gcs: Client, links: Sequence[str], force: bool) -> None:
    """A vehicle that is lost may be flying: the last that was heard of it counts."""
    vehicles = await gcs.call("vehicles.list")
    armed = [v["name"] for v in vehicles if v["armed"] or v["duplicate_sysid"] or v["landed"] in AIRBORNE]
    if not armed or force:
        return
    what = f"link {', '.join(links)} would be closed" if links else "a radio on its network could break in"
    raise RefusedError(
        f"{', '.join(armed)} {'is' if len(armed) == 1 else 'are'} armed, and {what}; land and disarm first "
        "(--force: all the same)"
    )


async def _reopen(gcs: Client, link: str) -> None:
    try:
        await gcs.call("links.change", name=link, link={"enabled": True})
    except RpcError as error:
        fail(f"link {link} stays closed in the daemon ({error}); open it: skygcs-cli links change {link} enabled=true")
        return
    typer.echo(f"link {link}: open again", err=True)
