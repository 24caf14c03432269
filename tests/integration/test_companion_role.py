"""The daemon as a companion, in virtual time: who it is to the autopilot, what goes between autopilot and ground."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from skygcs.config.models import DaemonConfig, FleetConfig, MemoryLinkConfig, VehicleEntry
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.mavlink.parser import FrameParser
from skygcs.daemon import Daemon
from skygcs.ext.companions.companion_table import CompanionConfig
from skygcs.ext.companions.ground_contact import GROUND_LINK
from skygcs.ext.companions.role import as_companion
from skygcs.rpc.client import connect
from support.daemons import memory_link, started
from support.routed import DIALECT, heartbeat, message

GCS, ONBOARD = 6, 18


class Far:
    """The far end of one of the daemon's links."""

    def __init__(self, daemon: Daemon, name: str) -> None:
        link = memory_link(daemon, name)
        self.peer = link.peer

    def send(self, *frames: bytes) -> None:
        for raw in frames:
            self.peer.send(raw)

    def frames(self) -> list[Frame]:
        return FrameParser(DIALECT).feed(b"".join(self.peer.received))

    def heartbeats(self) -> list[tuple[int, int, int]]:
        """(sysid, compid, type) of each."""
        return [(f.sysid, f.compid, int(f.fields()["type"])) for f in self.frames() if f.msgid == HEARTBEAT]


@contextlib.asynccontextmanager
async def companion(folder: Path) -> AsyncIterator[tuple[Daemon, Far, Far]]:
    """(daemon, the autopilot's end, the ground's end); the vehicle has system id 7."""
    table = CompanionConfig(vehicle="alpha", ground="udp:192.0.2.1:14650", key_dir=folder / "keys")
    config = FleetConfig(
        daemon=DaemonConfig(socket=folder / "s", log_dir=folder / "logs", record=False),
        vehicles={"alpha": VehicleEntry(sysid=7)},
        links={
            "autopilot": MemoryLinkConfig(name="autopilot", role="vehicle"),
            GROUND_LINK: MemoryLinkConfig(name=GROUND_LINK, role="gcs"),
        },
    )
    config = config.model_copy(update={"extensions": {"companion": table}})
    daemon = Daemon(as_companion(table, config), DIALECT)
    async with started(daemon):
        await asyncio.sleep(1.0)
        yield daemon, Far(daemon, "autopilot"), Far(daemon, GROUND_LINK)


def command(target: int, compid: int, seq: int, command: int = 511) -> bytes:
    values: dict[str, Any] = {"target_system": target, "target_component": compid, "command": command}
    return message("COMMAND_LONG", 255, 190, seq, **values)


async def test_it_is_an_onboard_computer_and_never_a_ground_station(tmp_path: Path) -> None:
    async with companion(tmp_path) as (_, autopilot, ground):
        for n in range(20):
            autopilot.send(heartbeat(7, seq=n))
            await asyncio.sleep(1.0)
        assert set(autopilot.heartbeats()) == {(7, 191, ONBOARD)}
        assert set(ground.heartbeats()) == {(7, 191, ONBOARD), (7, 1, 2)}
        assert {frame.sysid for frame in autopilot.frames()} == {7}  # its own requests have the vehicle's id, too


async def test_the_grounds_heartbeats_come_through_as_they_are_and_stop_with_it(tmp_path: Path) -> None:
    async with companion(tmp_path) as (_, autopilot, ground):
        sent = [heartbeat(255, 190, seq=n, gcs=True) for n in range(10)]
        for n, raw in enumerate(sent):
            autopilot.send(heartbeat(7, seq=n))
            ground.send(raw)
            await asyncio.sleep(1.0)
        came = [frame.raw for frame in autopilot.frames() if frame.sysid == 255]
        assert came == sent
        await asyncio.sleep(10.0)  # the ground is gone
        assert [frame.raw for frame in autopilot.frames() if frame.sysid == 255] == sent
        assert all(kind != GCS for sysid, _, kind in autopilot.heartbeats() if sysid == 7)


async def test_commands_to_the_autopilot_pass_and_those_to_the_companion_stay(tmp_path: Path) -> None:
    async with companion(tmp_path) as (_, autopilot, ground):
        autopilot.send(heartbeat(7))
        ground.send(heartbeat(255, 190, gcs=True))
        await asyncio.sleep(1.0)
        passing = [command(7, 1, 1), command(7, 0, 2), command(0, 0, 3)]
        ground.send(*passing, command(7, 191, 4), command(8, 1, 5))
        await asyncio.sleep(1.0)
        assert [frame.raw for frame in autopilot.frames() if frame.sysid == 255][1:] == passing
        acknowledged = message("COMMAND_ACK", 7, 1, 1, command=511, target_system=255, target_component=190)
        autopilot.send(acknowledged)
        await asyncio.sleep(1.0)
        assert acknowledged in [frame.raw for frame in ground.frames()]


async def test_its_own_orders_reach_the_autopilot_that_has_its_system_id(tmp_path: Path) -> None:
    async with companion(tmp_path) as (_, autopilot, _ground), connect(tmp_path / "s") as gcs:
        autopilot.send(heartbeat(7))
        await asyncio.sleep(1.0)
        asked = asyncio.create_task(gcs.call("vehicles.command", targets="alpha", command=512, params=[1]))
        await asyncio.sleep(0.5)
        (sent, *_) = [f for f in autopilot.frames() if f.msgid == 76 and int(f.fields()["command"]) == 512]
        assert (sent.sysid, sent.compid, sent.target()) == (7, 191, (7, 1))
        autopilot.send(message("COMMAND_ACK", 7, 1, 1, command=512, target_system=7, target_component=191))
        assert (await asked)["outcomes"]["alpha"]["ok"]
        status = await gcs.call("companions.status")
        assert (status["companion"]["sysid"], status["companion"]["compid"]) == (7, 191)
        info = await gcs.call("daemon.info")
        assert (info["companion_of"], info["faults"]) == ("alpha", 0)
