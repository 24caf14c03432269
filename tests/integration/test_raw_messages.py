"""A client of the socket that goes past the orders: raw setpoints and commands to vehicles in the air.

In the flight that showed it, SET_ATTITUDE_TARGET at 20 Hz and `mode OFFBOARD` took a vehicle from 8 to 30 m, through a
control fence of 12 m.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import RefusedError
from skygcs.rpc.dispatch import failure_reply
from support.flown import Flown, aloft

CLIMB = {"type_mask": 7, "q": [1.0, 0.0, 0.0, 0.0], "thrust": 0.8}


async def refused(gcs: Flown, **params: Any) -> str:
    try:
        answer = await gcs("messages.send", **params)
    except RefusedError as error:
        assert b"-32002" in failure_reply(1, "messages.send", error)
        return str(error)
    raise AssertionError(f"it was sent: {answer}")


async def test_an_attitude_stream_of_a_client_moves_no_vehicle_unless_forced(tmp_path: Path) -> None:
    async with aloft(tmp_path, height_m=8.0, control={"fence": {"up_m": [0.0, 12.0]}}) as gcs:
        since = gcs.now
        for _ in range(60):
            assert "armed" in await refused(gcs, name="SET_ATTITUDE_TARGET", fields=CLIMB, target="v1")
            await asyncio.sleep(0.05)
        assert not (await gcs.outcome("vehicles.mode", mode="OFFBOARD"))["ok"], "no setpoints came"
        await asyncio.sleep(5)
        assert gcs.farthest_m(since) < 1.0
        assert not gcs.setpoints(since)
        for _ in range(3):
            await gcs("messages.send", name="SET_ATTITUDE_TARGET", fields=CLIMB, target="v1", force=True)
        assert [s.state for s in gcs.setpoints(since)] == ["off"] * 3
        gcs.sent.clear()  # what was forced is no mistake of the daemon's


TO = {"target_system": 1}
"""A system without its component."""

ADDRESSES: list[dict[str, Any]] = [
    {"target": "v1"},
    {"target": "all"},
    {"target": ["v1", "v2"]},
    {"fields": {"target_system": 1}},
    {"fields": {"target_system": 1, "target_component": 1}},
    {"fields": {"target_system": 1, "target_component": 191}},
    {"fields": {"target_system": 0}},
    {"link": "air"},
    {"link": "air", "fields": {"target_system": 1}},
]


@pytest.mark.parametrize("address", ADDRESSES, ids=str)
async def test_every_address_that_reaches_a_vehicle_in_the_air_is_refused(
    tmp_path: Path, address: dict[str, Any]
) -> None:
    async with aloft(tmp_path, px4=1, ardupilot=1) as gcs:
        since = gcs.now
        fields = address.get("fields", {})
        rest = {k: v for k, v in address.items() if k != "fields"}
        for name in ("SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED", "RC_CHANNELS_OVERRIDE"):
            text = await refused(gcs, name=name, fields=fields, **rest)
            assert name in text and "control set" in text and "--force" in text
        if "target_component" not in fields:
            control = {"target": fields["target_system"]} if fields else {}
            await refused(gcs, name="MANUAL_CONTROL", fields=control, **rest)
        reposition = {**fields, "command": 192, "x": 1, "y": 1, "z": 5.0}
        assert "goto" in await refused(gcs, name="COMMAND_INT", fields=reposition, **rest)
        fall = {**fields, "command": 400, "param1": 0.0, "param2": 21196.0}
        assert "disarm" in await refused(gcs, name="COMMAND_LONG", fields=fall, **rest)
        await asyncio.sleep(5)
        assert not gcs.setpoints(since) and not gcs.commands(since)
        assert all(sim.armed for sim in gcs.sims)


async def test_commands_that_pass_the_guards_are_refused_and_those_that_end_a_flight_are_not(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        since = gcs.now
        for command in ("DO_REPOSITION", "DO_FLIGHTTERMINATION", "PREFLIGHT_REBOOT_SHUTDOWN", "DO_SET_HOME", 187, 400):
            outcome = await gcs.outcome("vehicles.command", command=command)
            assert outcome["result"] == "refused" and "--force" in outcome["message"], outcome
        for command, first in (("COMPONENT_ARM_DISARM", 1.0), ("COMPONENT_ARM_DISARM", None), ("DO_MOTOR_TEST", 1.0)):
            assert (await gcs.outcome("vehicles.command", command=command, params=[first]))["result"] == "refused"
        assert not gcs.commands(since)
        outcome = await gcs.outcome("vehicles.command", command="DO_SET_HOME", params=[1.0], force=True)
        assert outcome["ok"], outcome
        await gcs.done("vehicles.command", command="NAV_LAND", params=[0.0, 0.0, 0.0, None, 0.0, 0.0, 0.0])
        await gcs.until(lambda: not gcs.actor().vehicle.armed, 60.0)
        # on the ground and disarmed: setpoints may be tried, motors are not turned
        await gcs("messages.send", name="SET_ATTITUDE_TARGET", fields=CLIMB, target="v1")
        gcs.sent.clear()
        outcome = await gcs.outcome("vehicles.command", command="DO_MOTOR_TEST", params=[1.0])
        assert outcome["result"] == "refused" and "motors" in outcome["message"]
        arm = {"command": 400, "param1": 1.0}
        assert "the checked order is arm" in await refused(gcs, name="COMMAND_LONG", fields=arm, target="v1")


async def test_a_vehicle_that_is_lost_is_not_known_to_be_disarmed(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.done("vehicles.land")
        await gcs.until(lambda: not gcs.sim().armed and not gcs.actor().vehicle.armed, 60.0)
        gcs.cut = True
        await gcs.until(lambda: not gcs.actor().vehicle.connected)
        assert "lost" in await refused(gcs, name="SET_ATTITUDE_TARGET", fields=CLIMB, target="v1")
        assert "not known" in await refused(gcs, name="MANUAL_CONTROL", fields={"target": 99})
