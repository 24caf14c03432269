"""Stations of a test in this process: the real bridge, a fake daemon with a real socket, and a real hub."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from skygcs.config.models import FleetConfig
from skygcs.ext.federation.bridge.metrics import ORDERS_TAKEN
from skygcs.ext.federation.bridge.process import ONE_BRIDGE, FederationOptions, FederationProcess
from skygcs.ext.federation.config import FederationConfig
from skygcs.ext.federation.extension import Federation
from skygcs.ext.federation.protocol.bridge_election import BridgeState
from skygcs.rpc.client import Client, connect
from skygcs.rpc.server import RpcServer
from support.fake_daemon import FakeDaemon
from support.hub import Hub, until


class Site:
    """A bridge, and what is behind it. ``socket``: of the station."""

    def __init__(self, process: FederationProcess, daemon: FakeDaemon | None, server: RpcServer | None) -> None:
        self.process = process
        self.daemon = daemon
        self.server = server
        self.socket = str(process.station.socket_path)

    def serves(self) -> bool:
        """True if it takes orders of other stations, or stands by for the bridge that does."""
        one, orders = (self.process.parts[name].status() for name in (ONE_BRIDGE, ORDERS_TAKEN))
        return bool(one["state"] == BridgeState.STANDBY or orders["daemon"]["connected"])

    @contextlib.asynccontextmanager
    async def client(self) -> AsyncIterator[Client]:
        async with connect(self.socket) as gcs:
            yield gcs


@contextlib.asynccontextmanager
async def site(
    hub: Hub, name: str, folder: Path, *, daemon: FakeDaemon | None = None, role: str = "site", **federation: Any
) -> AsyncIterator[Site]:
    """A running bridge of this user of the hub; with ``daemon`` behind its socket, or none. One with a daemon takes
    orders from the begin, if the hub is there."""
    table = {"servers": [hub.url], "nkey": str(hub.key_file(name)), "role": role, **federation}
    if role == "site":
        table["site"] = name
    joined = FederationConfig.model_validate(table)
    fleet = FleetConfig.model_validate({"daemon": {"log_dir": str(folder / f"logs-{name}")}})
    fleet = Federation.applied(joined, fleet.model_copy(update={"extensions": {"federation": joined}}))
    path = folder / f"{name}.sock"
    server = None if daemon is None else RpcServer(daemon, path)  # type: ignore[arg-type]
    if server is not None:
        await server.start()
    process = FederationProcess(fleet, FederationOptions(str(path), with_daemon=daemon is not None))
    ready = asyncio.Event()
    task = asyncio.create_task(process.run(lambda _: ready.set()), name=f"bridge of {name}")
    try:
        await ready.wait()
        await until(lambda: process.station.socket_path.exists() or task.done(), f"{name} serves its socket")
        found = Site(process, daemon, server)
        if daemon is not None and hub.process.process is not None:
            await until(lambda: found.serves() or task.done(), f"{name} takes orders")
        yield found
    finally:
        process.stop()
        await asyncio.gather(task)
        if server is not None:
            await server.close()
