"""We hear the vehicles and they do not hear us: it is reported before their own failsafe acts."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.sim.firmware_modes import CopterMode
from support.flown import aloft


@pytest.mark.deep
@pytest.mark.parametrize("kind", [{"px4": 1, "ardupilot": 0}, {"px4": 0, "ardupilot": 1}], ids=str)
async def test_it_is_told_before_the_vehicle_acts_and_when_it_is_over(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, params={"FS_GCS_ENABLE": 1.0}, **kind) as gcs:
        await asyncio.sleep(20)
        (state,) = await gcs("vehicles.list", targets="all")
        assert state["uplink"]["heard"] is True and state["uplink"]["rtt_s"] < 0.5
        began = gcs.now
        gcs.deaf = True
        reported = await gcs.until(lambda: any(t.kind == "uplink_lost" for t in gcs.told), 10.0)
        assert reported - began < 4.0, "the failsafe of an ArduCopter takes 5 s"
        assert gcs.sim().mode != CopterMode.RTL and gcs.actor().vehicle.connected
        (state,) = await gcs("vehicles.list", targets="all")
        assert state["uplink"]["heard"] is False
        await asyncio.sleep(20)
        assert len([t for t in gcs.told if t.kind == "uplink_lost"]) == 1
        gcs.deaf = False
        await gcs.until(lambda: any(t.kind == "uplink_back" for t in gcs.told), 10.0)
        (state,) = await gcs("vehicles.list", targets="all")
        assert state["uplink"]["heard"] is True
