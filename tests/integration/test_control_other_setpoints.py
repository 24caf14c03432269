"""Setpoints by hand, and orders given too early, beside flight control."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import RefusedError
from skygcs.runtime.vehicle_actor import VehicleActor
from support.called import sender_of
from support.daemons import made_daemon
from support.flown import aloft

BY_HAND: dict[str, Any] = {"coordinate_frame": 1, "type_mask": 0xDC7, "vx": 1.0}


async def test_no_setpoint_by_hand_goes_to_a_vehicle_that_is_flown_by_ours(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=1) as gcs:
        await gcs.fly("velocity")
        send = sender_of(gcs.daemon).send
        for to in ({"target": "v1"}, {"target": "all"}, {"link": "air"}, {}):
            fields = {"target_system": 0} if not to else {}
            with pytest.raises(RefusedError, match="v1 is flown by setpoints of skygcs"):
                send("SET_POSITION_TARGET_LOCAL_NED", {**BY_HAND, **fields}, **to)
        assert send("STATUSTEXT", {"severity": 6, "text": "hello"}, target="v1")["sent"] == 1


async def test_a_vehicle_that_throws_setpoints_away_is_held_and_may_be_taken_up_again(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=1) as gcs:
        await gcs.fly("velocity")
        await gcs.step(5.0, 0.0, 0.0)
        await asyncio.sleep(1.0)
        refused, text = gcs.now, "SET_POSITION_TARGET_LOCAL_NED coordinate frame 1 unsupported"
        gcs.sim().tx.say(2, text + "\t")
        await gcs.until(lambda: gcs.control()["state"] == "held", 2.0)
        assert [t for t in gcs.texts(refused) if "nothing more is sent" in t and text in t]
        assert gcs.last_setpoint() < gcs.now
        await gcs.ends_safe(within_m=8.0, since=refused)
        await gcs.fly("velocity")


async def test_a_takeoff_may_be_ordered_before_the_vehicle_knows_where_it_is(tmp_path: Path) -> None:
    daemon = made_daemon(tmp_path, links={"sim": {"type": "simulated", "px4": 1}})
    task = asyncio.create_task(daemon.run())
    try:
        await asyncio.sleep(1.5)  # the first heartbeat came, no position yet
        at_once = (await daemon.fleet.orders.command_all("all", VehicleActor.takeoff, 5.0))["v1"]
        assert not at_once.ok and at_once.message.startswith("not ready: its position is not known yet")
        assert (await daemon.fleet.orders.command_all("all", VehicleActor.takeoff, 5.0, wait_s=30.0))["v1"].ok
    finally:
        daemon.stop()
        await task
