"""What a daemon records under uvloop, with the compiled fast path beside Python's way, as its own reader sees it."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest
import uvloop

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.daemon import Daemon
from skygcs.tlog.reading import LogReader
from support.frames import offline
from support.public_data import own_capture

pytestmark = pytest.mark.system

FRAMES = 6000


def test_its_own_recording_is_in_order_and_shows_no_loss(tmp_path: Path) -> None:
    """It complained of its own recordings: 7,353 times the time went backwards, by up to half a millisecond."""
    lost = uvloop.run(_record(tmp_path))
    assert lost == {1: 0, 2: 0, 3: 0, 11: 0, 12: 0}
    (path,) = tmp_path.glob("*.tlog")
    reader = LogReader(path.read_bytes(), offline(), "tlog")
    senders = [entry.frame.sysid for entry in reader if entry.frame is not None]
    assert reader.faults.out_of_order == 0
    assert reader.faults.lines() == []
    assert len(senders) > FRAMES and 255 in senders


async def _record(folder: Path) -> dict[int, int]:
    """A capture sent over UDP in datagrams of one to five frames, with orders of the daemon in between; frames lost by
    vehicle."""
    vehicles, station = _socket(), _socket()
    config = FleetConfig.model_validate(
        {
            "daemon": {"socket": folder / "s", "log_dir": folder},
            "links": {
                "air": {"type": "udp_server", "host": "127.0.0.1", "port": 0, "role": "vehicle"},
                "gcs": {"type": "udp_client", "host": "127.0.0.1", "port": station.getsockname()[1], "role": "gcs"},
            },
        }
    )
    daemon = Daemon(config, load_dialect(config.dialect))
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    link = daemon.links.link("air")
    while link is None or not getattr(link, "bound_port", 0):
        await asyncio.sleep(0.01)
        link = daemon.links.link("air")
    frames = [r.raw for r in LogReader(own_capture("px4-late-frames"), offline()) if r.raw[5] != 255][:FRAMES]
    at = number = 0
    while at < len(frames):
        size = 1 + number % 5
        vehicles.sendto(b"".join(frames[at : at + size]), ("127.0.0.1", link.bound_port))  # type: ignore[attr-defined]
        at, number = at + size, number + 1
        if number % 10 == 0:
            for actor in daemon.fleet.vehicles.values():
                actor.commands.transmit("COMMAND_LONG", {"command": 512, "param1": 148.0})
            await asyncio.sleep(0.002)
    await asyncio.sleep(0.2)
    lost = {key >> 8: daemon.hub.statistics.link_quality(key)["air"]["lost"] for key in daemon.fleet.vehicles}
    daemon.stop()
    await running
    vehicles.close(), station.close()
    return lost


def _socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    return sock
