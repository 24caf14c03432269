"""A recording of a flight that was flown from a ground station, replayed beside a radio with a live vehicle."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from skygcs.config.models import MemoryLinkConfig
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.daemon import Daemon
from skygcs.errors import RefusedError
from skygcs.runtime.vehicle_actor import VehicleActor
from support.called import sender_of
from support.daemons import made_daemon, memory_link, started
from support.hosts import until
from support.routed import DIALECT, heartbeat, message


def write_tlog(path: Path) -> None:
    """Vehicles 1 and 2 and their ground station 255/190, which orders, asks and beats."""
    frames: list[bytes] = []
    for n in range(50):
        frames += [
            heartbeat(1, seq=n),
            heartbeat(2, seq=n),
            heartbeat(255, 190, seq=4 * n, gcs=True),
            message("COMMAND_LONG", 255, 190, 4 * n + 1, target_system=1, target_component=1, command=400, param1=1),
            message("COMMAND_LONG", 255, 190, 4 * n + 2, command=246, param1=1),
            message("REQUEST_DATA_STREAM", 255, 190, 4 * n + 3, target_system=1, req_message_rate=10, start_stop=1),
            message("ATTITUDE", 1, seq=100 + n, roll=0.5),
        ]
    path.write_bytes(b"".join((1_700_000_000_000_000 + n).to_bytes(8, "big") + raw for n, raw in enumerate(frames)))


@contextlib.asynccontextmanager
async def field(tmp_path: Path) -> AsyncIterator[Daemon]:
    """A daemon with a radio, a ground station and a link of no role; vehicle 1 is live on the radio."""
    daemon = made_daemon(
        tmp_path,
        links={
            "radio": MemoryLinkConfig(name="radio", role="radio"),
            "other": MemoryLinkConfig(name="other"),
            "gcs": MemoryLinkConfig(name="gcs", role="gcs"),
        },
    )
    async with started(daemon):
        await until(lambda: all(row["state"] == "up" for row in daemon.links.status()))
        peer(daemon, "radio").send(heartbeat(1, seq=200))
        await until(lambda: 1 << 8 | 1 in daemon.fleet.vehicles)
        yield daemon


def peer(daemon: Daemon, name: str) -> Any:
    return memory_link(daemon, name).peer


def got(daemon: Daemon, name: str) -> list[Frame]:
    return FrameParser(DIALECT).feed_datagram(b"".join(peer(daemon, name).received))


async def play(daemon: Daemon, path: Path) -> None:
    write_tlog(path)
    await daemon.links.add("flight", {"type": "replay", "file": str(path), "speed": 0})
    await until(lambda: daemon.links.status()[-1]["state"] == "finished")


async def test_nothing_of_it_reaches_the_radio_and_its_vehicle(tmp_path: Path) -> None:
    async with field(tmp_path) as daemon:
        live = daemon.fleet.vehicles[1 << 8 | 1]
        await play(daemon, tmp_path / "flight.tlog")
        for name in ("radio", "other"):
            third_party = [f for f in got(daemon, name) if (f.sysid, f.compid) not in ((255, 25), (1, 1))]
            assert third_party == [], "only our own heartbeats and requests, and the live vehicle"
        shown = [f for f in got(daemon, "gcs") if (f.sysid, f.compid) != (255, 25)]
        assert any(f.sysid == 2 for f in shown)
        assert [f for f in shown if f.target() != (0, 0)] == []
        assert daemon.fleet.vehicles[1 << 8 | 1] is live
        assert live.latest("ATTITUDE") is None, "the recorded vehicle 1 is not mixed with the live one"
        assert live.state(daemon.now())["replayed"] is False


async def test_a_recorded_vehicle_is_marked_and_takes_no_orders_until_it_is_heard_live(tmp_path: Path) -> None:
    async with field(tmp_path) as daemon:
        await play(daemon, tmp_path / "flight.tlog")
        recorded = daemon.fleet.vehicles[2 << 8 | 1]
        assert recorded.state(daemon.now())["replayed"] is True
        before = len(got(daemon, "radio"))
        for order, arguments in (
            (VehicleActor.arm, {}),
            (VehicleActor.land, {}),
            (VehicleActor.disarm, {"force": True}),
        ):
            [outcome] = (await daemon.fleet.orders.command_all("2", order, **arguments)).values()
            assert outcome.result == "refused"
            assert "recording" in outcome.message
        try:
            sender_of(daemon).send("PARAM_REQUEST_LIST", {}, "2")
            raise AssertionError("it was sent")
        except RefusedError as error:
            assert "only in a recording" in str(error)
        assert [f for f in got(daemon, "radio")[before:] if f.name != "HEARTBEAT"] == []

        peer(daemon, "radio").send(heartbeat(2, seq=9))
        await until(lambda: daemon.fleet.vehicles.get(2 << 8 | 1) not in (None, recorded))
        assert daemon.fleet.vehicles[2 << 8 | 1].state(daemon.now())["replayed"] is False
        assert sender_of(daemon).send("PARAM_REQUEST_LIST", {}, "2")["sent"] == 1


async def test_it_is_warned_of_when_it_is_added(tmp_path: Path) -> None:
    async with field(tmp_path) as daemon:
        await play(daemon, tmp_path / "flight.tlog")
        row = daemon.links.status()[-1]
        assert row["warning"].startswith("a replay beside radio, other: nothing of it is sent there")
        assert "warning" not in daemon.links.status()[0]
        assert [e["data"] for e in daemon.event_log.recent if e["kind"] == "warning"] == [{"link": "flight"}]
