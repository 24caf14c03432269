"""Bound links over real UDP sockets, with the compiled fast path and without it: which datagrams arrive, and how."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.routing.sysid_translation import SysidTranslator
from skygcs.links import fast_path
from skygcs.links.udp import UdpServerLink
from support.daemons import made_daemon, started
from support.hosts import drained, until
from support.routed import DIALECT, heartbeat, message

PROGRAMS = {"plain": {"vehicles": [5]}, "turned": {"vehicles": [5], "translated_sysid": 1}, "other": {"vehicles": [6]}}


def bound_socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.setblocking(False)
    return sock


@pytest.fixture
def sockets() -> Iterator[dict[str, socket.socket]]:
    made = {name: bound_socket() for name in (*PROGRAMS, "v5", "v6")}
    yield made
    for sock in made.values():
        sock.close()


def turned(data: bytes) -> bytes:
    endpoint = SysidTranslator([5], 1)
    return b"".join(endpoint.outward(f) or b"" for f in FrameParser(DIALECT).feed_datagram(data))


@pytest.mark.parametrize("pure", [False, True], ids=["fast path", "pure"])
async def test_each_program_gets_its_vehicles_datagrams_whole(
    tmp_path: Path, sockets: dict[str, socket.socket], pure: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if pure:
        monkeypatch.setenv(fast_path.PURE, "1")
    links = {
        name: {"type": "udp_client", "host": "127.0.0.1", "port": sockets[name].getsockname()[1], "role": "gcs", **keys}
        for name, keys in PROGRAMS.items()
    }
    daemon = made_daemon(tmp_path, links={"air": {"type": "udp_server", "host": "127.0.0.1", "port": 0}, **links})
    async with started(daemon):
        await until(lambda: all(row["state"] == "up" for row in daemon.links.status()))
        air = daemon.links.link("air")
        assert isinstance(air, UdpServerLink)
        place = ("127.0.0.1", air.bound_port)
        sent: list[bytes] = []
        sockets["v5"].sendto(heartbeat(5), place)
        sockets["v6"].sendto(heartbeat(6), place)
        await until(lambda: daemon.hub.router.channels_of(6 << 8 | 1))
        await asyncio.sleep(0.05)
        for name in (*PROGRAMS, "v5", "v6"):
            drained(sockets[name])
        for n in range(20):  # from the second on they take the fast path, if there is one
            data = message("ATTITUDE", 5, seq=2 * n, time_boot_ms=n) + message("VFR_HUD", 5, seq=2 * n + 1, heading=n)
            sent.append(data)
            sockets["v5"].sendto(data, place)
            sockets["v6"].sendto(message("ATTITUDE", 6, seq=n), place)
            await asyncio.sleep(0.005)
        await until(lambda: sum(c.tx_frames for c in daemon.hub.channels.values() if c.link.name == "turned") >= 41)
        await asyncio.sleep(0.05)
        assert drained(sockets["plain"]) == sent
        assert drained(sockets["turned"]) == [turned(data) for data in sent]
        assert len(drained(sockets["other"])) == 20
        order = message("COMMAND_LONG", 255, 0, target_system=1, command=400)
        (channel,) = (c for c in daemon.hub.channels.values() if c.link.name == "turned")
        source = ("127.0.0.1", daemon.links.link("turned").bound_port)  # type: ignore[union-attr]
        drained(sockets["v5"])
        sockets["turned"].sendto(order, source)
        await until(lambda: channel.rx_frames)
        await asyncio.sleep(0.05)
        reached = [f for data in drained(sockets["v5"]) for f in FrameParser(DIALECT).feed_datagram(data)]
        orders = [f for f in reached if f.name == "COMMAND_LONG"]
        assert [(f.sysid, f.compid, f.target()) for f in orders] == [(255, 0, (5, 0))]
