"""A formation that flies in gusts for a long time, as near to each other as the monitor leaves without a word."""

from __future__ import annotations

import asyncio
import statistics
from pathlib import Path
from typing import Any

from skygcs.core.separation import Footprint
from skygcs.sim.conditions import Conditions
from support.encounters import MARGIN
from support.flown import Flown, flown

GUSTY = Conditions(wind_enu_mps=(3.0, 1.0, 0.0), gust_mps=0.5)
CLEARANCE = 1.2
LEG_M = 40.0
LEG_S = 30.0
AGES_S = 20.0


async def fly_formation(folder: Path, *, minutes: float, vehicles: int = 4) -> dict[str, Any]:
    """Squares of `LEG_M`, ordered with `goto all`, `CLEARANCE` times the margin and the balls at p95 age apart."""
    async with flown(folder, px4=vehicles, height_m=20.0, delay_s=0.05, conditions=GUSTY) as gcs:
        names = [f"v{i + 1}" for i in range(vehicles)]
        age_s = await _age_p95_s(gcs, names)
        spacing_m = CLEARANCE * (MARGIN.total_m + 2 * Footprint().ball_m(age_s))
        _put(gcs, names, spacing_m)
        await asyncio.sleep(20.0)
        begun, told = gcs.now, len(gcs.told)
        corners = [(LEG_M, 0.0), (LEG_M, LEG_M), (0.0, LEG_M), (0.0, 0.0)]
        legs = 0
        while gcs.now < begun + 60.0 * minutes:
            east, north = corners[legs % 4]
            await gcs.done("vehicles.goto", targets="all", enu_m=[east, north, 20.0])
            legs += 1
            await asyncio.sleep(LEG_S)
        events = [f"{t.at - begun:.0f} s: {t.text}" for t in gcs.told[told:] if t.kind == "separation"]
        return {
            "vehicles": vehicles,
            "minutes": minutes,
            "legs": legs,
            "spacing_m": round(spacing_m, 2),
            "age_p95_s": round(age_s, 3),
            "events": events,
        }


def _put(gcs: Flown, names: list[str], spacing_m: float) -> None:
    """On a square grid, at rest."""
    for i, name in enumerate(names):
        sim, home = gcs.sim(name), gcs.place_of_home(name)
        sim.motion.east_m = spacing_m * (i % 2) - home[0]
        sim.motion.north_m = spacing_m * (i // 2) - home[1]
        sim.hold_here()


async def _age_p95_s(gcs: Flown, names: list[str]) -> float:
    """The 95th percentile of the ages of the positions, over a few seconds."""
    ages: list[float] = []
    end = gcs.now + AGES_S
    while gcs.now < end:
        for name in names:
            at = gcs.actor(name).vehicle.telemetry_at("position")
            if at is not None:
                ages.append(gcs.now - at)
        await asyncio.sleep(0.013)
    return statistics.quantiles(ages, n=20)[-1]
