"""A real nats-server as the hub of a test: a free port, a store and keys in a temporary folder, ended with the test."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from nats.aio.client import Client

from skygcs.events import Event
from skygcs.ext.federation.bridge.bus import Bus, BusOptions
from skygcs.ext.federation.bridge.hub_process import HubProcess, make_stores
from skygcs.ext.federation.bridge.nkeys_files import StationKey, new_key, read_seed, write_new_seed
from skygcs.ext.federation.hub_inventory import inventory_of
from support.hanging import HANG_S
from support.process import free_port

USERS: dict[str, dict[str, Any]] = {
    "north": {"role": "site", "orders": ["south"]},
    "south": {"role": "site", "orders": ["north"]},
    "east": {"role": "site"},
    "boss": {"role": "operator", "orders": ["*"]},
    "clerk": {"role": "operator", "orders": ["north"]},
    "visitor": {"role": "observer"},
    "stranger": {"role": "observer"},
}
"""Sites that may order each other and one that may order nobody; operators for all and for one; observers."""


class RawClient(Client):
    """``errors``: what the server said."""

    def __init__(self) -> None:
        super().__init__()
        self.errors: list[str] = []

    async def settled(self) -> None:
        """Everything that was published has been answered. `flush` alone asks before what is pending is written."""
        await until(lambda: self.pending_data_size == 0, "the server takes what is pending")
        await self.flush()


class Hub:
    """The server, and the keys of its users: ``folder/NAME.nk``."""

    def __init__(self, folder: Path, users: dict[str, dict[str, Any]] | None = None, **tables: Any) -> None:
        self.folder = folder
        self.users = dict(users or USERS)
        self.port = free_port(socket.SOCK_STREAM)
        self._tables = tables
        self._stores = 0
        self.keys: dict[str, StationKey] = {}
        for name in self.users:
            path = self.key_file(name)
            if not path.exists():
                write_new_seed(path)
            self.keys[name] = read_seed(path)
        self.witness = new_key()
        """Of a user that may do everything, which no inventory has: it sees what the others send."""
        self.process = self._process()

    @property
    def url(self) -> str:
        return f"{'tls' if 'tls' in self._tables else 'nats'}://127.0.0.1:{self.port}"

    def key_file(self, name: str) -> Path:
        """Of a user's seed, for federation.nkey."""
        return self.folder / f"{name}.nk"

    def _process(self) -> HubProcess:
        users = {name: {**user, "nkey": self.keys[name].public_key} for name, user in self.users.items()}
        store = str(self.folder / f"jetstream-{self._stores}")
        inventory = inventory_of(
            {"listen": f"127.0.0.1:{self.port}", "store": store, "users": users, **self._tables}, "test"
        )
        made = HubProcess(inventory, self.folder)
        witness = f'{{ nkey: "{self.witness.public_key}", permissions: {{ publish: ">", subscribe: ">" }} }}'
        made.text = made.text.replace("  users: [", f"  users: [\n    {witness}", 1)
        return made

    def rewrite(self) -> None:
        """Write the configuration of the users as they are now, for a reload."""
        process = self._process()
        process.keeper, process.process = self.process.keeper, self.process.process
        process.write()
        self.process = process

    async def start(self) -> None:
        """Start it, or again, with the store that it had."""
        self.process.start()
        try:
            await asyncio.to_thread(self.process.wait)
            await make_stores(self.url, self.process.keeper, self._keeper_tls())
        except BaseException:  # nobody stops what was never begun
            self.process.kill()
            raise

    def _keeper_tls(self) -> Any:
        from skygcs.ext.federation.bridge.hub_process import own_tls

        return own_tls(self.process.inventory)

    async def stop(self) -> None:
        await asyncio.to_thread(self.process.stop)

    def kill(self) -> None:
        """As a power cut."""
        self.process.kill()

    async def replace(self) -> None:
        """Another hub at the same address: it knows nothing of what was stored before."""
        self.process.kill()
        self.prepare_replacement()
        await self.start()

    def prepare_replacement(self) -> None:
        """The next server has another store."""
        self._stores += 1
        self.process = self._process()

    @contextlib.asynccontextmanager
    async def raw(self, key: StationKey, inbox: str | None = None) -> AsyncIterator[RawClient]:
        """A client of nats-py itself, with none of the program's own precautions."""
        client = RawClient()

        async def on_error(error: Exception) -> None:
            client.errors.append(str(error))

        await client.connect(
            servers=[self.url],
            error_cb=on_error,
            nkeys_seed_str=key.seed,
            allow_reconnect=False,
            inbox_prefix=inbox or f"_INBOX_{key.public_key}",
        )
        try:
            yield client
        finally:
            await client.close()

    @contextlib.asynccontextmanager
    async def bus(self, name: str, *, wait: bool = True, **options: Any) -> AsyncIterator[Bus]:
        """Connected as this user, unless not to ``wait``. ``bus.events`` has what it reported."""
        events: list[Event] = []
        key = self.keys[name]
        made = {"servers": (self.url,), "seed": key.seed, "public_key": key.public_key, "name": name, **options}
        bus = Bus(BusOptions(**made), asyncio.get_running_loop(), events.append)
        bus.events = events  # type: ignore[attr-defined]
        task = asyncio.create_task(bus.run(), name=f"bus of {name}")
        try:
            if wait:
                await until(lambda: bus.connected, f"{name} is connected")
            yield bus
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


async def until(condition: Any, what: str, timeout_s: float = HANG_S) -> Any:
    """The condition's first true value; fails the test if there is none."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + timeout_s
    while loop.time() < deadline:
        if value := condition():
            return value
        await asyncio.sleep(0.01)
    raise AssertionError(f"never happened: {what}")
