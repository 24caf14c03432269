"""A session as a lab flies it on any day, nine vehicles from pads 3 to 5 m apart: no distance is refused.

The other side of `test_monitor.py`: orders that keep a distance are not to be insisted on, or people learn to.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from skygcs.config.models import FleetConfig
from skygcs.core.mavlink import mav_cmd
from skygcs.ext.formation.config import FormationConfig
from skygcs.sim import vehicle_group
from skygcs.sim.conditions import conditions_of
from support.flown import FIELD, Flown, flown
from support.made_files import waypoints
from support.planned import MARGIN_M
from support.random_orders import apart_m

COSTS = "nine vehicles fly from their pads and home again, three times"

PADS = pytest.mark.parametrize("pads_m", [3.0, 3.5, 5.0])

LOW: dict[str, float] = {"RTL_RETURN_ALT": 8.0, "RTL_ALT": 800.0}

KINDS = pytest.mark.parametrize(
    "kind", [{"px4": 9}, {"px4": 0, "ardupilot": 9}, {"px4": 5, "ardupilot": 4}], ids=["px4", "ardupilot", "both"]
)


async def up(gcs: Flown, names: str = "all") -> None:
    await gcs.done("vehicles.takeoff", targets=names, height_m=8.0, wait_s=90.0)
    flying = gcs.sims if names == "all" else [gcs.sim(name) for name in names.split(",")]
    await gcs.until(lambda: all(abs(sim.motion.up_m - 8.0) < 0.6 for sim in flying), 60.0)
    await asyncio.sleep(3.0)


async def down(gcs: Flown) -> None:
    await gcs.until(lambda: not any(sim.armed for sim in gcs.sims), 400.0)
    await asyncio.sleep(3.0)


async def to_a_grid(gcs: Flown, pads_m: float) -> None:
    """Each by an order of its own, without waiting for the others: those in front first, the outer ones first."""
    for sim in sorted(gcs.sims, key=lambda sim: (sim.sysid > 5, -sim.sysid)):
        east, north, _ = gcs.place_of_home(f"v{sim.sysid}")
        there = [east * 5.0 / pads_m, 20.0 + north * 8.0 / pads_m, 8.0 + 2.0 * (sim.sysid > 5)]
        await gcs.done("vehicles.goto", targets=f"v{sim.sysid}", enu_m=there)
        await asyncio.sleep(3.0)
    await asyncio.sleep(15.0)
    # and elsewhere, all together, while they still fly
    await gcs.done("vehicles.goto", targets="all", enu_m=[10.0, 10.0, 10.0])
    await asyncio.sleep(1.5)
    await gcs.done("vehicles.goto", targets="all", enu_m=[10.0, 25.0, 9.0])


async def in_formation(gcs: Flown) -> None:
    for name in ("v1", "v2", "v3"):
        await gcs.fly("position", name)
    await gcs("formation.start", targets=["v1", "v2", "v3"], shape="line", spacing_m=6.0, heading_deg=0.0)
    await asyncio.sleep(15.0)
    await gcs("formation.move", to_enu_m=[3.5, 12.0, 8.0])
    await asyncio.sleep(15.0)
    await gcs("formation.stop")
    await asyncio.sleep(3.0)
    await gcs.done("vehicles.hold", targets="v1,v2,v3")


async def survey(gcs: Flown) -> None:
    """Three vehicles, each with a strip of its own beside that of the next one, from the ground and home."""
    for n, name in enumerate(("v1", "v2", "v3")):
        pad, east = gcs.place_of_home(name)[:2], 6.0 * n
        places = [pad, (east + 3.0, 10.0), (east + 3.0, 30.0), (east, 30.0), (east, 10.0)]
        rows = [(3, mav_cmd.NAV_WAYPOINT, 0, 0, 0, 0, *FIELD.to_geodetic(*place), 8.0) for place in places]
        rows[0] = (3, mav_cmd.NAV_TAKEOFF, *rows[0][2:])
        rows.append((3, mav_cmd.NAV_RETURN_TO_LAUNCH, 0, 0, 0, 0, 0, 0, 0))
        await gcs.done("missions.upload", targets=name, plan=waypoints(*rows).decode())
    await gcs.done("missions.start", targets="v1,v2,v3")
    await asyncio.sleep(30.0)


def _with_formation(config: FleetConfig) -> FleetConfig:
    return config.model_copy(update={"extensions": {"formation": FormationConfig()}})


@KINDS
@PADS
async def test_nothing_of_an_ordinary_session_is_refused_for_its_distance(
    tmp_path: Path, kind: dict[str, int], pads_m: float
) -> None:
    fence = {"fence": {"x_m": (-60.0, 60.0), "y_m": (-60.0, 60.0), "up_m": (0.0, 40.0)}}
    options: dict[str, Any] = {"takeoff": False, "prepared": _with_formation, "control": fence, "params": LOW}
    conditions = conditions_of(wind_mps=2.0, wind_from_deg=240.0)
    with mock.patch.object(vehicle_group, "SPACING_M", pads_m):
        async with flown(tmp_path, setpoints_end=False, conditions=conditions, **options, **kind) as gcs:
            await up(gcs)
            await to_a_grid(gcs, pads_m)
            await asyncio.sleep(15.0)
            await gcs.done("vehicles.rtl", targets="all")
            await down(gcs)
            await up(gcs, "v1,v2,v3")
            await in_formation(gcs)
            await gcs.done("vehicles.rtl", targets="v1,v2,v3")
            await down(gcs)
            await survey(gcs)
            await down(gcs)
            await up(gcs, "v1,v4,v7")
            await gcs.done("vehicles.land", targets="all")
            await down(gcs)
            counters = (await gcs("monitor.status"))["counters"]
            assert counters["orders_checked"] > 40 and counters["orders_refused"] == 0, counters
            aloft = [looks for looks in zip(*gcs.truth.values(), strict=False)]
            near = min(
                apart_m(a, b)
                for looks in aloft
                for n, a in enumerate(looks)
                for b in looks[n + 1 :]
                if not (a.landed or b.landed)
            )
            assert near > MARGIN_M - 0.5, near
