"""A TCP proxy between a station and its hub that knows where messages begin and end, and fails on command.

It can stop for a while (what was sent arrives afterwards), close its connections, delay everything, and double or
reorder single messages, which a TCP connection alone never does.
"""

from __future__ import annotations

import asyncio
import random
from typing import Self

from support.memory_hub import Faults

PAYLOAD_OPS = (b"PUB ", b"HPUB ", b"MSG ", b"HMSG ")
"""Their last word is the length of what follows the line. https://docs.nats.io/reference/reference-protocols/nats-protocol"""

LATE_S = 2.0
"""A reordered or doubled message is late by up to so much."""


class HubProxy:
    """Listens on a free port of loopback, on behalf of the hub at ``port``."""

    def __init__(self, port: int, seed: int) -> None:
        self.faults = Faults(delay_s=0.0)
        self.url = ""
        self._hub_port = port
        self._rng = random.Random(seed)
        self._server: asyncio.Server | None = None
        self._cut_until = 0.0
        self._writers: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._on_client, "127.0.0.1", 0)
        self.url = f"nats://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        self.reset()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def cut(self, seconds: float) -> None:
        """Nothing passes for so long."""
        self._cut_until = max(self._cut_until, asyncio.get_running_loop().time() + seconds)

    def cut_left_s(self) -> float:
        """How long it is still cut."""
        return max(0.0, self._cut_until - asyncio.get_running_loop().time())

    def reset(self) -> None:
        """Close all connections, with what is on its way."""
        for writer in self._writers:
            writer.transport.abort()

    async def _on_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        to_hub: asyncio.StreamWriter | None = None
        try:
            await self._wait_for_cut()
            from_hub, to_hub = await asyncio.open_connection("127.0.0.1", self._hub_port)
            self._writers.add(to_hub)
            ways = ((reader, to_hub), (from_hub, writer))
            tasks = [asyncio.create_task(self._pass_on(*way), name="proxy") for way in ways]
            self._tasks.update(tasks)
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._tasks.difference_update(tasks)
        except OSError:
            pass  # no hub: the client sees that its connection ends
        finally:
            for open_ in (writer, to_hub):
                if open_ is not None:
                    self._writers.discard(open_)
                    open_.transport.abort()

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        loop, rng = asyncio.get_running_loop(), self._rng
        late: list[asyncio.TimerHandle] = []
        try:
            while message := await self._message(reader):
                await self._wait_for_cut()
                if self.faults.delay_s:
                    await asyncio.sleep(self.faults.delay_s * rng.random())
                copies = 1
                if message.startswith(PAYLOAD_OPS):
                    copies += rng.random() < self.faults.double
                    if rng.random() < self.faults.reorder:
                        copies -= 1
                        late.append(loop.call_later(rng.random() * LATE_S, self._late, writer, message))
                for number in range(copies):
                    if number:
                        late.append(loop.call_later(rng.random() * LATE_S, self._late, writer, message))
                    else:
                        writer.write(message)
                await writer.drain()
                late = [timer for timer in late if timer.when() > loop.time()]
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass
        finally:
            for timer in late:
                timer.cancel()

    def _late(self, writer: asyncio.StreamWriter, message: bytes) -> None:
        left_s = self._cut_until - asyncio.get_running_loop().time()
        if left_s > 0.0:
            asyncio.get_running_loop().call_later(left_s, self._late, writer, message)
        elif not writer.is_closing():
            writer.write(message)

    async def _message(self, reader: asyncio.StreamReader) -> bytes:
        """One line, with its payload; b"" at the end. Raises asyncio.IncompleteReadError."""
        line = await reader.readuntil(b"\r\n")
        if not line.startswith(PAYLOAD_OPS):
            return line
        return line + await reader.readexactly(int(line.split()[-1]) + 2)

    async def _wait_for_cut(self) -> None:
        left_s = self._cut_until - asyncio.get_running_loop().time()
        if left_s > 0.0:
            await asyncio.sleep(left_s)
            await self._wait_for_cut()
