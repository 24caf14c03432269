"""Missions that lead two vehicles to one place do not start, unless insisted on; nor into one that was lost."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mission.item import MissionType
from support.flown import FIELD, Flown, aloft, flown


def mission(*points: tuple[float, float, float], home: tuple[float, float]) -> str:
    """A QGroundControl plan: up, along these points (east, north, height), and home."""

    def item(number: int, command: int, params: list[float | None], frame: int = 3) -> dict[str, Any]:
        known = {"type": "SimpleItem", "command": command, "frame": frame, "autoContinue": True}
        return {**known, "params": params, "doJumpId": number}

    def place(east: float, north: float) -> list[float]:
        return [round(degrees, 7) for degrees in FIELD.to_geodetic(east, north)]

    items = [item(1, 22, [0, 0, 0, None, *place(*home), points[0][2]])]
    items += [item(n, 16, [0, 0, 0, None, *place(x, y), up]) for n, (x, y, up) in enumerate(points, 2)]
    items.append(item(len(items) + 1, 20, [0] * 7, 2))
    flight = {"version": 2, "firmwareType": 12, "vehicleType": 2, "cruiseSpeed": 5, "hoverSpeed": 5}
    flight |= {"globalPlanAltitudeMode": 1, "plannedHomePosition": [*place(*home), 180], "items": items}
    empty = {"geoFence": {"version": 2, "circles": [], "polygons": []}, "rallyPoints": {"version": 2, "points": []}}
    return json.dumps({"fileType": "Plan", "version": 1, "groundStation": "QGroundControl", "mission": flight, **empty})


@pytest.mark.deep
async def test_one_mission_for_two_at_one_height_is_refused_unless_insisted_on(tmp_path: Path) -> None:
    """It started without a word."""
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        homes = {name: gcs.place_of_home(name)[:2] for name in ("v1", "v2")}
        same = [(0.0, 30.0, 10.0), (30.0, 30.0, 10.0)]
        await gcs.done("missions.upload", targets="all", plan=mission(*same, home=homes["v1"]))
        outcomes = (await gcs("missions.start", targets="all"))["outcomes"]
        for name, other in (("v1", "v2"), ("v2", "v1")):
            text = outcomes[name]["message"]
            assert outcomes[name]["result"] == "refused" and f"{name} would come 0.0 m near {other}" in text, outcomes
            assert "(on its mission)" in text and "--force" in text
        assert not any(sim.armed for sim in gcs.sims)
        # one alone is nobody's business, and the other is compared with it while it flies
        await gcs.done("missions.start", targets="v1")
        await gcs.until(lambda: gcs.place("v1")[2] > 5.0, 60.0)
        gcs.actor("v1").missions.forget(MissionType.MISSION)
        refused = await gcs.outcome("missions.start", "v2")
        assert refused["result"] == "refused" and "near v1 (on its mission)" in refused["message"], refused
        assert "order this when v1 is past, or pause it (mission pause v1)" in refused["message"], refused
        # side by side is no overlap, though this one was put on board by another station: it is read
        apart = [(x + 5.0, y, up) for x, y, up in same[:1]]
        await gcs.done("missions.upload", targets="v2", plan=mission(*apart, home=homes["v2"]))
        gcs.actor("v2").missions.forget(MissionType.MISSION)
        refused = await gcs.outcome("missions.start", "v2")
        assert refused["result"] == "refused", "its way back crosses the other's"
        await gcs.done("missions.start", targets="v2", force=True)


@pytest.mark.parametrize(("px4", "mode"), [(2, "AUTO.MISSION"), (0, "AUTO")], ids=["px4", "ardupilot"])
async def test_every_order_that_goes_on_with_a_mission_is_checked_as_its_start_is(
    tmp_path: Path, px4: int, mode: str
) -> None:
    """resume, the mode of missions, and another item while it is flown."""
    async with aloft(tmp_path, px4=px4, ardupilot=2 - px4) as gcs:
        x, y, up = gcs.place("v1")
        home = gcs.place_of_home("v1")[:2]
        far = [(x, y + 12.0, up), (x, y + 24.0, up), (x + 20.0, y + 24.0, up)]
        await gcs.done("missions.upload", targets="v1", plan=mission(*far, home=home))
        await gcs.done("missions.start", targets="v1")
        await gcs.until(lambda: gcs.place("v1")[1] > y + 3.0, 60.0)
        await gcs.done("missions.pause", targets="v1")
        # another one comes to its way
        await gcs.done("vehicles.goto", targets="v2", enu_m=[x, y + 18.0, up], force=True)
        await gcs.until(lambda: abs(gcs.place("v2")[1] - y - 18.0) < 0.5, 60.0)
        for method, params in (("missions.resume", {}), ("vehicles.mode", {"mode": mode})):
            refused = await gcs.outcome(method, "v1", **params)
            assert refused["result"] == "refused" and "near v2" in refused["message"], (method, refused)
            assert "--force" in refused["message"]
        # what lies behind it is not flown again, and an item that is not flown to needs no check
        await gcs.done("missions.set_current", targets="v1", item=2)
        await gcs.done("vehicles.goto", targets="v2", enu_m=[x - 10.0, y - 10.0, up], force=True)
        await gcs.until(lambda: gcs.place("v2")[1] < y - 9.5, 90.0)
        await gcs.done("missions.resume", targets="v1")
        await asyncio.sleep(2.0)
        # while it is flown
        await gcs.done("vehicles.goto", targets="v2", enu_m=[x + 10.0, y + 15.0, up], force=True)
        await gcs.until(lambda: abs(gcs.place("v2")[1] - y - 15.0) < 0.5, 90.0)
        refused = await gcs.outcome("missions.set_current", "v1", item=4)
        assert refused["result"] == "refused" and "near v2" in refused["message"], refused
        await gcs.done("missions.set_current", targets="v1", item=4, force=True)


@pytest.mark.deep
@pytest.mark.parametrize("kind", [{"px4": 2}, {"px4": 0, "ardupilot": 2}], ids=["px4", "ardupilot"])
async def test_a_vehicle_lost_in_the_air_is_in_the_way_of_everything_that_goes_on_by_itself(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    """goto, take-off, mission, trajectory and plan, at every age of its last position."""
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.done("vehicles.land", targets="v1")
        await gcs.until(lambda: not gcs.sim("v1").armed, 120.0)
        x, y, up = gcs.place("v2")
        home = gcs.place_of_home("v1")[:2]
        await gcs.done("missions.upload", targets="v1", plan=mission((x, y, up), home=home))
        gcs.muted.add(2)
        muted = gcs.now
        for silent_s in (2.6, 5.5, 8.2, 10.5, 30.0, 300.0):
            await asyncio.sleep(max(0.0, muted + silent_s - gcs.now))
            started = await gcs.outcome("missions.start", "v1")
            assert started["result"] == "refused" and "near v2" in started["message"], (silent_s, started)
        assert "forget v2 --force" in started["message"]
        took_off = await gcs.outcome("vehicles.takeoff", height_m=10.0)
        assert took_off["result"] == "refused" and "lost in the air" in took_off["message"], took_off
        # in the air again it is warned of that place, once, and no trajectory leads there
        await gcs.done("vehicles.takeoff", height_m=10.0, force=True)
        await asyncio.sleep(15.0)
        warned = [t.text for t in gcs.told if t.kind == "separation" and t.data.get("lost")]
        assert len(warned) == 1 and "v1 is" in warned[0] and "where v2 was lost in the air" in warned[0], warned
        await gcs.fly("position")
        here = gcs.place("v1")
        pieces = [{"duration_s": 8.0, "x": [here[0], 0.0, 0.05], "y": [here[1]], "up": [here[2]]}]
        assert (await gcs("trajectory.load", target="v1", pieces=pieces))["outcomes"]["v1"]["ok"]
        flies = await gcs.outcome("trajectory.start", "v1")
        assert not flies["ok"] and "near v2 (lost in the air" in flies["message"], flies


@pytest.mark.deep
async def test_a_mission_that_lands_on_one_that_stands_is_refused(tmp_path: Path) -> None:
    """One after another by the same mission: the second came down on the first."""
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        homes = {name: gcs.place_of_home(name)[:2] for name in ("v1", "v2")}
        text = mission((0.0, 30.0, 10.0), home=homes["v1"])
        plan = json.loads(text)
        there = [round(degrees, 7) for degrees in FIELD.to_geodetic(0.0, 30.0)]
        plan["mission"]["items"][-1] |= {"command": 21, "params": [0, 0, 0, None, *there, 0], "frame": 3}
        await gcs.done("missions.upload", targets="all", plan=json.dumps(plan))
        await gcs.done("missions.start", targets="v1")
        await gcs.until(lambda: gcs.sim("v1").armed, 30.0)
        await gcs.until(lambda: not gcs.sim("v1").armed, 240.0)
        await asyncio.sleep(5.0)
        refused = await gcs.outcome("missions.start", "v2")
        assert refused["result"] == "refused" and "m from v1, which stands there" in refused["message"], refused
        assert not gcs.sim("v2").armed
        await gcs.done("missions.start", targets="v2", force=True)


async def _other_uploads(gcs: Flown, to: str, of: str) -> None:
    """Another station brings the mission of one vehicle to another one."""
    items, sysid = gcs.sim(of).lists.items[MissionType.MISSION], int(to[1:])
    home_first = gcs.actor(to).vehicle.family == "ardupilot"
    wire = [*items[:1], *items] if home_first else items
    gcs.by_other_station(mav.MAVLink_mission_count_message(sysid, 1, len(wire), 0))
    for seq, item in enumerate(wire):
        await asyncio.sleep(0.1)
        p1, p2, p3, p4 = (value or 0.0 for value in item.params)
        place = item.x, item.y, item.z or 0.0
        gcs.by_other_station(
            mav.MAVLink_mission_item_int_message(
                sysid, 1, seq, item.frame, item.command, 0, 1, p1, p2, p3, p4, *place, mission_type=0
            )
        )
    await asyncio.sleep(0.1)
    assert [i.x for i in gcs.sim(to).lists.items[MissionType.MISSION]] == [i.x for i in items]


@pytest.mark.parametrize("unheard", [False, True], ids=["heard", "unheard"])
@pytest.mark.parametrize("kind", [{"px4": 2}, {"px4": 0, "ardupilot": 2}], ids=["px4", "ardupilot"])
async def test_a_mission_that_another_station_has_replaced_is_not_the_one_that_is_compared(
    tmp_path: Path, kind: dict[str, int], unheard: bool
) -> None:
    """Both were started into each other: it had as many items as the one that was sent from here."""
    async with flown(tmp_path, takeoff=False, **kind) as gcs:

        async def upload(name: str, east_m: float) -> None:
            plan = mission((east_m, 30.0, 10.0), home=gcs.place_of_home(name)[:2])
            await gcs.done("missions.upload", targets=name, plan=plan)

        def reads() -> int:
            return sum(sent.name == "MISSION_REQUEST_LIST" for sent in gcs.sent)

        await upload("v1", -25.0)
        await upload("v2", 30.0)
        if unheard:
            gcs.muted.add(1)
            await gcs.until(lambda: not gcs.actor("v1").vehicle.connected)
        await _other_uploads(gcs, "v1", "v2")
        gcs.muted.clear()
        await gcs.until(lambda: gcs.actor("v1").vehicle.connected)
        await asyncio.sleep(2.0)
        outcomes = (await gcs("missions.start", targets="all"))["outcomes"]
        assert all(o["result"] == "refused" and "near v" in o["message"] for o in outcomes.values()), outcomes
        assert reads() == 1 and not any(sim.armed for sim in gcs.sims)
        # what was sent from here is not read; nor is a PX4's list after a loss, if its number is the same
        await upload("v1", -25.0)
        if unheard and "ardupilot" not in kind:
            gcs.muted.add(1)
            await gcs.until(lambda: not gcs.actor("v1").vehicle.connected)
            gcs.muted.clear()
            await gcs.until(lambda: gcs.actor("v1").vehicle.connected)
            await asyncio.sleep(2.0)
        await gcs.done("missions.start", targets="all")
        assert reads() == 1


async def test_a_start_waits_a_moment_for_the_mission_of_another_one_and_is_refused_without_any(tmp_path: Path) -> None:
    """It waited 39 s for a list that did not come."""
    async with aloft(tmp_path, px4=0, ardupilot=2) as gcs:
        for name in ("v1", "v2"):
            x, y, up = gcs.place(name)
            far = mission((x, y + 30.0, up), (x, y + 60.0, up), home=gcs.place_of_home(name)[:2])
            await gcs.done("missions.upload", targets=name, plan=far)
        await gcs.done("missions.start", targets="v1")
        await asyncio.sleep(3.0)
        gcs.loses = frozenset({"MISSION_REQUEST_LIST"})
        gcs.actor("v1").missions.stop("lost", "a test")
        asked = gcs.now
        await gcs.done("missions.start", targets="v2")  # by what is known of the other one's
        assert gcs.now - asked < 8.0
        await gcs.done("vehicles.hold", targets="v2")
        gcs.actor("v1").missions.forget(MissionType.MISSION)
        refused = await gcs.outcome("missions.start", "v2")
        assert refused["result"] == "refused" and "the mission that v1 flies could not be read" in refused["message"]
        await gcs.done("missions.start", targets="v2", force=True)
