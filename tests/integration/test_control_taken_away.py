"""Flown by setpoints, and somebody or something takes the vehicle away: nothing is sent any more, nothing is fought."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.firmware_modes import CopterMode
from support.flown import KINDS, Flown, aloft, flown


def px4(gcs: Flown) -> bool:
    return gcs.actor().vehicle.family == "px4"


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("mode", ["attitude", "velocity"])
async def test_another_ground_station_takes_it_home_in_mid_step(
    tmp_path: Path, kind: dict[str, int], mode: str
) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.in_mid_step(mode)
        taken = gcs.now
        gcs.other_sets_mode(4, 5) if px4(gcs) else gcs.other_sets_mode(int(CopterMode.RTL))
        await gcs.until(lambda: gcs.control()["state"] == "off", 2.0)
        assert gcs.last_setpoint() < taken + 1.2, "a heartbeat tells of it"
        await asyncio.sleep(60)
        assert not gcs.commands(taken), "it was fought"
        assert gcs.last_setpoint() < taken + 1.2
        (reported,) = gcs.texts(taken)
        assert reported.startswith("control ended: the autopilot left the mode")
        assert gcs.sim().motion.on_ground and not gcs.sim().armed
        assert gcs.farthest_m(taken) < 40.0  # the return's climb


@KINDS
async def test_disarmed_by_somebody_else(tmp_path: Path, kind: dict[str, int]) -> None:
    async with flown(tmp_path, height_m=3.0, **kind) as gcs:
        await gcs.fly("attitude")
        gone = gcs.now
        gcs.by_other_station(mav.MAVLink_command_long_message(1, 1, 400, 0, 0, 21196, 0, 0, 0, 0, 0))
        await asyncio.sleep(8)
        assert gcs.last_setpoint() < gone + 1.2
        assert gcs.commands(gone) == [], (
            "both firmwares report a disarmed vehicle on the ground: nothing is left to hold"
        )
        reported = gcs.texts(gone)
        assert reported[0].startswith("control ended: the vehicle is on the ground")
        assert gcs.sim().motion.on_ground and not gcs.sim().armed


@KINDS
async def test_rebooted_in_flight(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, height_m=3.0, **kind) as gcs:
        await gcs.fly("attitude")
        await gcs.step(2.0, 0.0, 0.0)
        await asyncio.sleep(0.5)
        gone = gcs.now
        gcs.sim().faults.reboot = True
        await asyncio.sleep(20)
        assert gcs.last_setpoint() < gone + 2.6
        assert gcs.sim().motion.on_ground and not gcs.sim().armed
        assert gcs.control()["state"] == "off"
        ends = [t for t in gcs.texts(gone) if t.startswith(("control ended", "holding"))]
        assert 1 <= len(ends) <= 2, ends
        assert not [c for c in gcs.commands(gone) if int(c.values["command"]) == 400]


async def test_a_second_vehicle_of_its_id_elsewhere_ends_nothing(tmp_path: Path) -> None:
    """State and setpoints have one channel; the flight goes on, and nobody else may be taken over by the id."""
    async with aloft(tmp_path) as gcs:
        await gcs.fly("attitude")
        await gcs.step(2.0, 0.0, 0.0)
        seen = gcs.now
        gcs.daemon.fleet.set_duplicate(1 << 8 | 1, "on udp and on radio")
        await asyncio.sleep(5)
        assert gcs.texts(seen) == []
        assert gcs.control()["state"] == "flying" and gcs.last_setpoint() > gcs.now - 0.5
        assert (await gcs.outcome("control.set", mode="off"))["ok"], "it is told to hold"
        outcome = await gcs.outcome("control.set", mode="position")
        assert outcome["result"] == "refused" and "two vehicles" in outcome["message"]


async def test_it_is_heard_in_a_recording_instead(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.fly("attitude")
        order = asyncio.create_task(gcs.actor().offboard.engage(gcs.actor().offboard.controller.wanted))
        await asyncio.sleep(0)
        seen = gcs.now
        gcs.daemon.hub.replayed.add(1 << 8 | 1)
        gcs.daemon.fleet.source_changed(1 << 8 | 1)
        assert not (await order).ok
        await asyncio.sleep(5)
        assert not gcs.setpoints(seen)
