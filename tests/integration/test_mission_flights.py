"""Missions flown by the whole daemon and simulated vehicles of both firmwares, over links that lose a part of it."""

from __future__ import annotations

import asyncio
import contextlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.mission.formats import read_plan
from skygcs.core.mission.item import MissionType
from skygcs.core.mission.plan import MissionPlan, from_wire, to_wire
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.flown import FIELD, Flown
from support.grounded import on_the_ground

BOTH = pytest.mark.parametrize("name", ["v1", "v2"])
"""v1 is a PX4, v2 an ArduCopter."""

MISSION_MODES = {Px4Mode.MISSION, CopterMode.AUTO}


def place(east: float, north: float) -> tuple[float, float]:
    lat, lon = FIELD.to_geodetic(east, north)
    return round(lat, 7), round(lon, 7)


def plan_text(*, hold_s: float = 2.0) -> str:
    """A QGroundControl plan: up, a triangle with a speed and a wait, a jump, and home; a fence and a rally point."""

    def item(command: int, params: list[float | None], frame: int = 3) -> dict[str, Any]:
        return {
            "type": "SimpleItem",
            "command": command,
            "frame": frame,
            "autoContinue": True,
            "params": params,
            "doJumpId": 1,
        }

    corners = [place(*c) for c in ((-80, -80), (80, -80), (80, 80), (-80, 80))]
    items = [
        item(22, [0, 0, 0, None, *place(0, 0), 8]),
        item(16, [0, 0, 0, None, *place(0, 30), 10]),
        item(178, [1, 3, -1, 0, 0, 0, 0], 2),
        item(16, [hold_s, 0, 0, None, *place(25, 30), 12]),
        item(19, [3, 0, 0, 0, *place(25, 0), 10]),
        item(177, [2, 1, 0, 0, 0, 0, 0], 2),
        item(20, [0, 0, 0, 0, 0, 0, 0], 2),
    ]
    return json.dumps(
        {
            "fileType": "Plan",
            "version": 1,
            "groundStation": "QGroundControl",
            "mission": {
                "version": 2,
                "firmwareType": 12,
                "vehicleType": 2,
                "cruiseSpeed": 5,
                "hoverSpeed": 5,
                "globalPlanAltitudeMode": 1,
                "plannedHomePosition": [*place(0, 0), 180],
                "items": [{**i, "doJumpId": n} for n, i in enumerate(items, 1)],
            },
            "geoFence": {
                "version": 2,
                "circles": [{"version": 1, "inclusion": True, "circle": {"center": list(place(0, 0)), "radius": 100}}],
                "polygons": [{"version": 1, "inclusion": True, "polygon": [list(c) for c in corners]}],
            },
            "rallyPoints": {"version": 2, "points": [[*place(5, 5), 20]]},
        }
    )


def kept(plan: MissionPlan, name: str) -> MissionPlan:
    """As the vehicle keeps it: an ArduPilot has no unset numbers."""
    if name == "v1":
        return replace(plan, home=None)
    assert plan.home is not None
    mission = from_wire(to_wire(plan.mission, plan.home.item()), first_is_home=True)
    return replace(plan, mission=mission, home=None)


async def held(gcs: Flown, name: str) -> MissionPlan:
    told = await gcs("missions.download", target=name)
    assert told["outcome"]["ok"], told["outcome"]
    return replace(read_plan(told["plan"].encode(), "held").plan, home=None)


@BOTH
async def test_a_qgc_plan_is_uploaded_flown_paused_and_read_back(tmp_path: Path, name: str) -> None:
    async with on_the_ground(tmp_path) as gcs:
        text = plan_text()
        await gcs.done("missions.upload", targets=name, plan=text)
        plan = read_plan(text.encode(), "plan").plan
        back = await held(gcs, name)
        for kind in MissionType:
            assert back.items(kind) == kept(plan, name).items(kind)
        began = gcs.now
        await gcs.done("missions.start", targets=name)
        sim = gcs.sim(name)

        async def status() -> dict[str, Any]:
            return dict((await gcs("missions.status", targets=name))[0])

        await gcs.until(lambda: gcs.place(name)[1] > 12, 60.0)
        assert (await status())["item"] == 2
        await gcs.done("missions.pause", targets=name)
        await asyncio.sleep(8)
        north = gcs.place(name)[1]
        await asyncio.sleep(5)
        assert abs(gcs.place(name)[1] - north) < 0.5, "it holds"
        assert sim.mode not in MISSION_MODES
        await gcs.done("missions.resume", targets=name)
        await gcs.until(lambda: gcs.place(name)[0] - (0 if name == "v1" else 5) > 10, 60.0)
        await gcs.done("missions.set_current", targets=name, item=5)
        assert (await status())["item"] == 5
        await gcs.until(lambda: sim.landed and not sim.armed, 240.0)
        reached = [t.data["reached"] for t in gcs.told if t.vehicle == name and t.data.get("reached") is not None]
        assert reached[0] == 1 and reached.count(5) == 2, reached
        texts = gcs.texts(began, "mission", name)
        assert "reached item 5 of 7" in texts and "goes on with item 4" in texts


@BOTH
async def test_an_upload_over_a_link_that_loses_a_fifth_each_way_is_exact(tmp_path: Path, name: str) -> None:
    async with on_the_ground(tmp_path, loss=0.2, duplicate=0.1, delay_s=0.2, jitter_s=0.3, seed=2) as gcs:
        text = plan_text()
        await gcs.done("missions.upload", targets=name, plan=text)
        wanted = kept(read_plan(text.encode(), "plan").plan, name)
        lists = gcs.sim(name).lists
        assert len(lists.mission) == 7 and lists.fence == wanted.fence
        back = await held(gcs, name)
        for kind in MissionType:
            assert back.items(kind) == wanted.items(kind)
        for _ in range(5):  # what sets the current item is not repeated by itself: a person orders it again
            if (outcome := await gcs.outcome("missions.start", targets=name))["ok"]:
                break
        assert outcome["ok"], outcome
        await gcs.until(lambda: gcs.place(name)[1] > 25, 90.0)


@BOTH
async def test_an_upload_that_is_cancelled_says_what_the_vehicle_holds(tmp_path: Path, name: str) -> None:
    async with on_the_ground(tmp_path, delay_s=0.5) as gcs:
        await gcs.done("missions.upload", targets=name, plan=plan_text(), lists=["mission"])
        before = list(gcs.sim(name).lists.mission)
        upload = asyncio.ensure_future(
            gcs("missions.upload", targets=name, plan=plan_text(hold_s=9.0), lists=["mission"])
        )
        await asyncio.sleep(4.5)
        upload.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await upload
        await asyncio.sleep(15)
        (told,) = [t for t in gcs.told if t.vehicle == name and t.text.startswith("mission upload: cancelled")]
        after = list(gcs.sim(name).lists.mission)
        if name == "v1":
            assert "keeps the mission it had" in told.text and after == before
        else:
            assert "what follows is old" in told.text
        await gcs.done("missions.upload", targets=name, plan=plan_text(hold_s=9.0), lists=["mission"])
        assert gcs.sim(name).lists.mission[3].params[0] == 9.0


async def test_a_fence_of_a_plan_stops_a_flight_out_of_it(tmp_path: Path) -> None:
    async with on_the_ground(tmp_path) as gcs:
        for sim in gcs.sims:
            for name, value in (("FENCE_ENABLE", 1), ("FENCE_ACTION", 1), ("FENCE_TYPE", 7)):
                sim.params.set(name, value)
            if (found := sim.params.find("GF_ACTION")) is not None:
                found[1].value = 3
        await gcs.done("missions.upload", targets="all", plan=plan_text(), lists=["fence"])
        fly_out = json.loads(plan_text())
        fly_out["mission"]["items"][1]["params"][4:6] = list(place(0, 150))
        text = json.dumps(fly_out)
        refused = await gcs.outcome("missions.upload", "v1", plan=text)
        assert refused["result"] == "refused" and "item 2" in refused["message"]
        await gcs.done("missions.upload", targets="all", plan=text, lists=["mission"], force=True)
        await gcs.done("missions.start", targets="all", force=True)  # one mission for both
        homewards = {Px4Mode.RTL, CopterMode.RTL}
        await gcs.until(lambda: all(sim.mode in homewards for sim in gcs.sims), 90.0)
        for name in ("v1", "v2"):
            assert 60 < max(t.pos_m[1] for t in gcs.truth[int(name[1:])]) < 110
        told = await gcs("missions.status", targets="v2")
        assert told[0]["fence"]["breach_count"] >= 1


def with_items(*items: tuple[int, list[float | None], int]) -> str:
    plan = json.loads(plan_text())
    entry = {"type": "SimpleItem", "autoContinue": True}
    plan["mission"]["items"] = [{**entry, "command": c, "params": p, "frame": f} for c, p, f in items]
    del plan["geoFence"], plan["rallyPoints"]
    return json.dumps(plan)


async def test_each_firmware_gets_what_it_takes_and_the_outcome_says_what_was_changed(tmp_path: Path) -> None:
    """A return with a place (Mission Planner, PX4 refuses it) and a camera mode (QGroundControl, ArduPilot does)."""
    text = with_items(
        (22, [0, 0, 0, None, *place(0, 0), 8], 3),
        (530, [0, 2, None, None, None, None, None], 2),
        (16, [0, 0, 0, None, *place(0, 30), 10], 3),
        (20, [0, 0, 0, 0, *place(0, 0), 8], 3),
    )
    async with on_the_ground(tmp_path) as gcs:
        outcome = (await gcs("missions.upload", targets="v1", plan=text))["outcomes"]["v1"]
        assert outcome["ok"] and "4 mission items taken; mission item 4: the position of" in outcome["message"]
        outcome = (await gcs("missions.upload", targets="v2", plan=text))["outcomes"]["v2"]
        assert outcome["ok"] and "3 mission items taken; mission item 2: SET_CAMERA_MODE" in outcome["message"]
        assert [item.command for item in gcs.sim("v2").lists.mission] == [22, 16, 20]


@BOTH
async def test_an_upload_that_is_refused_at_its_last_item_says_what_is_held(tmp_path: Path, name: str) -> None:
    last = (18, [2, 0, 5, 0, *place(0, 30), 10], 3) if name == "v1" else (214, [5, 0, 0, 0, 0, 0, 0], 2)
    items = ((22, [0, 0, 0, None, *place(0, 0), 8], 3), (16, [0, 0, 0, None, *place(0, 30), 10], 3))
    async with on_the_ground(tmp_path) as gcs:
        await gcs.done("missions.upload", targets=name, plan=with_items(*items))  # type: ignore[arg-type]
        refused = await gcs("missions.upload", targets=name, plan=with_items(*items, last))  # type: ignore[arg-type]
        assert refused["outcomes"][name]["result"] == "refused", "the check knows what it takes"
        bad = await gcs("missions.upload", targets=name, plan=with_items(*items, last), force=True)  # type: ignore[arg-type]
        message = bad["outcomes"][name]["message"]
        assert bad["outcomes"][name]["result"] == "unsupported" and message.startswith("item 3: not supported")
        held_now = "the vehicle keeps the mission it had" if name == "v1" else "items up to 2 are new"
        assert held_now in message
        assert [i.command for i in (await held(gcs, name)).mission] == [22, 16]
