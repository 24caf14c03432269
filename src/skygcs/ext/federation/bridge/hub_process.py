"""A nats-server of one's own as the hub: for try-outs (`skygcs federation up`) and tests. It ends with its parent.

A hub for the field is a service of its computer, with the configuration that `skygcs federation hub-config` prints.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import signal
import socket
import ssl
import subprocess
import sys
import time
from pathlib import Path

from nats.js.api import DiscardPolicy, StorageType, StreamConfig

from skygcs.config.files import write_whole
from skygcs.errors import BusError, ConfigError, SkygcsError
from skygcs.ext.federation.bridge.bus import Bus, BusOptions, store_errors
from skygcs.ext.federation.bridge.hub_config import LEASES, LOGS, hub_config
from skygcs.ext.federation.bridge.nkeys_files import StationKey, new_key, read_seed, write_new_seed
from skygcs.ext.federation.hub_inventory import HubInventory, HubUser
from skygcs.ext.federation.protocol.lease import TTL_S
from skygcs.ext.federation.server_program import find_server

START_WITHIN_S = 20.0
"""It opens its port after it has read its store."""

STOP_WITHIN_S = 5.0
LAST_LINES = 5
MAX_LOG_BYTES = 65536

KEEPER = "keeper"

MAX_LEASE_BYTES = 4096
"""Longest value of a lease in the store, with room for later keys (`ext.federation.protocol.lease.MAX_ENTRY_BYTES`)."""

LOGS_AGE_S = 3600.0
"""How long a part of a log stays in the hub's store: it is there only for its collection."""

PR_SET_PDEATHSIG = 1
"""prctl(2): the signal that a child gets when its parent ends, also when that is killed."""


def with_public_keys(inventory: HubInventory, *, make: bool = False) -> HubInventory:
    """The inventory with the public key of each user that has a file with its seed. ``make``: files that are missing
    are made. Raises KeyFileError."""

    def known(user: HubUser) -> HubUser:
        path = user.nkey_file
        if path is None:
            return user
        if make and not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_new_seed(path)
        return user.model_copy(update={"nkey": read_seed(path).public_key})

    return inventory.model_copy(update={"users": {name: known(user) for name, user in inventory.users.items()}})


class HubProcess:
    """`wait` and `stop` block. The configuration is written into ``folder``, which the server can read."""

    def __init__(self, inventory: HubInventory, folder: Path) -> None:
        self.keeper = new_key()
        keeper = HubUser(role="keeper", nkey=self.keeper.public_key)
        users = {name: user for name, user in inventory.users.items() if user.role != "keeper"}
        self.inventory = inventory.model_copy(update={"users": {**users, KEEPER: keeper}})
        self.log = folder / "nats-server.log"
        self._file = folder / "nats-server.conf"
        self.text = hub_config(self.inventory)
        self._program = find_server()
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, from a thread that lives as long as it is to live. Call `wait` next. Raises OSError, and
        SkygcsError if another one listens there."""
        if _answers(self.inventory.local_host, self.inventory.port):
            raise SkygcsError(
                f"another nats-server listens on {self.inventory.listen} already: end it, or choose a port"
            )
        self.write()
        with self.log.open("wb") as log:
            line = [self._program, "--config", str(self._file)]
            self.process = subprocess.Popen(
                line, stdin=subprocess.DEVNULL, stdout=log, stderr=log, preexec_fn=_end_with_parent
            )

    def write(self) -> None:
        """Write the configuration. Raises OSError."""
        write_whole(self._file, self.text.encode(), 0o600)

    def wait(self) -> None:
        """Return when it takes connections. Raises SkygcsError with its last lines if it does not."""
        deadline = time.monotonic() + START_WITHIN_S
        while not _answers(self.inventory.local_host, self.inventory.port):
            if self.process is None or self.process.poll() is not None or time.monotonic() > deadline:
                self.kill()
                raise SkygcsError(f"nats-server on {self.inventory.listen} does not start: {self.last_lines()}")
            time.sleep(0.02)

    def last_lines(self) -> str:
        """The last lines of its log."""
        try:
            text = self.log.read_bytes()[-MAX_LOG_BYTES:].decode(errors="replace")
        except OSError as error:
            return error.strerror or str(error)
        return " | ".join(text.strip().splitlines()[-LAST_LINES:])

    def stop(self) -> None:
        """End it in order, or after STOP_WITHIN_S at once. Idempotent."""
        process = self.process
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(STOP_WITHIN_S)
        self.kill()

    def kill(self) -> None:
        """End it at once, as a power cut would. Idempotent."""
        process, self.process = self.process, None
        if process is not None:
            if process.poll() is None:
                process.kill()
            process.wait()


def _end_with_parent() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    os.setpgid(0, 0)  # Ctrl-C is for the parent, which ends it in order


def _answers(host: str, port: int) -> bool:
    """True if a nats-server sends its first line there, which it does after it has read its store."""
    with contextlib.suppress(OSError), socket.create_connection((host, port), timeout=1.0) as probe:
        return probe.recv(64).startswith(b"INFO ")
    return False


def own_tls(inventory: HubInventory) -> ssl.SSLContext | None:
    """TLS context for a client on the hub's own computer, which trusts the hub's certificate and no other; None without
    TLS. Raises ConfigError."""
    tls = inventory.tls
    if tls is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False  # it may have no name for the address that it is reached at here
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    try:
        context.load_verify_locations(tls.cert)
        if tls.ca is not None:
            context.load_cert_chain(tls.cert, tls.key)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError("tls", [f"{tls.cert}, {tls.key}: {error.strerror or error}"]) from None
    return context


async def make_stores(url: str, key: StationKey, tls: ssl.SSLContext | None = None) -> None:
    """Make the hub's stores of leases and logs, if they are not there. Raises BusError."""
    options = BusOptions((url,), key.seed, key.public_key, tls, "skygcs keeper")
    bus = Bus(options, asyncio.get_running_loop(), lambda event: None)
    connected = asyncio.Event()
    bus.on_change(connected.set)
    running = asyncio.create_task(bus.run(), name="keeper")
    try:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(START_WITHIN_S):
                while not bus.connected:
                    connected.clear()
                    await connected.wait()
        if not bus.connected:
            raise BusError("", bus.text)
        for config in stores():
            with store_errors(str(config.name)):
                await bus.jetstream().add_stream(config)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def stores() -> list[StreamConfig]:
    """The streams behind the two stores, as nats-py and every other client of NATS names and reads them, without the
    direct gets, republishing and mirrors that would send a store's content to other subjects."""
    return [
        StreamConfig(
            name=f"KV_{LEASES}",
            subjects=[f"$KV.{LEASES}.>"],
            max_age=TTL_S,
            max_msgs_per_subject=1,
            max_msg_size=MAX_LEASE_BYTES,
            max_bytes=16 << 20,
            duplicate_window=TTL_S,
            storage=StorageType.FILE,
            discard=DiscardPolicy.NEW,
            allow_rollup_hdrs=True,
            deny_delete=True,
            allow_direct=False,
        ),
        StreamConfig(
            name=f"OBJ_{LOGS}",
            subjects=[f"$O.{LOGS}.C.>", f"$O.{LOGS}.M.>"],
            max_age=LOGS_AGE_S,
            max_bytes=400_000_000,
            storage=StorageType.FILE,
            discard=DiscardPolicy.OLD,
            allow_rollup_hdrs=True,
            allow_direct=False,
        ),
    ]
