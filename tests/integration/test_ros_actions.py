"""Orders as actions of ROS: a whole daemon, simulated vehicles in virtual time, the bridge, and a node of the test."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.ros.action_goals import ABORTED, CANCELED, EXECUTING, SUCCEEDED, UNKNOWN
from skygcs.sim.firmware_modes import Px4Mode
from support.ros_bridge import bridged

NORTH = {"position": {"x": 0.0, "y": 40.0, "z": 10.0}}
SOUTH = {"position": {"x": 0.0, "y": -40.0, "z": 10.0}}


@pytest.mark.parametrize("kind", [{"px4": 1}, {"px4": 0, "ardupilot": 1}])
async def test_a_vehicle_takes_off_goes_and_lands(tmp_path: Path, kind: dict[str, int]) -> None:
    async with bridged(tmp_path, takeoff=False, **kind) as ros:
        up = await ros.send("takeoff", height_m=6.0, arm=True)
        assert up.accepted and up.status() == EXECUTING, ros.texts()
        assert (await up.result())["status"] == SUCCEEDED, ros.texts()
        heights = [feedback["height_m"] for feedback in up.feedback()]
        assert heights[0] < 1 and heights == sorted(heights) and heights[-1] == pytest.approx(6, abs=1)
        away = await ros.send("goto", position={"x": 20.0, "y": 10.0, "z": 6.0})
        result = await away.result()
        assert result["status"] == SUCCEEDED and result["result"]["reason"] == "arrived", ros.texts()
        assert math.dist(ros.gcs.place(), (20, 10, 6)) < 2.5
        left = [feedback["distance_m"] for feedback in away.feedback()]
        assert left[0] > 20 and left[-1] < 2
        here = await ros.send("goto", frame=1, lat_deg=43.7806, lon_deg=-79.4653)  # as high as it is
        assert (await here.result())["status"] == SUCCEEDED
        x, y, height = ros.gcs.place()
        assert math.hypot(x, y) < 2.5 and height == pytest.approx(6, abs=1)
        down = await ros.send("land")
        assert (await down.result())["result"] == {"ok": True, "reason": "landed and disarmed"}
        assert [goal.status() for goal in (up, away, here, down)] == [SUCCEEDED] * 4
        assert ros.bridge.controls["v1"].actions.counters()["goals_succeeded"] == 4  # type: ignore[union-attr]


async def test_a_cancelled_goal_holds(tmp_path: Path) -> None:
    async with bridged(tmp_path) as ros:
        goal = await ros.send("goto", **NORTH)
        waiting = asyncio.create_task(goal.result())
        await ros.gcs.until(lambda: ros.gcs.place()[1] > 10)
        assert (await goal.cancel())["return_code"] == 0
        result = await waiting
        assert result["status"] == CANCELED and result["result"]["reason"].startswith("cancelled: ")
        assert 15 < result["result"]["distance_m"] < 35
        await asyncio.sleep(10)
        assert ros.gcs.place()[1] < 30 and ros.gcs.sims[0].mode == Px4Mode.LOITER
        assert (await goal.cancel())["return_code"] == 3  # terminated


@pytest.mark.parametrize("door", ["service", "another client"])
@pytest.mark.parametrize("kind", [{"px4": 1}, {"px4": 0, "ardupilot": 1}], ids=["px4", "ardupilot"])
async def test_a_cancel_does_not_take_the_place_of_an_order_that_is_not_answered_yet(
    tmp_path: Path, kind: dict[str, int], door: str
) -> None:
    """The hold of a cancelled goal came after a landing by a service that was still on its way, and ended it."""
    async with bridged(tmp_path, delay_s=1.0, **kind) as ros:
        goal = await ros.send("goto", **NORTH)
        await ros.gcs.until(lambda: ros.gcs.place()[1] > 10)
        if door == "service":
            land = asyncio.create_task(ros.node.services["/v1/mavros/cmd/land"].call())
        else:
            land = asyncio.create_task(ros.gcs("vehicles.land", targets="v1"))
        await asyncio.sleep(0.2)
        assert (await goal.cancel())["return_code"] == 0
        result = await goal.result()
        assert result["status"] == ABORTED, result
        await land
        await ros.gcs.until(lambda: not ros.gcs.sims[0].armed, 120.0)
        assert "holding" not in str([told.text for told in ros.gcs.told])


@pytest.mark.deep
async def test_a_cancel_holds_after_a_newer_order_that_the_vehicle_did_not_accept(tmp_path: Path) -> None:
    async with bridged(tmp_path, delay_s=1.0, px4=1) as ros:
        goal = await ros.send("goto", **NORTH)
        await ros.gcs.until(lambda: ros.gcs.place()[1] > 10)
        ros.gcs.sims[0].faults.refuse_mode = "not now"
        land = asyncio.create_task(ros.gcs("vehicles.land", targets="v1"))
        await asyncio.sleep(0.2)
        await goal.cancel()
        assert not (await land)["outcomes"]["v1"]["ok"]
        ros.gcs.sims[0].faults.refuse_mode = ""  # before the hold comes, a second later
        assert (await goal.result())["status"] == CANCELED


async def other_goto(ros: Any) -> None:
    await ros.gcs.done("vehicles.goto", enu_m=[0.0, -40.0, 10.0])


async def hold(ros: Any) -> None:
    await ros.gcs.done("vehicles.hold")


async def transmitter(ros: Any) -> None:
    ros.gcs.sims[0].mode = Px4Mode.POSCTL


async def control(ros: Any) -> None:
    await ros.gcs.fly("position")


@pytest.mark.parametrize(
    ("replace", "reason"),
    [
        (other_goto, "replaced: goto was ordered"),
        (hold, "replaced: hold was ordered"),
        (transmitter, "replaced: its mode is POSCTL"),
        (control, "replaced: "),
    ],
)
async def test_a_goal_that_is_replaced_by_anybody_is_aborted(tmp_path: Path, replace: Any, reason: str) -> None:
    async with bridged(tmp_path) as ros:
        goal = await ros.send("goto", **NORTH)
        await asyncio.sleep(2)
        assert goal.status() == EXECUTING
        await replace(ros)
        result = await goal.result()
        assert result["status"] == ABORTED and result["result"]["reason"].startswith(reason)
        assert not result["result"]["ok"]
        assert goal.service("get_result").pending == 0


async def test_the_daemons_refusal_is_the_goals_and_a_newer_goal_takes_the_place_of_the_one_before(
    tmp_path: Path,
) -> None:
    async with bridged(tmp_path) as ros:
        for place in ({"x": 0.0, "y": 0.0, "z": 0.0}, {"x": 90000.0, "y": 0.0, "z": 10.0}, {"x": math.nan}):
            assert not (await ros.send("goto", position=place)).accepted
        assert not (await ros.send("goto", frame=7)).accepted
        assert not (await ros.send("goto", **NORTH, tolerance_m=-1.0)).accepted
        assert not (await ros.send("takeoff", height_m=-3.0)).accepted
        refused = [text for text in ros.texts() if "goal refused" in text]
        assert len(refused) == 6 and "use land" in refused[0] and "is not finite" in refused[2]
        assert not ros.bridge.controls["v1"].actions.servers["goto"].table.goals  # type: ignore[union-attr]
        # two, and a landing
        first = await ros.send("goto", **NORTH)
        second = await ros.send("goto", **SOUTH)
        assert first.accepted and second.accepted
        assert (await first.result())["result"]["reason"] == "replaced: goto was ordered"
        await asyncio.sleep(2)
        assert second.status() == EXECUTING
        landing = await ros.send("land")
        assert (await second.result())["status"] == ABORTED
        assert (await landing.result())["status"] == SUCCEEDED


async def test_a_goal_ends_at_once_when_the_daemon_is_lost(tmp_path: Path) -> None:
    async with bridged(tmp_path) as ros:
        goal = await ros.send("goto", **NORTH)
        waiting = [asyncio.create_task(goal.result()) for _ in range(64)]
        await asyncio.sleep(2)
        with pytest.raises(TimeoutError):
            await goal.result()  # the 65th
        assert goal.service("get_result").overflown == 1
        asked = asyncio.create_task(ros.send("land"))
        await asyncio.sleep(0)
        at = asyncio.get_running_loop().time()
        await ros.gcs.die()
        for result in await asyncio.gather(*waiting):
            assert result["status"] == ABORTED and "the connection to the daemon is lost" in result["result"]["reason"]
        assert asyncio.get_running_loop().time() - at < 0.2
        assert not (await asked).accepted
        assert not (await ros.send("goto", **SOUTH)).accepted
        fleet = ros.node.last("/skygcs/fleet")
        assert not fleet["daemon_connected"] and not fleet["vehicles"][0]["connected"]
        assert ros.node.last("/skygcs/plan")["state"] == "unknown"
        await ros.gcs.begin_again()


async def test_a_thousand_goals_are_refused_but_one(tmp_path: Path) -> None:
    async with bridged(tmp_path) as ros:
        near = {"x": 0.0, "y": 8.0, "z": 10.0}
        goals = await asyncio.gather(*(ros.send("goto", position=near) for _ in range(1000)))
        assert sum(goal.accepted for goal in goals) == 1
        server = ros.bridge.controls["v1"].actions.servers["goto"]  # type: ignore[union-attr]
        assert server.table.refused == 999 and len(server.table.goals) == 1
        goal = next(goal for goal in goals if goal.accepted)
        answers = [await other.result() for other in goals if not other.accepted]
        assert {answer["status"] for answer in answers} == {UNKNOWN}
        assert (await goal.result())["status"] == SUCCEEDED
