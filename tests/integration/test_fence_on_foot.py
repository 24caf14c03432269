"""The fence of parameters on simulated vehicles of both firmwares: set, read back, and tested by carrying them out."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from pathlib import Path
from typing import Any

import pytest

from skygcs.sim.vehicle import SimVehicle
from support.flown import Flown
from support.grounded import on_the_ground

BOTH = pytest.mark.parametrize("name", ["v1", "v2"])
"""v1 is a PX4, v2 an ArduCopter."""


async def carry(sim: SimVehicle, to_east_m: float) -> None:
    """On foot, half a metre a second."""
    while abs(to_east_m - sim.motion.east_m) > 0.1:
        sim.motion.east_m += 0.1 if to_east_m > sim.motion.east_m else -0.1
        await asyncio.sleep(0.2)


async def armed(gcs: Flown, name: str) -> None:
    sim = gcs.sim(name)
    for delay in ("COM_DISARM_PRFLT", "DISARM_DELAY"):
        if (found := sim.params.find(delay)) is not None:
            found[1].value = 0  # a pilot pushes the throttle a bit
    if name == "v2":
        await gcs.done("vehicles.mode", targets=name, mode="LOITER")
    await gcs.done("vehicles.arm", targets=name)


def begin(gcs: Flown, name: str, **params: Any) -> asyncio.Task[Any]:
    return asyncio.create_task(gcs.outcome("fence.test", name, **params))


async def walk(gcs: Flown, name: str) -> None:
    await gcs.until(lambda: any(t.kind == "fence" and "carry" in t.text for t in gcs.told), 60.0)
    await asyncio.sleep(2)
    await carry(gcs.sim(name), 4.0)


def held(gcs: Flown, name: str) -> dict[str, float]:
    fences = ("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", "FENCE_ENABLE", "FENCE_ACTION", "FENCE_RADIUS")
    params = gcs.sim(name).params
    return {n: params[n] for n in (*fences, "FENCE_TYPE", "FENCE_ALT_MAX") if params.find(n) is not None}


def recorded(file: str | Path) -> dict[str, Any]:
    return dict(json.loads(Path(file).read_text()))


async def test_a_fence_parameter_that_is_no_number_is_an_outcome_in_words(tmp_path: Path) -> None:
    name = "FENCE_RADIUS"
    async with on_the_ground(tmp_path) as gcs:
        found = gcs.sim("v2").params.find(name)
        assert found is not None
        found[1].value = math.nan
        for method, params in (("fence.status", {}), ("fence.set", {"height_m": 20})):
            outcome = (await gcs(method, targets="v2", **params))["outcomes"]["v2"]
            assert not outcome["ok"] and f"{name} cannot be read: it says nan" in outcome["message"]
        assert held(gcs, "v2")["FENCE_ALT_MAX"] != 20


async def test_a_fence_is_set_by_parameters_and_read_back(tmp_path: Path) -> None:
    async with on_the_ground(tmp_path) as gcs:
        outcomes = (await gcs("fence.set", targets="all", radius_m=40, height_m=15, action="return"))["outcomes"]
        assert {o["message"] for o in outcomes.values()} == {"the fence is radius 40 m, height 15 m, action return"}
        assert held(gcs, "v1") == {"GF_ACTION": 3, "GF_MAX_HOR_DIST": 40, "GF_MAX_VER_DIST": 15}
        assert held(gcs, "v2") == {
            "FENCE_ENABLE": 1,
            "FENCE_ACTION": 1,
            "FENCE_RADIUS": 40,
            "FENCE_ALT_MAX": 15,
            "FENCE_TYPE": 7,
        }
        await gcs.done("fence.set", targets="all", height_m=0)
        reported = (await gcs("fence.status", targets="all"))["outcomes"]
        assert [reported[n]["fence"]["height_m"] for n in ("v1", "v2")] == [None, None]
        assert held(gcs, "v2")["FENCE_TYPE"] == 6
        assert reported["v2"]["fence"]["breached"] is False and reported["v2"]["fence"]["breaches"] == 0
        await gcs.done("fence.set", targets="all", action="none")
        reported = (await gcs("fence.status", targets="all"))["outcomes"]
        assert {o["message"].split(";")[0] for o in reported.values()} == {"the fence is off"}
        refused = await gcs.outcome("fence.set", "v2", action="terminate")
        assert refused["result"] == "refused" and "no fence action" in refused["message"]


@BOTH
async def test_the_walk_of_an_armed_vehicle_ends_with_what_its_fence_asks_for(tmp_path: Path, name: str) -> None:
    async with on_the_ground(tmp_path) as gcs:
        before = held(gcs, name)
        await armed(gcs, name)
        test = begin(gcs, name)
        await walk(gcs, name)
        reported = await test
        assert reported["ok"], reported
        record = recorded(reported["record"]["file"])
        assert record["breached"] and record["reacted"] and record["restored"] and record["armed"]
        assert 1.5 < record["breached_at_m"] < 4.5
        assert record["signs"], record
        assert held(gcs, name) == before
        assert Path(reported["record"]["file"]).parent == tmp_path / "logs"


@BOTH
async def test_a_test_that_is_cancelled_leaves_the_fence_as_it_was(tmp_path: Path, name: str) -> None:
    async with on_the_ground(tmp_path) as gcs:
        before = held(gcs, name)
        test = begin(gcs, name)
        await gcs.until(lambda: any(t.kind == "fence" for t in gcs.told), 60.0)
        assert held(gcs, name) != before
        for method, more in (("fence.test", {}), ("fence.set", {"radius_m": 9.0})):
            refused = await gcs.outcome(method, name, **more)
            assert refused["result"] == "refused" and "being tested" in refused["message"]
        test.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await test
        await gcs.until(lambda: held(gcs, name) == before, 20.0)
        (record,) = (tmp_path / "logs").glob("fence-test-*.json")
        assert recorded(record)["restored"]


@pytest.mark.deep
@BOTH
async def test_a_vehicle_beyond_the_fence_or_in_the_air_is_not_tested(tmp_path: Path, name: str) -> None:
    async with on_the_ground(tmp_path) as gcs:
        before = held(gcs, name)
        if name == "v2":  # a PX4 moves its home while it is disarmed
            gcs.sim(name).motion.north_m = 6.0
            await asyncio.sleep(3)
            reported = await begin(gcs, name)
            assert reported["result"] == "refused" and "set home where it stands" in reported["message"]
        await gcs.done("vehicles.takeoff", targets=name, height_m=5.0, wait_s=60.0)
        await asyncio.sleep(10)
        reported = await begin(gcs, name)
        assert reported["result"] == "refused" and "in the air" in reported["message"]
        assert held(gcs, name) == before and not list((tmp_path / "logs").glob("fence-test-*"))
