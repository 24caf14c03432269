"""A daemon with a plain fleet file, in a process of its own: the files that it imports, and an order's way to the wire.

Prints JSON. ``files``: modules of skygcs that are imported when the daemon is ready; ``files_after_order``: after its
first order. ``calls``: functions of skygcs that wait for each other, or started each other's task, from the line of an
order on the socket to its frame at the link; ``call_files``: the files that they stand in.
"""

from __future__ import annotations

import asyncio
import json
import socket
import sys
import tempfile
from collections.abc import Coroutine
from pathlib import Path
from types import FrameType
from typing import Any

import structlog

import skygcs

FLEET = """
[daemon]
socket = "{folder}/s"
record = false

[links.air]
type = "udp_server"
host = "127.0.0.1"
port = {port}
role = "vehicle"

[vehicles.alpha]
sysid = 1

[vehicles.beta]
sysid = 2
"""

OURS = f"{Path(skygcs.__file__).parent}/"
"""Not every path with our name in it: that of a clone in a folder `skygcs` has it, too."""

TRIES = 5
"""Orders, until the frame of one was sent at once."""

Call = tuple[str, str]
"""File and function."""


def ours() -> list[str]:
    """The modules of skygcs that are imported."""
    return sorted(name for name in sys.modules if name.partition(".")[0] == "skygcs")


def calls_above(frame: FrameType | None) -> list[Call]:
    """The functions of skygcs that wait for this one, the outermost first."""
    found = []
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith(OURS):
            found.append((code.co_filename.removeprefix(OURS), code.co_qualname))
        frame = frame.f_back
    return found[::-1]


class Tracer:
    """Remembers which functions started each task, and the way of the first frame that is sent for a request while it
    is on; the daemon sends others of its own."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.on = False
        self.way: list[Call] = []
        self.found = asyncio.Event()
        self._started_by: dict[int, list[Call]] = {}
        loop.set_task_factory(self._make_task)

    def _make_task(
        self, loop: asyncio.AbstractEventLoop, coroutine: Coroutine[Any, Any, Any], **given: Any
    ) -> asyncio.Task[Any]:
        task = asyncio.Task(coroutine, loop=loop, **given)
        if self.on:
            self._started_by[id(task)] = self._calls_here(sys._getframe(1))
        return task

    def _calls_here(self, frame: FrameType) -> list[Call]:
        running = asyncio.current_task()
        return self._started_by.get(id(running), []) + calls_above(frame)

    def sent(self, frame: FrameType) -> None:
        """A frame has come to the link."""
        if not self.on or self.way:
            return
        way = self._calls_here(frame)
        if way and way[0][0].startswith("rpc/"):
            self.way = way
            self.found.set()


async def measured(folder: Path) -> dict[str, Any]:
    """Start a daemon, let a vehicle be heard, and arm it."""
    from skygcs.config.loader import load_fleet_and_dialect
    from skygcs.daemon import Daemon

    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    path = folder / "fleet.toml"
    path.write_text(FLEET.format(folder=folder, port=port))
    config, dialect = load_fleet_and_dialect(path)
    tracer = Tracer(asyncio.get_running_loop())
    daemon = Daemon(config, dialect, source=str(path))
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    found: dict[str, Any] = {"files": ours()}
    try:
        await _arm(daemon, folder, port, tracer)
    finally:
        daemon.stop()
        await running
        asyncio.get_running_loop().set_task_factory(None)
    return found | {
        "files_after_order": ours(),
        "calls": tracer.way,
        "call_files": sorted({file for file, _ in tracer.way}),
    }


async def _arm(daemon: Any, folder: Path, port: int, tracer: Tracer) -> None:
    from skygcs.core.mavlink.frame import encode
    from skygcs.links.udp import UdpChannel

    values = {"type": 2, "autopilot": 3, "system_status": 3, "mavlink_version": 3}
    heartbeat = encode(daemon.dialect.find("HEARTBEAT"), values, sysid=1, compid=1, seq=0)
    send = UdpChannel.send

    def traced(channel: UdpChannel, *arguments: Any) -> bool:
        tracer.sent(sys._getframe(1))
        return send(channel, *arguments)

    async def be_heard(vehicle: socket.socket) -> None:
        while True:
            vehicle.sendto(heartbeat, ("127.0.0.1", port))
            await asyncio.sleep(0.2)
            if daemon.fleet.vehicles:
                heard.set()

    heard = asyncio.Event()
    UdpChannel.send = traced  # type: ignore[method-assign,assignment]
    with socket.socket(type=socket.SOCK_DGRAM) as vehicle:
        hearing = asyncio.create_task(be_heard(vehicle))
        await heard.wait()
        await asyncio.sleep(1.5)  # the daemon's own requests of the first second have gone
        await _order_until_sent(folder, tracer)
        hearing.cancel()


async def _order_until_sent(folder: Path, tracer: Tracer) -> None:
    """Ask for an order until a frame of it was sent by its own way. One whose frame has to wait behind others is sent
    by the queue and shows no way: on a busy machine the next one does."""
    reader, writer = await asyncio.open_unix_connection(str(folder / "s"))
    tracer.on = True
    answers: list[bytes] = []
    for number in range(TRIES):
        request = {"jsonrpc": "2.0", "id": number, "method": "vehicles.arm", "params": {"targets": "all"}}
        writer.write(json.dumps(request).encode() + b"\n")
        answer = asyncio.ensure_future(reader.readline())
        found = asyncio.ensure_future(tracer.found.wait())
        await asyncio.wait((answer, found), return_when=asyncio.FIRST_COMPLETED)
        if tracer.way:
            answer.cancel()
            break
        found.cancel()
        answers.append(await answer)
    writer.close()
    if not tracer.way:
        sys.exit(f"no frame was sent by an order's own way; the answers: {answers}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
        print(json.dumps(asyncio.run(measured(Path(name)))))
