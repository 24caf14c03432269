"""What an ArduCopter does when its ground station is lost after our hold, our stop, or our end.

The simulator follows ArduCopter/events.cpp and mode.h (4.6): FS_OPTIONS has bit 4 by default, and BRAKE counts as a
mode of a pilot.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.sim.firmware_modes import CopterMode
from support.flown import Flown, aloft

WATCHED = {"FS_GCS_ENABLE": 1.0}


async def lost(gcs: Flown) -> CopterMode:
    """The station is gone for long enough; the mode it is in then."""
    gcs.cut = True
    await asyncio.sleep(8)
    return CopterMode(gcs.sim().mode)


async def test_after_a_hold_its_failsafe_brings_it_back(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=1, params=WATCHED) as gcs:
        await gcs.step(30.0, 0.0, 0.0)
        await asyncio.sleep(2)
        since = gcs.now
        await gcs.done("vehicles.hold")
        await asyncio.sleep(5)
        assert gcs.sim().mode == CopterMode.GUIDED and gcs.is_safe()
        assert gcs.farthest_m(since) < 12.0, "it flew on to its target"
        assert await lost(gcs) == CopterMode.RTL


async def test_after_a_stop_it_stays_while_the_option_is_set(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=1, params=WATCHED) as gcs:
        await gcs.done("vehicles.stop", action="hold")
        assert await lost(gcs) == CopterMode.BRAKE


async def test_after_a_stop_it_comes_back_once_the_option_is_gone(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=1, params={**WATCHED, "FS_OPTIONS": 0.0}) as gcs:
        await gcs.done("vehicles.stop", action="hold")
        assert await lost(gcs) == CopterMode.RTL


@pytest.mark.parametrize("mode", ["attitude", "velocity", "position"])
@pytest.mark.parametrize("delay_s", [0.01, 0.2])
async def test_after_our_end_in_flight_it_holds_and_comes_back(tmp_path: Path, mode: str, delay_s: float) -> None:
    if mode != "position" and delay_s > 0.1:
        pytest.skip("the guard lets no such delay fly by attitude, and velocity is flown by position")
    async with aloft(tmp_path, px4=0, ardupilot=1, params=WATCHED, delay_s=delay_s) as gcs:
        await gcs.fly(mode)
        await gcs.step(10.0, 0.0, 0.0)
        await asyncio.sleep(1)
        since = gcs.now
        await gcs.stopped(6.0)
        await asyncio.sleep(3)
        assert gcs.sim().mode == CopterMode.GUIDED and gcs.farthest_m(since) < 8.0
        assert await lost(gcs) == CopterMode.RTL
        gcs.sent.clear()


async def test_the_operator_is_told_what_brake_means_for_its_failsafe(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=1, params=WATCHED) as gcs:
        await gcs.fly("attitude")
        assert any("FS_OPTIONS is 16" in text and "BRAKE" in text for text in gcs.texts(0.0, "warning"))
