"""Plans over a link that loses 5 % of all and has gaps of a second: flown to the end, if need be by resuming, and never
too near. A PX4 leaves OFFBOARD after COM_OF_LOSS_T, 1 s by default: it is set to 3 s, as such a link asks for."""

from __future__ import annotations

import asyncio
import math
import random
from pathlib import Path

import pytest

from support.flown import Flown, flown
from support.planned import MARGIN_M, above, least_distance, north, phased, plan_events, run, state, timed

LOSSY = {"type": "memory", "role": "radio", "loss": 0.05, "delay_s": 0.06, "jitter_s": 0.05}

GAP_S = 1.0


async def gaps(gcs: Flown, seed: int) -> None:
    """Every 8 to 15 s nothing passes for a second."""
    rng = random.Random(seed)
    while True:
        await asyncio.sleep(rng.uniform(8.0, 15.0))
        gcs.cut = True
        await asyncio.sleep(GAP_S)
        gcs.cut = False


async def to_the_end(gcs: Flown, seconds: float) -> int:
    """Resumed whenever it was stopped; how often."""
    stops, end = 0, gcs.now + seconds
    while state(gcs) != "finished":
        assert gcs.now < end and state(gcs) not in ("aborted", "landed"), plan_events(gcs)
        if state(gcs) == "stopped":
            stops += 1
            await asyncio.sleep(6.0)
            try:
                await gcs("plan.resume")
            except Exception as error:
                if "before it flew" in str(error):
                    await gcs("plan.abort")
                    await gcs.until(lambda: state(gcs) == "aborted", 20.0)
                    await asyncio.sleep(6.0)
                    await gcs("plan.run", margin_m=MARGIN_M, force=True)
                else:
                    assert "wait" in str(error) or "under way" in str(error), error
        await asyncio.sleep(0.5)
    return stops


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["timed", "phased"])
async def test_five_per_cent_loss_and_gaps_of_a_second(tmp_path: Path, kind: str, seed: int) -> None:
    links = {"air": {**LOSSY, "seed": seed}}
    async with flown(tmp_path, px4=2, ardupilot=2, takeoff=False, links=links, params={"COM_OF_LOSS_T": 3.0}) as gcs:
        places = above(gcs)
        goals = north(places, 15.0)
        if kind == "phased":
            heights = {"v1": 8.0, "v2": 14.0, "v3": 8.0, "v4": 14.0}
            pairs = {"v1": "v2", "v2": "v1", "v3": "v4", "v4": "v3"}
            goals = {name: (*places[other][:2], heights[name]) for name, other in pairs.items()}
            climb = {name: (*places[name][:2], heights[name]) for name in places}
            plan = phased(above(gcs, up_m=0.0), ("climb", climb), ("cross", goals))
        else:
            plan = timed(places, goals)
        bad = asyncio.create_task(gaps(gcs, seed))
        try:
            began = gcs.now
            await run(gcs, plan)
            await to_the_end(gcs, 420.0)
        finally:
            bad.cancel()
            gcs.cut = False
        await asyncio.sleep(8.0)
        for name, goal in goals.items():
            assert math.dist(gcs.place(name), goal) < 1.0
        assert least_distance(gcs, began)[0] > MARGIN_M, least_distance(gcs, began)
