"""Flight control over an emulated radio: it takes what the plan leaves, and gives it back."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.core.radio_link.stream_rates import CONTROLLED, NORMAL, POSITION
from skygcs.runtime.vehicle_actor import VehicleActor
from support.examples import covered_by_other_flights
from support.on_air import on_air

pytestmark = pytest.mark.looptime


@covered_by_other_flights
async def test_two_copters_flown_by_position_over_a_fast_radio_hold_and_step_within_the_plan(tmp_path: Path) -> None:
    async with on_air(tmp_path, px4=0, ardupilot=2, radio={"air_kbps": 250}, link={"stream_profile": "nav"}) as air:
        await air.settled(2)
        fleet = air.daemon.fleet
        reported = await fleet.orders.command_all("all", VehicleActor.takeoff, height_m=5.0, wait_s=90.0)
        assert all(o.ok for o in reported.values()), reported
        await air.until(lambda: all(s.motion.up_m > 4.5 for s in air.link.vehicles))
        await asyncio.sleep(8)
        reported = await fleet.orders.command_all("all", VehicleActor.control, mode="velocity")
        assert all(o.ok for o in reported.values()), reported
        await asyncio.sleep(15)
        status = air.air()
        assert [v["weight"] for v in status["vehicles"]] == [CONTROLLED, CONTROLLED]
        assert status["down"]["planned_bytes_per_s"] <= status["down"]["budget_bytes_per_s"]
        assert air.rates(1)[POSITION] == 10.0, "there is room for what velocity control asks for"
        sent = status["up"]["classes"]["setpoint"]["sent"]
        await asyncio.sleep(5)
        assert air.air()["up"]["classes"]["setpoint"]["sent"] > sent + 20
        assert air.radio.network.stats(0).overflow_bytes == 0
        reported = await fleet.orders.command_all("all", VehicleActor.control, mode="off")
        assert all(o.ok for o in reported.values()), reported
        await asyncio.sleep(20)
        assert [v["weight"] for v in air.air()["vehicles"]] == [NORMAL, NORMAL]
        assert air.rates(1)[POSITION] == air.rates(2)[POSITION] == 2.0
