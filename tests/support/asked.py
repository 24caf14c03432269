"""A whole daemon in a loop of virtual time that is a test's own, asked through a real session without a socket."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
from collections.abc import AsyncIterator, Iterator, Mapping
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.daemon import Daemon
from skygcs.rpc.dispatch import Dispatcher
from skygcs.rpc.sessions import Session, Sessions
from support.daemons import made_daemon, memory_link, started
from support.extension_parts import ON_DEMAND, PLAIN_METHODS
from support.hosts import until
from support.pymav import PymavPeer
from support.virtual_asyncio import VirtualAsyncio


class _Transport(asyncio.Transport):
    """Where a session writes."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[Any] = []
        self._rest = b""

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None: ...
    def get_write_buffer_size(self) -> int:
        return 0

    def is_reading(self) -> bool:
        return True

    def is_closing(self) -> bool:
        return False

    def pause_reading(self) -> None: ...
    def close(self) -> None: ...
    def abort(self) -> None: ...

    def write(self, data: Any) -> None:
        *lines, self._rest = (self._rest + bytes(data)).split(b"\n")
        self.lines += [json.loads(line) for line in lines]


class Asked:
    """``complaints``: of the event loop, which nobody may ever have."""

    def __init__(self, daemon: Daemon) -> None:
        self.daemon = daemon
        self.complaints: list[dict[str, Any]] = []
        self.events: list[dict[str, Any]] = []
        self.vehicle = PymavPeer(1, 1)
        daemon.loop.set_exception_handler(lambda _, context: self.complaints.append(context))
        daemon.event_log.subscribe(self.events.append)
        for word in ON_DEMAND:
            daemon.extensions.demand(word)
        self._sessions = Sessions(daemon, Dispatcher(PLAIN_METHODS), daemon.loop)
        self._transport = _Transport()
        self._session = Session(self._sessions, None)
        self._session.connection_made(self._transport)
        self._next = 0

    def ask(self, method: str, params: Any) -> int:
        """The number of the request."""
        self._next += 1
        request = {"jsonrpc": "2.0", "id": self._next, "method": method, "params": params}
        self._session.data_received(json.dumps(request).encode() + b"\n")
        return self._next

    def answer(self, number: int) -> Any:
        """The whole reply; None: it has not come yet."""
        return next((line for line in self._transport.lines if line.get("id") == number), None)

    async def reply(self, method: str, params: Any) -> Any:
        """The whole reply to a request that is answered soon."""
        number = self.ask(method, params)
        await until(lambda: self.answer(number) is not None)
        return self.answer(number)

    @property
    def notices(self) -> list[Any]:
        return [line for line in self._transport.lines if "id" not in line]

    def unanswered(self) -> int:
        return self._next - sum("id" in line for line in self._transport.lines)

    def internal_errors(self) -> list[Any]:
        return [line for line in self._transport.lines if line.get("error", {}).get("code") == -32603]

    def faults(self) -> list[str]:
        return [e["text"] for e in self.events if e["kind"] == "fault"]

    def send(self, data: bytes) -> None:
        """From the vehicle's end of the link."""
        link = memory_link(self.daemon, "air")
        link.peer.send(data)

    def beat(self, *, armed: bool = False) -> None:
        position = mav.MAVLink_global_position_int_message(1000, 437806000, -794653000, 180000, 0, 0, 0, 0, 0)
        self.send(self.vehicle.heartbeat(armed=armed) + self.vehicle.pack(position))

    async def live(self, seconds: float) -> None:
        """Time passes; the vehicle beats."""
        for _ in range(round(seconds * 2)):
            self.beat()
            await asyncio.sleep(0.5)

    async def close(self) -> None:
        await self._sessions.close()


@contextlib.asynccontextmanager
async def asked(folder: Path, **tables: Mapping[str, Any]) -> AsyncIterator[Asked]:
    """A daemon with one ArduCopter that answers nothing. ``tables`` of the fleet file."""
    links = {"air": {"type": "memory"}, **tables.pop("links", {})}
    async with started(made_daemon(folder, links=links, **tables)) as daemon:
        gcs = Asked(daemon)
        await gcs.live(1.0)
        yield gcs
        await gcs.close()


def virtual_loop() -> asyncio.AbstractEventLoop:
    """For asyncio.Runner: of virtual time."""
    return VirtualAsyncio()


def resolved(schema: Mapping[str, Any], defs: Mapping[str, Any]) -> Mapping[str, Any]:
    """A JSON schema without a reference at its top."""
    while "$ref" in schema:
        schema = defs[str(schema["$ref"]).rpartition("/")[2]]
    return schema


def methods_with_numbers() -> Iterator[str]:
    """Methods with a number among their parameters."""
    for name, method in PLAIN_METHODS.items():
        if re.search(r"'(number|integer)'", str(method.params.model_json_schema())):
            yield name
