"""Parameters of simulated PX4 and ArduCopter through the whole fleet, and files taken to them, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.params.compare import plan
from skygcs.core.params.param_file import of_vehicle, parse, write
from skygcs.core.protocols.ftp import MESSAGE
from skygcs.runtime.param_cache import ParamCache
from support.sim_field import SimField

pytestmark = pytest.mark.looptime


class Field(SimField):
    """A simulated vehicle of each kind; ``sent``: the names of what was sent."""

    delay_s = 0.1
    ready_s = 6.0

    def __init__(self, cache: Path) -> None:
        self.sent: list[str] = []
        super().__init__(1, 1, {}, param_cache=ParamCache(cache))

    def on_send(self, message: str, values: Mapping[str, Any]) -> None:
        self.sent.append(message)


@pytest.mark.parametrize(("target", "name", "value"), [("1", "NAV_RCL_ACT", 0), ("2", "SYSID_MYGCS", 254)])
async def test_a_file_of_a_vehicle_taken_to_it_sets_what_was_changed_in_it(
    target: str, name: str, value: int, tmp_path: Path
) -> None:
    async with Field(tmp_path) as field:
        fleet, sent = field.fleet, field.sent
        (actor,) = fleet.resolve(target)
        held = await actor.params.load()
        assert held.ok and {p.name for p in held.params} >= {name}
        kept = of_vehicle(held.params, "plain", sysid=actor.sysid, compid=1, about={})
        text = "\n".join(f"{name},{value}" if line.startswith(name) else line for line in write(kept).splitlines())
        made = plan(
            parse(text, "x"), {p.name: p for p in held.params}, sysid=actor.sysid, compid=1, stack=actor.vehicle.family
        )
        assert [(c.name, c.value) for c in made.changes] == [(name, value)] and made.warnings == ()
        outcomes = await actor.params.set({c.name: c.value for c in made.changes})
        assert outcomes[name].ok
        assert (await actor.params.get(name)).param is not None
        before = len(sent)
        again = await actor.params.load()
        assert {p.name: p.value for p in again.params}[name] == value
        if actor.vehicle.family == "ardupilot":
            assert again.source == "cache" and sent[before:].count("PARAM_REQUEST_READ") == 1


async def test_an_ardupilots_list_comes_as_a_file_with_what_is_set_meanwhile(tmp_path: Path) -> None:
    async with Field(tmp_path) as field:
        fleet, sent = field.fleet, field.sent
        px4, copter = fleet.resolve("1")[0], fleet.resolve("2")[0]
        before = len(sent)
        held = await copter.params.load(refresh=True)
        assert held.ok and held.message == f"{held.count} parameters, by file"
        assert set(sent[before:]) == {"FILE_TRANSFER_PROTOCOL"} and held.sent == sent[before:].count(MESSAGE)
        one = (await copter.params.get("SYSID_MYGCS")).param
        assert one in held.params
        thin = await copter.params.load(refresh=True, bytes_per_s=500.0)
        assert thin.params == held.params and thin.message.endswith("by file") and thin.elapsed_s > held.elapsed_s
        loading = asyncio.create_task(copter.params.load(refresh=True, bytes_per_s=150.0))
        await asyncio.sleep(1.0)
        await copter.params.set({"SYSID_MYGCS": 254})
        assert {p.name: p.value for p in (await loading).params}["SYSID_MYGCS"] == 254
        assert "by file" not in (await px4.params.load(refresh=True)).message


async def test_a_file_that_does_not_come_is_read_one_by_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skygcs.sim.copter_files.PATH", b"@PARAM/else")
    async with Field(tmp_path) as field:
        fleet, sent = field.fleet, field.sent
        (copter,) = fleet.resolve("2")
        held = await copter.params.load(refresh=True)
        assert held.ok and held.count == len(held.params) > 30
        assert "not by file: it could not be opened: it has no such file" in held.message
        assert sent.count("PARAM_REQUEST_READ") >= len(held.params)


async def test_a_file_that_is_cancelled_is_not_read_another_way(tmp_path: Path) -> None:
    async with Field(tmp_path) as field:
        fleet, sent = field.fleet, field.sent
        (copter,) = fleet.resolve("2")
        before = len(sent)
        loading = asyncio.create_task(copter.params.load(refresh=True, bytes_per_s=150.0))
        await asyncio.sleep(2.0)
        assert copter.params.cancel() == 1
        assert (await loading).result == "cancelled" and "PARAM_REQUEST_READ" not in sent[before:]
        assert (await copter.params.load(refresh=True)).ok  # its session was closed
