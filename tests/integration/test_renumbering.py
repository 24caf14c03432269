"""A vehicle gets another system id, and one that is gone is forgotten: simulated vehicles of both firmwares."""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.daemon import Daemon
from skygcs.runtime.renumbering import RETURN_S
from skygcs.sim import protocol as m
from skygcs.sim.ardupilot import CopterVehicle
from support.flown import Flown
from support.grounded import grounded

FILE = """[daemon]
record = false

[vehicles.papa]
sysid = 1
group = "scouts"
[vehicles.echo]
sysid = 2
[vehicles.spare]
sysid = 9
"""
VEHICLES: Mapping[str, Any] = {"papa": {"sysid": 1, "group": "scouts"}, "echo": {"sysid": 2}, "spare": {"sysid": 9}}


@contextlib.asynccontextmanager
async def fielded(tmp_path: Path, **own: Any) -> AsyncIterator[Flown]:
    """papa is a PX4, echo an ArduCopter 4.5, ready to arm; spare is in the file only."""
    file = tmp_path / "fleet.toml"
    file.write_text(FILE)
    config = FleetConfig.model_validate(
        {
            "daemon": {"socket": tmp_path / "s", "log_dir": tmp_path / "logs", "record": False, **own},
            "links": {"air": {"type": "memory", "role": "radio", "seed": 7}},
            "vehicles": VEHICLES,
        }
    )
    daemon = Daemon(config, load_dialect(config.dialect), source=str(file))
    async with grounded(daemon, settle_s=12.0) as gcs:
        yield gcs


async def renumber(gcs: Flown, target: str, sysid: int, **more: Any) -> dict[str, Any]:
    (outcome,) = (await gcs("vehicles.renumber", target=target, sysid=sysid, **more))["outcomes"].values()
    return dict(outcome)


def ids(gcs: Flown) -> dict[str, int]:
    return {actor.name: actor.sysid for actor in gcs.daemon.fleet.resolve("all")}


def reboots(gcs: Flown) -> int:
    return sum(s.name == "COMMAND_LONG" and s.values["command"] == 246 for s in gcs.sent)


@pytest.mark.parametrize("at_once", [False, True])
async def test_a_copter_takes_its_new_id_at_once_or_with_a_restart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_once: bool
) -> None:
    monkeypatch.setattr(CopterVehicle, "renumbers_at_once", at_once)
    async with fielded(tmp_path) as gcs:
        told = await renumber(gcs, "2", 23)
        assert told["ok"] and "SYSID_THISMAV read back" in told["message"], told
        assert reboots(gcs) == (0 if at_once else 1)
        assert ids(gcs) == {"papa": 1, "echo": 23} and gcs.sims[1].sysid == 23
        assert (await gcs("vehicles.list", targets="all"))[1]["connected"]


async def test_an_id_that_is_taken_or_none_is_refused(tmp_path: Path) -> None:
    async with fielded(tmp_path, sysid=240) as gcs:
        gcs.link.peer.send(gcs.other.heartbeat(vehicle=False))
        await asyncio.sleep(0.5)
        refused = {
            2: "system id 2 is taken: echo has it",
            9: "system id 9 is spare's in the fleet file",
            240: "it is skygcs' own",
            250: "a system with that id is heard",
        }
        for sysid, why in refused.items():
            told = await renumber(gcs, "papa", sysid)
            assert told["result"] == "refused" and why in told["message"], told
        for sysid in (0, 251, 256, -1):
            with pytest.raises(ValueError, match="sysid"):
                await renumber(gcs, "papa", sysid)
        assert (await renumber(gcs, "papa", 1))["message"] == "it is system 1 already"
        assert gcs.sims[0].params["MAV_SYS_ID"] == 1 and not reboots(gcs)
        told = await renumber(gcs, "papa", 9, force=True)
        assert told["ok"] and ids(gcs) == {"spare": 9, "echo": 2}, "with force it is the vehicle that the file means"


async def test_an_armed_vehicle_keeps_its_id(tmp_path: Path) -> None:
    async with fielded(tmp_path) as gcs:
        await gcs.done("vehicles.arm", targets="papa", wait_s=30)
        told = await renumber(gcs, "papa", 22)
        assert told["result"] == "refused" and "it is armed" in told["message"]
        assert gcs.sims[0].params["MAV_SYS_ID"] == 1


@pytest.mark.deep
async def test_one_that_does_not_restart_says_what_to_do_and_is_found_when_somebody_did(tmp_path: Path) -> None:
    """As PX4 in SITL, which denies it."""
    async with fielded(tmp_path) as gcs:
        papa = gcs.sims[0]
        command = papa.command

        def denying(c: Any, now: float) -> int | None:
            return m.MAV_RESULT_DENIED if c.id == 246 else command(c, now)

        papa.command = denying  # type: ignore[method-assign]
        told = await renumber(gcs, "papa", 22)
        assert told["result"] == "denied", told
        assert told["message"].startswith(
            "its MAV_SYS_ID is 22 now: until it restarts it is system 1, and it does not "
        )
        assert "switch it off and on" in told["message"] and "param set papa MAV_SYS_ID=1" in told["message"]
        assert ids(gcs) == {"papa": 1, "echo": 2}
        gcs.cut = True
        await asyncio.sleep(8)
        gcs.cut = False
        papa.reboot(gcs.now)
        await gcs.until(lambda: ids(gcs) == {"papa": 22, "echo": 2}, 30.0)


async def test_one_that_never_returns_is_told_and_can_be_forgotten(tmp_path: Path) -> None:
    async with fielded(tmp_path) as gcs:
        papa = gcs.sims[0]
        reboot = papa.reboot

        def dies(now: float) -> None:
            reboot(now)
            papa.boot_at = now + 1e6

        papa.reboot = dies  # type: ignore[method-assign]
        began = gcs.now
        told = await renumber(gcs, "papa", 22)
        assert told["result"] == "timeout" and "was not heard since, neither as 22 nor as 1" in told["message"], told
        assert RETURN_S < gcs.now - began < RETURN_S + 20
        outcomes = (await gcs("vehicles.hold", targets="all"))["outcomes"]
        assert not outcomes["papa"]["ok"], "the ghost"
        told = (await gcs("vehicles.forget", targets="all"))["outcomes"]
        assert told["papa"]["ok"] and told["papa"]["message"].startswith("papa (system 1) is forgotten, last heard ")
        assert told["echo"]["result"] == "refused" and "it was heard " in told["echo"]["message"]
        assert ids(gcs) == {"echo": 2}


async def test_one_whose_parameter_does_not_hold_is_found_out(tmp_path: Path) -> None:
    async with fielded(tmp_path) as gcs:
        papa = gcs.sims[0]
        reboot = papa.reboot

        def forgetful(now: float) -> None:
            papa.params.set("MAV_SYS_ID", papa.params.encode(papa.params.find("MAV_SYS_ID")[1]))  # type: ignore[index]
            papa.params.find("MAV_SYS_ID")[1].value = 1  # type: ignore[index]
            reboot(now)

        papa.reboot = forgetful  # type: ignore[method-assign]
        told = await renumber(gcs, "papa", 22)
        assert told["result"] == "failed" and "is still heard as system 1" in told["message"], told
        assert ids(gcs) == {"papa": 1, "echo": 2}


async def test_a_vehicle_that_was_lost_armed_is_not_forgotten_by_mistake(tmp_path: Path) -> None:
    async with fielded(tmp_path) as gcs:
        await gcs.done("vehicles.takeoff", targets="papa", height_m=10, wait_s=30)
        await asyncio.sleep(10)
        gcs.cut = True
        await asyncio.sleep(10)
        told = (await gcs("vehicles.forget", targets="papa"))["outcomes"]["papa"]
        assert told["result"] == "refused" and re.search(
            r"was lost armed \d+ s ago and may still fly", told["message"]
        ), told
        told = (await gcs("vehicles.forget", targets="papa", force=True))["outcomes"]["papa"]
        assert told["ok"] and ids(gcs) == {"echo": 2}
        gcs.cut = False
        await gcs.until(lambda: ids(gcs) == {"papa": 1, "echo": 2}, 10.0)
        assert gcs.actor("papa").vehicle.armed, "what flies is met anew, as it is"


async def test_a_forgotten_vehicle_leaves_its_subscribers_and_its_components(tmp_path: Path) -> None:
    async with fielded(tmp_path) as gcs:
        gcs.cut = True
        await asyncio.sleep(10)
        fleet = gcs.daemon.fleet
        for sysid in (1, 2):
            assert fleet.vehicles_of(sysid)
        await gcs("vehicles.forget", targets="1,2")
        assert not fleet.vehicles and not fleet.vehicles_of(1) and await gcs("components.list") == []
        assert (await gcs("vehicles.list", targets="all")) == []
