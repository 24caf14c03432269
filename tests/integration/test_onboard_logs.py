"""Onboard logs through the whole daemon, from simulated vehicles of both firmwares to files."""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.config.models import SimulatedLinkConfig
from skygcs.daemon import Daemon
from skygcs.ext.onboard_logs.vehicle_logs import VehicleLogs
from skygcs.rpc.client import Client, connect
from skygcs.sim import onboard_logs as sim
from skygcs.sim.vehicle import SimVehicle
from support.daemons import made_daemon, simulated_link, started
from support.hosts import open_descriptors, until
from support.virtual_asyncio import stuck_threads


class Lab:
    def __init__(self, daemon: Daemon, gcs: Client, folder: Path) -> None:
        self.daemon = daemon
        self.gcs = gcs
        self.folder = folder / "logs" / "onboard"

    def sim(self, name: str) -> SimVehicle:
        link = simulated_link(self.daemon, "sim")
        return next(v for v in link.vehicles if f"v{v.sysid}" == name)

    async def get(self, targets: str, logs: Any = "latest", **more: Any) -> dict[str, Any]:
        answer = await self.gcs.call("logs.get", targets=targets, logs=logs, **more)
        outcomes = answer["outcomes"]
        assert isinstance(outcomes, dict)
        return outcomes

    def files(self) -> list[str]:
        return sorted(str(p.relative_to(self.folder)) for p in self.folder.rglob("*") if p.is_file())


def content(file: dict[str, Any]) -> bytes:
    return Path(file["path"]).read_bytes()


@contextlib.asynccontextmanager
async def running(tmp_path: Path, **link: Any) -> AsyncIterator[Lab]:
    """v1 is a PX4, v2 an ArduCopter."""
    daemon = made_daemon(
        tmp_path,
        daemon={"record": True},
        links={"sim": SimulatedLinkConfig(name="sim", px4=1, ardupilot=1, dynamics="kinematic", **link)},
    )
    async with started(daemon):
        await until(lambda: len(daemon.fleet.vehicles) == 2)
        async with connect(tmp_path / "s") as gcs:
            yield Lab(daemon, gcs, tmp_path)


async def test_logs_of_both_firmwares_arrive_byte_for_byte_at_the_same_time(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        listed = (await lab.gcs.call("logs.list", targets="all"))["outcomes"]
        assert [log["id"] for log in listed["v1"]["logs"]] == [0, 1, 2]
        assert [log["id"] for log in listed["v2"]["logs"]] == [1, 2, 3]
        outcomes = await lab.get("all", "all")
        for name, suffix in (("v1", ".ulg"), ("v2", ".bin")):
            assert outcomes[name]["ok"], outcomes[name]
            files = outcomes[name]["files"]
            assert [Path(f["path"]).suffix for f in files] == [suffix] * 3
            assert [content(f) for f in files] == [log.data for log in lab.sim(name).logs.logs]
        # what is there is not read again
        again = await lab.get("v2", [2])
        assert again["v2"]["files"][0]["resumed_at"] == sim.SIZES_BYTES[1]
        assert len(lab.files()) == 6


async def test_a_client_that_goes_away_ends_it_and_the_next_goes_on(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        vehicle = lab.sim("v2").logs
        call = asyncio.create_task(lab.get("v2", [2]))
        await until(lambda: any(f.endswith(".part") and (lab.folder / f).stat().st_size for f in lab.files()))
        call.cancel()
        await asyncio.gather(call, return_exceptions=True)
        await lab.gcs.close()
        await until(lambda: vehicle._sending is None)
        async with connect(tmp_path / "s") as other:
            answer: Any = None
            for _ in range(100):  # until the daemon has noticed
                answer = (await other.call("logs.get", targets="v2", logs=[2]))["outcomes"]["v2"]
                if answer["ok"] or "in progress" not in answer["message"]:
                    break
                await asyncio.sleep(0.05)
            assert answer["ok"], answer
            (file,) = answer["files"]
            assert file["resumed_at"] >= 46_080
            assert content(file) == vehicle.logs[1].data
        assert [f for f in lab.files() if f.endswith(".part")] == []


async def test_a_download_that_ends_while_its_file_is_being_opened_leaves_no_file_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, go_on = threading.Event(), threading.Event()
    system_open = os.open

    def slow(path: Any, *args: Any, **kwargs: Any) -> int:
        if str(path).endswith(".part"):
            asked.set()
            assert go_on.wait(60)
        return system_open(path, *args, **kwargs)

    def held() -> list[str]:
        return [name for name in open_descriptors() if ".part" in name]

    async with running(tmp_path) as lab:
        monkeypatch.setattr(os, "open", slow)
        actor = lab.daemon.fleet.vehicles[2 << 8 | 1]
        download = asyncio.create_task(actor.part(VehicleLogs).get([2]))
        with stuck_threads():
            await until(asked.is_set)
            download.cancel()
            await asyncio.gather(download, return_exceptions=True)
            assert download.cancelled()
            go_on.set()
        await until(lambda: any(f.endswith(".part") for f in lab.files()))
        await until(lambda: not held())
        monkeypatch.undo()
        assert (await actor.part(VehicleLogs).get([2])).ok


@pytest.mark.parametrize("opening", [False, True])
async def test_a_download_ends_when_its_vehicle_is_armed_and_goes_on_afterwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, opening: bool
) -> None:
    """Its card is needed for the log of the flight; ``opening``: it is armed between the list and the first data."""
    async with running(tmp_path) as lab:
        vehicle, actor = lab.sim("v1"), lab.daemon.fleet.vehicles[1 << 8 | 1]
        go_on, system_open = threading.Event(), os.open

        def slow(path: Any, *args: Any, **kwargs: Any) -> int:
            assert not str(path).endswith(".part") or go_on.wait(60)
            return system_open(path, *args, **kwargs)

        if opening:
            monkeypatch.setattr(os, "open", slow)
            download = asyncio.create_task(actor.part(VehicleLogs).get([1]))
            with stuck_threads():
                await asyncio.sleep(2.0)
                vehicle.armed = True
                await until(lambda: actor.vehicle.armed)
                go_on.set()
        else:
            download = asyncio.create_task(actor.part(VehicleLogs).get([1]))
            await until(lambda: any(f.endswith(".part") and (lab.folder / f).stat().st_size for f in lab.files()))
            vehicle.armed = True
        ended = await download
        assert not ended.ok and " armed" in ended.message, ended.message
        assert vehicle.logs._sending is None
        vehicle.armed = False
        await until(lambda: not actor.vehicle.armed)
        again = await actor.part(VehicleLogs).get([1])
        assert again.ok and (again.files[0].resumed_at > 0 or opening)
        assert again.files[0].path.read_bytes() == vehicle.logs.logs[1].data


async def test_what_is_refused_says_why(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        unknown = (await lab.get("v2", [99]))["v2"]
        assert (unknown["result"], unknown["message"]) == ("refused", "refused: it has no log 99; the newest: 1, 2, 3")
        first = asyncio.create_task(lab.get("v2", [2]))
        await until(lambda: lab.sim("v2").logs._sending is not None)
        second = (await lab.get("v2"))["v2"]
        assert second["result"] == "refused" and "in progress" in second["message"]
        assert (await first)["v2"]["ok"]
        lab.sim("v2").armed = True
        await until(lambda: lab.daemon.fleet.vehicles[2 << 8 | 1].vehicle.armed)
        armed = (await lab.get("v2"))["v2"]
        assert armed["result"] == "refused" and "it is armed" in armed["message"]
        lab.sim("v2").armed = False


async def test_a_radio_is_refused_unless_somebody_insists(tmp_path: Path) -> None:
    async with running(tmp_path, role="radio", radio={"air_kbps": 250}) as lab:
        refused = (await lab.get("v1", [0]))["v1"]
        assert refused["result"] == "refused" and "sim is a radio: 45,000 bytes" in refused["message"]
        assert lab.files() == []
        forced = (await lab.get("v1", [2], force=True))["v1"]
        assert forced["ok"], forced
        assert content(forced["files"][0]) == lab.sim("v1").logs.logs[2].data


async def test_a_disk_that_takes_nothing_ends_it_with_the_reason(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        lab.folder.parent.mkdir(exist_ok=True)
        lab.folder.write_text("in the way")
        outcome = (await lab.get("v1"))["v1"]
        assert outcome["result"] == "failed" and "onboard" in outcome["message"]
        assert lab.daemon.hub.faults == 0


async def test_a_vehicle_that_falls_silent_or_a_daemon_that_stops_ends_it(tmp_path: Path) -> None:
    async with running(tmp_path) as lab:
        call = asyncio.create_task(lab.get("v2", [2]))
        await until(lambda: lab.sim("v2").logs._sending is not None)
        lab.sim("v2").faults.mute = True
        outcome = (await call)["v2"]
        assert (outcome["ok"], outcome["result"]) == (False, "lost"), outcome
        lab.sim("v2").faults.mute = False
        call = asyncio.create_task(lab.get("v1", [1]))
        await until(lambda: lab.sim("v1").logs._sending is not None)
        lab.daemon.stop()
        answer = (await asyncio.gather(call, return_exceptions=True))[0]
        assert isinstance(answer, Exception) or answer["v1"]["result"] == "cancelled", answer
