"""Plans asked of a whole daemon: measured starts, other vehicles as obstacles, measured margins. A call is in place of
the process, for which virtual time does not wait (tests/system/test_planning_process.py)."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.plan.fleet_plan import TimedPlan
from skygcs.core.plan.margins import DEFAULT
from skygcs.core.plan.plan_json import plan_from_json
from skygcs.errors import RefusedError, SkygcsError, TargetError
from skygcs.rpc.dispatch import InvalidParams
from support.flown import Flown, aloft
from support.planned import instant_planning

WIDE = {"x_m": [-100, 100], "y_m": [-100, 100], "up_m": [0, 60]}


def planning(gcs: Flown) -> Flown:
    """To be asked for plans, which come at once."""
    instant_planning(gcs.daemon)
    return gcs


def near(place: list[float], other: list[float] | tuple[float, ...], within_m: float = 0.5) -> bool:
    return all(abs(a - b) <= within_m for a, b in zip(place, other, strict=True))


async def test_starts_are_measured_and_others_are_obstacles(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=3) as gcs:
        ask = planning(gcs)
        at = {name: list(gcs.place(name)) for name in ("v1", "v2", "v3")}  # 5 m apart to the east, 10 m up
        found = await ask("plan.make", goals={"v1": at["v2"], "2": at["v1"]})
        assert found["certificate"]["certified"], found["reasons"]
        assert all(near(found["plan"]["starts"][name], at[name]) for name in ("v1", "v2"))
        assert list(found["standing"]) == ["v3"] and near(found["standing"]["v3"], at["v3"])
        assert near(found["plan"]["space"]["standing"]["v3"], at["v3"]) and found["unknown"] == []
        # where v3 stands none can go, unless others do not count
        found = await ask("plan.make", goals={"v1": at["v3"]}, kind="direct")
        assert found["plan"] is None and any("v1 and v3 come within 0.0" in reason for reason in found["reasons"])
        found = await ask("plan.make", goals={"v1": at["v3"]}, kind="direct", others=False)
        assert found["certificate"]["certified"]
        # a plan is certified against those that do not take part, too
        certified = await ask("plan.certify", plan=found["plan"])
        assert not certified["certificate"]["certified"] and any(
            "v1 and v3" in reason for reason in certified["reasons"]
        )
        assert (await gcs("plan.jobs"))["answered"] == 4


async def test_the_control_fences_are_the_walls_of_what_is_made(tmp_path: Path) -> None:
    """By default 50 m, of which 2 m are its margin: what is made passes the check of a flight, or is refused here."""
    async with aloft(tmp_path, px4=2, control={"fence": {"up_m": [0, 25]}}) as gcs:
        ask = planning(gcs)
        at = [list(gcs.place(name)) for name in ("v1", "v2")]
        for goal, passes in (([0.0, 47.9, 10.0], True), ([0.0, 48.1, 10.0], False), ([0.0, 20.0, 23.1], False)):
            found = await ask("plan.make", goals={"v1": goal, "v2": [at[1][0], 0.0, 10.0]})
            assert (found["plan"] is not None) is passes, (goal, found["reasons"])
            assert found["by"] == "setpoints" and found["why"]
        # a lower ceiling of the request counts, a higher one does not
        high = {"v1": [0.0, 20.0, 22.9], "v2": [at[1][0], 0.0, 10.0]}
        for ceiling_m, passes in ((None, True), (60.0, True), (23.0, False)):
            found = await ask("plan.make", goals=high, space={} if ceiling_m is None else {"ceiling_m": ceiling_m})
            assert (found["plan"] is not None) is passes, (ceiling_m, found["reasons"])


async def test_formations_and_written_paths(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=3, control={"fence": WIDE}) as gcs:
        ask = planning(gcs)
        shape = {"vehicles": ["v1", "v2", "v3"], "shape": "line", "spacing_m": 6.0, "middle_m": [40.0, 0.0, 12.0]}
        found = await ask("plan.make", formation=shape)
        assert found["certificate"]["certified"]
        path = {"points": [[0, 20, 10], [20, 20, 10], [20, 40, 10]], "yaws_deg": [0, 90, 90]}
        found = await ask("plan.make", paths={"v1": path}, limits={"speed_mps": 2.0}, within_limits=True)
        assert found["certificate"]["certified"] and found["certificate"]["duration_s"] > 20.0
        timed = {"points": [[0, 20, 10], [20, 20, 10]], "times_s": [0, 2]}
        found = await ask("plan.make", paths={"v1": timed}, within_limits=True)
        assert "v1: " in found["certificate"]["motion"][0], "10 m/s is above 5"


async def test_a_formation_in_flight_is_moved_turned_and_scaled(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=3, control={"fence": WIDE}) as gcs:
        ask = planning(gcs)
        at = {name: gcs.place(name) for name in ("v1", "v2", "v3")}
        names = list(at)
        middle = [sum(place[k] for place in at.values()) / 3 for k in range(3)]
        turned = {"vehicles": names, "shape": "current", "yaw_deg": 90.0, "scale": 2.0}
        found = await ask("plan.make", formation=turned)
        assert found["certificate"]["certified"], found["reasons"]
        for name, (x, y, z) in at.items():
            goal = (middle[0] - 2 * (y - middle[1]), middle[1] + 2 * (x - middle[0]), middle[2] + 2 * (z - middle[2]))
            assert near(ends(found["plan"])[name], goal, 1.0)
        points = [[0, 0, 0], [9, 0, 0], [0, 9, 2]]
        star = {"vehicles": names, "shape": "points", "points_m": points, "middle_m": [50, 0, 15]}
        found = await ask("plan.make", formation=star)
        assert found["certificate"]["certified"]
        wanted = [(x + 47.0, y - 3.0, z + 15.0 - 2.0 / 3.0) for x, y, z in points]
        assert all(any(near(list(goal), place, 0.01) for place in wanted) for goal in ends(found["plan"]).values())
        with pytest.raises(RefusedError, match="2 points for 3 vehicles"):
            await ask("plan.make", formation=star | {"points_m": points[:2]})
        with pytest.raises(RefusedError, match="a circle needs its middle"):
            await ask("plan.make", formation={"vehicles": names, "shape": "circle"})


def ends(content: dict[str, Any]) -> dict[str, list[float]]:
    """The last place of each vehicle of a plan as JSON."""
    plan, _ = plan_from_json("the plan", content)
    if isinstance(plan, TimedPlan):
        return {name: list(path.end_enu_m) for name, path in plan.trajectories.items()}
    return {name: list(leg[1]) for name, leg in plan.legs()[-1][1].items()}


async def test_what_cannot_be_planned_is_refused_with_a_reason(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2) as gcs:
        ask = planning(gcs)
        with pytest.raises(TargetError, match="v9"):
            await ask("plan.make", goals={"v9": [0, 0, 10]})
        with pytest.raises(InvalidParams, match="v1 is there twice"):
            await ask("plan.make", goals={"v1": [0, 0, 10], "1": [9, 0, 10]})
        with pytest.raises(RefusedError, match="margin"):
            await ask("plan.make", goals={"v1": [0, 0, 10]}, margin_m=-1.0)
        with pytest.raises(RefusedError, match="speed_mps"):
            await ask("plan.make", goals={"v1": [0, 0, 10]}, limits={"speed_mps": 0.0})
        with pytest.raises(SkygcsError, match="format"):
            await ask("plan.certify", plan={"kind": "timed"})
        gcs.daemon.fleet.set_origin(None, force=True)
        with pytest.raises(RefusedError, match=r"origin\.set"):
            await ask("plan.make", goals={"v1": [0, 0, 10]})
        assert (await ask("plan.make", goals={"v1": [0, 0, 10]}, starts={"v1": [9, 0, 10]}))["unknown"] == ["v2"]


@pytest.mark.deep
async def test_measured_terms_replace_the_defaults_once_there_is_enough(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, delay_s=0.05) as gcs:
        ask = planning(gcs)
        goals = {"v1": [0.0, 30.0, 10.0], "v2": [12.0, 30.0, 10.0]}
        before = (await ask("plan.make", goals=goals, kind="timed"))["certificate"]["closest"]
        assert set(before["sources"]["v1"].values()) == {DEFAULT}
        await gcs.fly("position")
        for _ in range(3):  # there and back, for more than a minute of moving references
            for by_m, seconds in ((30.0, 15.0), (-30.0, 15.0)):
                x_m, y_m, up_m = gcs.place()
                t = seconds
                leg = {"duration_s": t, "x": [x_m], "y": [y_m, 0.0, 3 * by_m / t**2, -2 * by_m / t**3], "up": [up_m]}
                loaded = await gcs("trajectory.load", target="v1", pieces=[leg])
                assert loaded["outcomes"]["v1"]["ok"], loaded
                await gcs.done("trajectory.start", targets="v1", after_s=0.5)
                await asyncio.sleep(t + 3.0)
        after = (await ask("plan.make", goals=goals, kind="timed"))["certificate"]["closest"]
        record = gcs.actor().offboard.tracking
        assert record.measured_s > 60.0
        sources, terms = after["sources"]["v1"], after["terms"]["v1"]
        assert sources["tracking error p99"].startswith("measured over ")
        assert 0.0 < terms["tracking error p99"] < 0.42  # about 0.39 m, and the sketch rounds up by up to 5 %
        timing = "speed × (delay p99 + clock error)"
        assert sources[timing].startswith("delay measured by ") and "clock measured by" in sources[timing]
        assert terms[timing] < before["terms"]["v1"][timing]
        assert set(after["sources"]["v2"].values()) == {DEFAULT}, "it was not flown"
        assert record.delay_s is not None and 0.05 <= record.delay_s <= 0.12, "one way of the link and some"


async def test_none_crosses_on_the_ground(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2) as gcs:
        ask = planning(gcs)
        at = {name: list(gcs.place(name)) for name in ("v1", "v2")}
        swap = {"v1": at["v2"], "v2": at["v1"]}
        assert (await ask("plan.make", goals=swap))["plan"]["space"]["floor_m"] is None
        await gcs.done("vehicles.land", targets="all")
        await gcs.until(lambda: all(gcs.actor(n).vehicle.in_air(gcs.now) is False for n in at), 60.0)
        found = await ask("plan.make", goals=swap)
        (climb, cross, _) = found["plan"]["phases"]
        assert abs(found["plan"]["space"]["floor_m"]) < 0.5
        assert all(place[2] > 5.0 for phase in (climb, cross) for place in phase["goals"].values())
        assert set(climb["goals"]) == {"v1", "v2"}
        # also where nobody crosses: plan.run refuses what does not begin in the air
        x, y, _ = at["v1"]
        aside = {"v1": [x, y + 20.0, 10.0]}
        (climb, *_) = (await ask("plan.make", goals=aside))["plan"]["phases"]
        assert climb["goals"]["v1"][:2] == pytest.approx([x, y], abs=0.5)
        with pytest.raises(RefusedError, match="take off first"):
            await ask("plan.make", goals=aside, kind="timed")
        given = await ask("plan.make", goals=swap, space={"floor_m": -3.0})
        assert given["plan"]["space"]["floor_m"] == -3.0
