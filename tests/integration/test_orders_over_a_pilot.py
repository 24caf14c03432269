"""An order is neither repeated nor gone on with once a pilot has the vehicle; one that ends the flight is."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mission.item import MissionItem
from skygcs.core.mission.plan import MissionPlan
from skygcs.core.mission.qgc import write_qgc
from skygcs.sim.firmware_modes import CopterMode
from support.flown import FIELD, flown
from support.table import each

pytestmark = pytest.mark.looptime


@each(
    ("order", "params", "ends_in"),
    [
        ("vehicles.mode", {"mode": "GUIDED"}, "LOITER"),
        ("vehicles.goto", {"enu_m": [5.0, 5.0, 12.0]}, "LOITER"),
        ("missions.start", {}, "LOITER"),
        ("vehicles.land", {}, "LAND"),
        ("vehicles.rtl", {}, "RTL"),
    ],
)
async def test_who_has_it_after_an_order_that_was_not_heard(
    tmp_path: Path, order: str, params: dict[str, Any], ends_in: str
) -> None:
    async with flown(tmp_path, px4=0, ardupilot=1) as gcs:
        gcs.other_sets_mode(CopterMode.BRAKE)
        await gcs.until(lambda: gcs.actor().vehicle.mode == "BRAKE", 10.0)
        gcs.deaf = True
        ordered = asyncio.create_task(gcs.outcome(order, **params))
        await asyncio.sleep(0.1)
        gcs.other_sets_mode(CopterMode.LOITER)
        await gcs.until(lambda: gcs.actor().vehicle.mode == "LOITER", 10.0)
        gcs.deaf = False
        outcome = await ordered
        await asyncio.sleep(5.0)
        assert gcs.actor().vehicle.mode == ends_in, outcome
        if ends_in == "LOITER":
            assert "not sent again, because it was switched to LOITER" in outcome["message"]


async def test_a_step_that_follows_is_not_sent_to_him(tmp_path: Path) -> None:
    """The mission was begun: its item was chosen, and the answer came when he had it already."""
    async with flown(tmp_path, px4=0, ardupilot=1) as gcs:
        items = (
            MissionItem.from_params(16, 3, (0.0, 0.0, 0.0, None, *FIELD.to_geodetic(0.0, y), 10.0), True)
            for y in (9, 18)
        )
        await gcs.done("missions.upload", plan=write_qgc(MissionPlan(tuple(items))))
        gcs.other_sets_mode(CopterMode.BRAKE)
        await gcs.until(lambda: gcs.actor().vehicle.mode == "BRAKE", 10.0)
        await asyncio.sleep(0.5)
        gcs.uplink_delay_s = 0.9  # a heartbeat comes first, and nothing is repeated yet
        ordered = asyncio.create_task(gcs.outcome("missions.start"))
        await asyncio.sleep(0.0)
        gcs.other_sets_mode(CopterMode.LOITER)
        outcome = await ordered
        await asyncio.sleep(5.0)
        assert gcs.actor().vehicle.mode == "LOITER", outcome
        assert "mode AUTO: refused: it was switched to LOITER since" in outcome["message"]


@each(("mode", "arms", "why"), [(CopterMode.LOITER, False, "switched to"), (CopterMode.STABILIZE, True, "armed in")])
async def test_a_take_off_is_not_tried_again_once_he_has_it(
    tmp_path: Path, mode: CopterMode, arms: bool, why: str
) -> None:
    """It armed and took off from under him as soon as it heard us."""
    async with flown(tmp_path, px4=0, ardupilot=1, takeoff=False) as gcs:
        assert gcs.actor().vehicle.mode == "STABILIZE"
        gcs.deaf = True
        ordered = asyncio.create_task(gcs.outcome("vehicles.takeoff", wait_s=30.0))
        await asyncio.sleep(8.0)
        gcs.other_sets_mode(mode)
        if arms:
            gcs.by_other_station(mav.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
        await asyncio.sleep(8.0)
        gcs.deaf = False
        outcome = await ordered
        await asyncio.sleep(3.0)
        assert gcs.actor().vehicle.mode == mode.name and gcs.sim().landed, outcome
        assert f"refused: it was {why} {mode.name} since" in outcome["message"]
