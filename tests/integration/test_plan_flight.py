"""Plans in a whole daemon, from the ground to their end, and each way in which a flight is stopped."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from support.flown import Flown, flown
from support.planned import MARGIN_M, UP_M, least_distance, run, state, timed

pytestmark = pytest.mark.looptime

KINDS = pytest.mark.parametrize("kind", [{"px4": 2}, {"px4": 0, "ardupilot": 2}], ids=["px4", "ardupilot"])


def crossing(gcs: Flown) -> tuple[dict[str, Any], dict[str, Any]]:
    """Two vehicles side by side that fly 12 m to the north, one beside the other."""
    places = {f"v{sim.sysid}": gcs.place_of_home(f"v{sim.sysid}") for sim in gcs.sims}
    starts = {name: (x, y, UP_M) for name, (x, y, _) in places.items()}
    return starts, {name: (x, y + 12.0, UP_M) for name, (x, y, _) in places.items()}


@KINDS
async def test_a_timed_plan_is_flown_from_the_ground_to_its_end(tmp_path: Path, kind: dict[str, int]) -> None:
    async with flown(tmp_path, **kind, takeoff=False) as gcs:
        starts, goals = crossing(gcs)
        began = gcs.now
        await run(gcs, timed(starts, goals))
        await gcs.until(lambda: state(gcs) in ("finished", "stopped", "aborted"), 180.0)
        assert state(gcs) == "finished"
        await asyncio.sleep(8.0)
        for name, goal in goals.items():
            assert math.dist(gcs.place(name), goal) < 0.7
            assert gcs.is_safe(name)
        assert least_distance(gcs, began)[0] > MARGIN_M
