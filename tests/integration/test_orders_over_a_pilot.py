"""An order is neither repeated nor gone on with once a pilot has the vehicle; one that ends the flight is."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mission.item import MissionItem
from skygcs.core.mission.plan import MissionPlan
from skygcs.core.mission.qgc import write_qgc
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.flown import FIELD, flown
from support.grounded import on_the_ground
from support.table import each


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


@each(("by_person", "ends_in"), [(True, "GUIDED"), (False, "LOITER")])
async def test_a_hold_of_our_own_is_not_repeated_to_him(tmp_path: Path, by_person: bool, ends_in: str) -> None:
    """The watch for the unattended held it after the end of control, and so took it back from its pilot."""
    async with flown(tmp_path, px4=0, ardupilot=1) as gcs:
        await gcs.fly("velocity")
        await asyncio.sleep(5.0)
        gcs.loses, since = frozenset({"COMMAND_LONG", "COMMAND_INT", "SET_MODE"}), gcs.now
        if by_person:
            ordered = asyncio.create_task(gcs.outcome("vehicles.hold"))
        else:
            gcs.actor().offboard.release("a test ends it")
        await gcs.until(lambda: [s for s in gcs.sent if s.values.get("command") == 176 and s.at > since], 5.0)
        gcs.other_sets_mode(CopterMode.LOITER)
        await gcs.until(lambda: gcs.actor().vehicle.mode == "LOITER", 3.0)
        gcs.loses = frozenset()
        await asyncio.sleep(8.0)
        assert gcs.actor().vehicle.mode == ends_in
        if by_person:
            assert (await ordered)["ok"]


@each(
    ("first", "heard", "pilot", "ends_in"),
    [
        ("accepted", True, (), "GUIDED"),
        ("accepted", False, (), "GUIDED"),
        ("accepted", False, (CopterMode.ALT_HOLD, CopterMode.LOITER), "LOITER"),
        ("accepted", False, (CopterMode.ALT_HOLD,), "ALT_HOLD"),
        ("refused", False, (CopterMode.LOITER,), "LOITER"),
        ("lost", True, (CopterMode.LOITER,), "LOITER"),
    ],
)
async def test_a_mode_that_is_corrected_before_it_shows_is_not_taken_for_his(
    tmp_path: Path, first: str, heard: bool, pilot: tuple[CopterMode, ...], ends_in: str
) -> None:
    """LOITER was ordered, and 0.3 s later GUIDED: as LOITER showed after that, the correction was left to a pilot.
    ``first``: what becomes of LOITER; ``heard``: whether GUIDED is, before it is repeated; ``pilot``: his switches."""
    async with flown(tmp_path, px4=0, ardupilot=1) as gcs:
        sim, actor = gcs.sim(), gcs.actor()
        gcs.uplink_delay_s = 0.4
        gcs.deaf, sim.faults.refuse_mode = first == "lost", "not now" if first == "refused" else ""
        wrong = asyncio.create_task(gcs.outcome("vehicles.mode", mode="LOITER", force=True))
        await asyncio.sleep(0.3)
        gcs.deaf = not heard
        right = asyncio.create_task(gcs.outcome("vehicles.mode", mode="GUIDED"))
        await asyncio.sleep(0.3)
        assert (actor.vehicle.mode == "LOITER") is (first == "accepted"), "it shows now"
        for mode in pilot:
            sim.mode = mode  # his transmitter, which is refused nothing
            await gcs.until(lambda wanted=mode.name: actor.vehicle.mode == wanted, 2.0)
        gcs.deaf, sim.faults.refuse_mode = False, ""
        outcome = await right
        await asyncio.sleep(3.0)
        assert actor.vehicle.mode == ends_in and outcome["ok"] is (ends_in == "GUIDED"), outcome
        assert (await wrong)["result"] == "cancelled"
        assert outcome["ok"] or f"it was switched to {ends_in} since" in outcome["message"]


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


@each("name", ["v1", "v2"])
@each("without", ["its checks", "a position"])
async def test_it_is_not_armed_for_an_order_that_waited_once_he_has_it(tmp_path: Path, name: str, without: str) -> None:
    """He had switched it to a mode of his sticks, and its motors started under his hands. Who orders it then is
    obeyed."""
    async with on_the_ground(tmp_path) as gcs:
        sim, actor = gcs.sim(name), gcs.actor(name)
        taken = int(Px4Mode.POSCTL) if name == "v1" else int(CopterMode.LOITER)
        if without == "a position" and name == "v2":
            sim.faults.gps_lost = True
            await asyncio.sleep(10.0)
        else:
            sim.faults.refuse_arming = "not now"
        ordered = asyncio.create_task(gcs.outcome("vehicles.arm", name, wait_s=30.0))
        await asyncio.sleep(3.3)
        sim.mode = taken
        await gcs.until(lambda: actor.vehicle.custom_mode == taken, 3.0)
        sim.faults.refuse_arming, sim.faults.gps_lost, seen = "", False, gcs.now
        outcome = await ordered
        await asyncio.sleep(5.0)
        mode = actor.vehicle.mode
        said = f"it was switched to {mode} since, which its pilot flies; order it again to arm it in {mode}"
        assert said in outcome["message"] and not sim.armed, outcome
        assert not gcs.commands(seen, name)
        again = await gcs.outcome("vehicles.arm", name)
        assert sim.armed or "only with sticks" in again["message"], "a PX4 sees none of his sticks here"
