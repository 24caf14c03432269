"""An order to return is checked along the way home that it gives, whatever the vehicle did before it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.runtime.returns import SAME_S
from skygcs.sim.firmware_modes import Px4Mode
from support.flown import aloft
from support.planned import MARGIN_M, least_distance

COSTS = "returns of two vehicles, from each state in which one may be"

GOES_ON = "it goes on in {}, as its way home is not clear of v2, and does not return; ordered again"

BEFORE = {
    "hold": "it holds until v2 is out of its way home",
    "land": GOES_ON.format("AUTO.LAND"),
    "failsafe": GOES_ON.format("AUTO.LOITER"),
    "rtl": "returning to launch",
}
"""What v1 does before it is ordered to return across v2, and the answer."""


@pytest.mark.parametrize("before", BEFORE)
async def test_it_does_not_fly_home_across_another_unless_it_does_already_or_is_insisted(
    tmp_path: Path, before: str
) -> None:
    """One that landed, or was in a failsafe, was sent home at once, across one that landed: .53 m (random flight
    2126)."""
    async with aloft(tmp_path, px4=2) as gcs:
        x, y, _ = gcs.place_of_home("v1")
        await gcs.done("vehicles.goto", targets="v1", enu_m=[x - 20.0, y, 12.0], force=True)
        await gcs.done("vehicles.goto", targets="v2", enu_m=[x - 10.0, y, 12.0], force=True)
        await asyncio.sleep(20.0)
        await gcs.done("vehicles.land", targets="v2")
        if before == "failsafe":
            gcs.sim("v1").failsafe = True
        else:
            await gcs.done(f"vehicles.{before}", targets="v1")
        await asyncio.sleep(1.2)
        if before == "rtl":  # it waits, and is insisted on
            await gcs.done("vehicles.rtl", targets="v1")
            await gcs.until(lambda: gcs.actor("v1").vehicle.mode == "AUTO.RTL", 2.0)
        since = gcs.now
        for _ in range(2):  # a double click is one order
            outcome = await gcs.outcome("vehicles.rtl", "v1")
            assert outcome["message"].startswith(BEFORE[before]), outcome
        if before == "rtl":
            return
        assert gcs.sim("v1").mode != Px4Mode.RTL
        await asyncio.sleep(SAME_S)
        assert least_distance(gcs, since)[0] > MARGIN_M
        assert (await gcs.outcome("vehicles.rtl", "v1"))["ok"]
        await gcs.until(lambda: gcs.sim("v1").mode == Px4Mode.RTL, 2.0)
