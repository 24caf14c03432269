"""A plan of two vehicles, one flown by its companion and one by the ground, on one clock."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from skygcs.sim.firmware_modes import Px4Mode
from support.called import plans_of
from support.companion_pair import Pair, companion_pair
from support.daemons import simulated_link
from support.planned import Places, content, inline, timed

STARTS: Places = {"v1": (0.0, 0.0, 10.0), "v2": (0.0, 30.0, 10.0)}
GOALS: Places = {"v1": (24.0, 0.0, 10.0), "v2": (24.0, 30.0, 10.0)}


@asynccontextmanager
async def two(tmp_path: Path, **kinds: Any) -> AsyncIterator[Pair]:
    """v1 behind its companion, v2 behind the ground's own link, both in the air."""
    wide = {"fence": {"x_m": [-60, 60], "y_m": [-60, 60], "up_m": [0, 40]}}
    own = {"type": "simulated", "role": "vehicle", "px4": 1, "first_sysid": 2, "lat_deg": 43.7806 + 30.0 / 111_120}
    async with companion_pair(tmp_path, control=wide, ground_links={"own": own}, **kinds) as pair:
        await pair.until(lambda: len(pair.ground.fleet.vehicles) == 2)
        await asyncio.sleep(8)
        await pair.done("vehicles.takeoff", targets="v2", height_m=10.0, wait_s=90.0)
        await asyncio.sleep(15)
        yield pair


async def run(pair: Pair) -> None:
    plans_of(pair.ground).runner.work = inline
    await pair("plan.load", plan=content(timed(STARTS, GOALS)), name="test")
    answer = await pair("plan.run", margin_m=3.0, force=True)
    refused = [f for f in answer["report"]["findings"] if f["severity"] == "refused"]
    assert answer["started"], refused


def state(pair: Pair) -> str:
    return str(pair.ground.fleet.plans.status()["state"])


def second(pair: Pair) -> tuple[float, float]:
    """Where v2 is, along and across."""
    link = simulated_link(pair.ground, "own")
    motion = link.vehicles[0].motion
    return motion.east_m, motion.north_m


async def flies(pair: Pair) -> None:
    """Until the plan's own step has led v1 a few metres."""
    await pair.until(lambda: state(pair) == "flying" and pair.pi.place()[0] > 6.0, 90.0)


@pytest.mark.parametrize("delay_s", [0.02, 0.4])
async def test_both_fly_one_plan_on_one_clock(tmp_path: Path, delay_s: float) -> None:
    async with two(tmp_path, delay_s=delay_s, loss=0.04) as pair:
        await run(pair)
        await flies(pair)
        await pair("plan.pause")
        await pair.until(lambda: pair.ground.fleet.plans.status()["clock"]["state"] == "paused", 20.0)
        await asyncio.sleep(4)
        ours, theirs = second(pair), pair.pi.place()
        assert theirs[0] == pytest.approx(ours[0], abs=0.5), "both stopped at the same time of the plan"
        answer = await pair("plan.resume")
        assert answer["ok"], answer
        await pair.until(lambda: state(pair) == "finished", 90.0)
        assert math.dist(pair.pi.place(), GOALS["v1"]) < 1.0


async def test_ground_killed_in_mid_plan_ends_as_configured(tmp_path: Path) -> None:
    async with two(tmp_path, companion={"ground_lost": "finish"}) as pair:
        await run(pair)
        await flies(pair)
        await pair.lose_ground()
        await pair.until(lambda: pair.pi.place()[0] > 23.0, 40.0)
        await pair.until(lambda: pair.pi.sim().mode == Px4Mode.RTL, 40.0)


async def test_companion_killed_in_mid_plan_stops_the_others(tmp_path: Path) -> None:
    async with two(tmp_path, params={"COM_OF_LOSS_T": 1.0}, radio=True) as pair:
        await run(pair)
        await flies(pair)
        await pair.lose_companion()
        await pair.until(lambda: state(pair) == "stopped", 15.0)
        await asyncio.sleep(6)
        here = second(pair)
        await asyncio.sleep(5)
        assert math.dist(here, second(pair)) < 0.3, "v2 stands"
