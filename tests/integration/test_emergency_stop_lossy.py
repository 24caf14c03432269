"""An emergency stop through the whole daemon: socket, two links, and a vehicle that hears nothing at first."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.models import MemoryLinkConfig
from skygcs.daemon import Daemon
from skygcs.errors import RpcError
from skygcs.links.memory import MemoryLink
from skygcs.rpc.client import connect
from support.daemons import made_daemon, started
from support.hosts import until
from support.pymav import PymavPeer

GUIDED, LAND = 4, 9


class Copter(PymavPeer):
    """An ArduCopter of pymavlink on two links, of whose commands the first ``deaf`` are lost on both."""

    def __init__(self, daemon: Daemon, sysid: int, deaf: int) -> None:
        super().__init__(sysid, 1)
        links = [daemon.links.link(name) for name in ("radio", "wifi")]
        self.peers = [link.peer for link in links if isinstance(link, MemoryLink)]
        self.mode, self.armed, self.deaf = GUIDED, True, deaf
        self.heard: list[tuple[str, Any]] = []
        self._read = [0, 0]

    def live(self) -> None:
        """One look at its links, and a heartbeat over both."""
        for n, (name, peer) in enumerate(zip(("radio", "wifi"), self.peers, strict=True)):
            for raw in peer.received[self._read[n] :]:
                self._read[n] += 1
                for message in self.mav.parse_buffer(raw) or []:
                    self._hear(name, message)
        self._tell(self.heartbeat(custom_mode=self.mode, armed=self.armed))

    def _hear(self, link: str, message: Any) -> None:
        mine = message.get_type() == "COMMAND_LONG" and message.target_system == self.mav.srcSystem
        if not mine or message.command not in (21, 176, 400):
            return
        self.heard.append((link, message))
        if len(self.heard) <= self.deaf:
            return
        if message.command == 21:
            self.mode = LAND
        elif message.command == 400 and message.param2 == 21196:
            self.armed = False
        self._tell(self.pack(mav.MAVLink_command_ack_message(message.command, 0, 0, 0, 255, 25)))

    def _tell(self, raw: bytes) -> None:
        for peer in self.peers:
            peer.send(raw)


@contextlib.asynccontextmanager
async def flown(tmp_path: Path, *deaf: int) -> AsyncIterator[tuple[Daemon, list[Copter]]]:
    """A daemon and one copter for each number of lost commands."""
    links = {name: MemoryLinkConfig(name=name, role="radio") for name in ("radio", "wifi")}
    async with started(made_daemon(tmp_path, links=links, defaults={"streams": {}})) as daemon:
        await until(lambda: all(row["state"] == "up" for row in daemon.links.status()))
        copters = [Copter(daemon, sysid, lost) for sysid, lost in enumerate(deaf, 1)]

        async def live() -> None:
            while True:
                for copter in copters:
                    copter.live()
                await asyncio.sleep(0.05)

        living = asyncio.create_task(live())
        try:
            await until(lambda: len(daemon.fleet.vehicles) == len(copters))
            yield daemon, copters
        finally:
            living.cancel()
            await asyncio.gather(living, return_exceptions=True)


async def test_a_stop_lost_on_every_link_at_first_lands_every_vehicle_and_tells_of_each(tmp_path: Path) -> None:
    async with flown(tmp_path, 0, 4) as (_, (hearing, deaf)), connect(tmp_path / "s") as gcs:
        outcomes = (await gcs.call("vehicles.stop", targets="all", action="land"))["outcomes"]
        assert {name: o["ok"] for name, o in outcomes.items()} == {"v1": True, "v2": True}
        assert outcomes["v1"]["attempts"] < outcomes["v2"]["attempts"]
        assert hearing.mode == deaf.mode == LAND
        assert {link for link, _ in deaf.heard} == {"radio", "wifi"}, "over each link that leads to it"


async def test_a_stop_outlives_whoever_ordered_it(tmp_path: Path) -> None:
    async with flown(tmp_path, 6) as (daemon, (copter,)):
        async with connect(tmp_path / "s") as gcs:
            order = asyncio.create_task(gcs.call("vehicles.stop", targets="1", action="land"))
            await until(lambda: copter.heard)
            order.cancel()
            await asyncio.gather(order, return_exceptions=True)
        await until(lambda: copter.mode == LAND)
        await until(lambda: any(e["text"].startswith("stop: landing") for e in daemon.event_log.recent))


async def test_a_kill_is_sent_only_with_its_word(tmp_path: Path) -> None:
    async with flown(tmp_path, 0, 0) as (_, copters), connect(tmp_path / "s") as gcs:
        with pytest.raises(RpcError, match=r"v1 and v2, .*'kill-2'"):
            await gcs.call("vehicles.stop", targets="all", action="kill")
        assert not any(c.heard for c in copters)
        outcomes = (await gcs.call("vehicles.stop", targets="all", action="kill", confirm="kill-2"))["outcomes"]
        assert all(o["ok"] for o in outcomes.values())
        assert not any(c.armed for c in copters)
