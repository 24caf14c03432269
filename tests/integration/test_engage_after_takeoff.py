"""Control that begins by itself after a take-off: only after one ordered here, at its height, undisturbed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from skygcs.sim.firmware_modes import CopterMode
from support.flown import KINDS, Flown, aloft


@asynccontextmanager
async def grounded(tmp_path: Path, mode: str | None, **kind: int) -> AsyncIterator[Flown]:
    """Landed again, disarmed, before the take-off that counts."""
    control: dict[str, Any] = {} if mode is None else {"engage_after_takeoff": mode}
    async with aloft(tmp_path, control=control, height_m=4.0, **kind) as gcs:
        await gcs.lands()
        yield gcs


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("mode", ["position", "velocity", "attitude"])
async def test_control_begins_at_the_height(tmp_path: Path, kind: dict[str, int], mode: str) -> None:
    async with grounded(tmp_path, mode, **kind) as gcs:
        since = gcs.now
        await gcs.done("vehicles.takeoff", height_m=8.0, wait_s=30.0)
        at = await gcs.until(lambda: gcs.control()["state"] == "flying", 60.0)
        assert gcs.place()[2] > 7.0
        assert gcs.setpoints(since)[0].at > since + 2.0
        await asyncio.sleep(3.0)
        assert gcs.control()["mode"] == mode and gcs.farthest_m(at) < 1.0


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("disturbance", ["hold", "land", "off", "pilot", "lost"])
async def test_a_disturbed_take_off_is_left_alone(tmp_path: Path, kind: dict[str, int], disturbance: str) -> None:
    async with grounded(tmp_path, "position", **kind) as gcs:
        since = gcs.now
        await gcs.done("vehicles.takeoff", height_m=15.0, wait_s=30.0)
        await gcs.until(lambda: gcs.place()[2] > 4.0)
        match disturbance:
            case "pilot":
                if kind["px4"]:
                    gcs.other_sets_mode(4, 3)  # AUTO.LOITER, below the height
                else:
                    gcs.other_sets_mode(CopterMode.LOITER)
            case "lost":
                gcs.cut = True
            case "off":
                await gcs.done("control.set", mode="off")
            case _:
                await gcs.done(f"vehicles.{disturbance}")
        await asyncio.sleep(30.0)
        assert gcs.control()["state"] == "off" and not gcs.setpoints(since)
        told = [t for t in gcs.texts(since) if "not engaged after the take-off" in t]
        assert len(told) == (disturbance in ("pilot", "lost")), gcs.texts(since)


@pytest.mark.deep
async def test_a_take_off_that_was_not_ordered_here_is_none(tmp_path: Path) -> None:
    async with grounded(tmp_path, "position", px4=1) as gcs:
        since = gcs.now
        sim = gcs.sim()
        gcs.other_sets_mode(4, 2)  # AUTO.TAKEOFF by another station
        await asyncio.sleep(30.0)
        assert not gcs.setpoints(since), sim.mode
