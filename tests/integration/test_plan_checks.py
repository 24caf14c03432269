"""What keeps a plan on the ground: each check by itself, and what insisting passes."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.plan.fleet_plan import FlightSpace
from skygcs.core.trajectory import MotionLimits
from skygcs.runtime.preflight_run import Preflight
from support.flown import Flown, aloft, flown
from support.planned import MARGIN_M, UP_M, above, load, north, phased, refused, state, timed


async def report(gcs: Flown, **params: Any) -> dict[str, Any]:
    found: dict[str, Any] = await gcs("plan.check", **{"margin_m": MARGIN_M, **params})
    json.dumps(found)
    return found


def checks(found: dict[str, Any]) -> set[tuple[str | None, str]]:
    return {(f["vehicle"], f["check"]) for f in found["findings"] if f["severity"] == "refused"}


def set_clocks(gcs: Flown) -> None:
    """The time of day is that of the simulated vehicles."""
    for sim in gcs.sims:
        gcs.actor(f"v{sim.sysid}").part(Preflight).wall_clock = lambda: 1_700_000_000.0 + gcs.now


async def set_apart(gcs: Flown) -> None:
    """Return heights that differ, as the check asks for."""
    set_clocks(gcs)
    for i, sim in enumerate(gcs.sims):
        sim.params.set("RTL_RETURN_ALT", 30.0 + 10 * i)
        sim.params.set("RTL_ALT", 3000 + 1000 * i)


async def test_return_heights_are_refused_insisted_on_or_set(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=2, takeoff=False) as gcs:
        set_clocks(gcs)
        for sim in gcs.sims:
            sim.params.set("RTL_RETURN_ALT", 15.0)
        starts = above(gcs, "v1", "v2", "v3")
        await load(gcs, timed(starts, north(starts)))
        found = await report(gcs)
        assert checks(found) == {("v2", "return height"), ("v3", "return height")}
        assert "all return at once" in refused(found)[0]
        assert (await report(gcs, force=True))["ok"]
        assert sorted(new for _, new, _ in found["return_heights"].values()) == [15.0, 20.0, 25.0]
        answer = await gcs("plan.run", margin_m=MARGIN_M, set_return_heights=True)
        assert answer["started"], refused(answer["report"])
        heights = {gcs.sims[0].params["RTL_RETURN_ALT"], *(sim.params["RTL_ALT"] / 100 for sim in gcs.sims[1:])}
        assert heights == {15.0, 20.0, 25.0}
        await gcs("plan.abort")
        await asyncio.sleep(20.0)


@pytest.mark.deep
async def test_a_low_battery_is_refused_and_the_source_of_the_flight_time_is_named(tmp_path: Path) -> None:
    tables = {"defaults": {"control": {}, "flight_time_min": 2.0, "battery_reserve_percent": 40.0}}
    async with flown(tmp_path, px4=1, takeoff=False, tables=tables) as gcs:
        set_clocks(gcs)
        starts = above(gcs, "v1")
        await load(gcs, timed(starts, north(starts)))
        found = await report(gcs)
        assert checks(found) == {("v1", "battery")}
        assert "flight_time_min of the fleet file" in refused(found)[0] and "40 % stay" in refused(found)[0]
        assert (await report(gcs, force=True))["ok"]


async def test_starts_that_cross_ways_that_cannot_be_flown_and_vehicles_that_are_not_there(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        await set_apart(gcs)
        # starts that cross are reached in layers, or refused below a low ceiling
        a, b = (gcs.place_of_home(name) for name in ("v1", "v2"))
        crossed = {"v1": (*b[:2], UP_M), "v2": (*a[:2], UP_M)}
        await load(gcs, timed(crossed, north(crossed)))
        found = await report(gcs)
        assert found["ok"], refused(found)
        assert [step["name"] for step in found["steps"]][:2] == ["cross", "descend"], found["steps"]
        low = {name: (x, y, 4.0) for name, (x, y, _) in crossed.items()}
        await load(gcs, timed(low, north(low)), FlightSpace(ceiling_m=6.0))
        found = await report(gcs, force=True)
        assert not found["ok"] and any("in layers" in text for text in refused(found)), refused(found)
        # on the ground, beyond the fence, too fast
        starts = above(gcs, "v1", "v2")
        low = {name: (x, y, 0.3) for name, (x, y, _) in north(starts).items()}
        for plan, text in (
            (timed(starts, low), "above the ground"),
            (timed(starts, north(starts, 60.0)), "fence"),
            (timed(starts, north(starts, 30.0), MotionLimits(speed_mps=9.0, acceleration_mps2=6.0)), "is above"),
        ):
            await load(gcs, plan)
            found = await report(gcs, force=True)
            assert not found["ok"] and any(text in line for line in refused(found)), (text, refused(found))
        # what is fine at its own speed is too fast at four times it
        await load(gcs, timed(starts, north(starts)))
        assert (await report(gcs))["ok"]
        assert not (await report(gcs, speed=4.0, force=True))["ok"]
        # vehicles that are unknown, twice, or without a position, and then lost
        for wrong, why in (
            ({"vehicles": {"v1": "v9"}}, "v9"),
            ({"vehicles": {"v1": "v1", "v2": "v1"}}, "given twice"),
            ({"vehicles": {"x": "v1"}}, "has no x"),
            ({"plan": "77"}, "not loaded any more"),
        ):
            with pytest.raises(Exception, match=why):
                await report(gcs, **wrong)
        gcs.muted.add(2)
        await asyncio.sleep(4.0)
        assert {("v2", "position"), ("v2", "state")} & checks(await report(gcs, force=True))
        await asyncio.sleep(8.0)
        assert ("v2", "state") in checks(await report(gcs, force=True))
        # one by itself, and the lost one is an obstacle where it stood
        found = await report(gcs, vehicles={"v1": "v1"})
        assert found["ok"], refused(found)


@pytest.mark.deep
async def test_an_unplanned_one_in_the_air_that_moves_is_refused_and_insisted_on(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2) as gcs:
        await set_apart(gcs)
        starts = above(gcs, "v1")
        await load(gcs, timed(starts, {"v1": (starts["v1"][0] - 12.0, *starts["v1"][1:])}))
        found = await report(gcs)
        assert found["ok"] and any(f["check"] == "others" and f["severity"] == "warning" for f in found["findings"])
        await gcs.done("vehicles.goto", targets="v2", enu_m=[30.0, 30.0, UP_M])
        await asyncio.sleep(3.0)
        found = await report(gcs)
        assert checks(found) == {("v2", "others")}, refused(found)
        assert (await report(gcs, force=True))["ok"]


async def test_one_plan_at_a_time_and_none_in_place_of_one_that_flies(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        for order in ("pause", "resume", "abort", "land"):
            with pytest.raises(Exception, match="no plan is flown"):
                await gcs(f"plan.{order}")
        with pytest.raises(Exception, match="no plan is loaded"):
            await gcs("plan.run")
        starts = above(gcs, "v1", "v2")
        plan = phased(starts, ("cross", north(starts)))
        await load(gcs, plan)
        assert (await gcs("plan.run", margin_m=MARGIN_M, force=True))["started"]
        for method, params in (("plan.load", {"plan": {}}), ("plan.run", {}), ("plan.unload", {})):
            with pytest.raises(Exception, match="abort"):
                await gcs(method, **params)
        await gcs("plan.abort")
        await gcs.until(lambda: state(gcs) == "aborted", 30.0)
        await gcs("plan.unload")
        assert state(gcs) == "none"
        await asyncio.sleep(10.0)
        assert not any(sim.armed and sim.motion.on_ground for sim in gcs.sims)


@pytest.mark.parametrize(
    "content",
    [
        {},
        {"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": {}},
        {"format": "skygcs-plan", "version": 9, "kind": "timed", "vehicles": {"v1": []}},
        {"format": "skygcs-plan", "version": 1, "kind": "phased", "starts": {"v1": [0, 0, None]}, "phases": []},
        {"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": {"v1": [[1e9, [0], [0], [0], None]]}},
        {"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": {f"x{i}": [] for i in range(300)}},
    ],
)
async def test_what_is_no_plan_is_refused_and_the_one_before_is_kept(tmp_path: Path, content: dict[str, Any]) -> None:
    async with flown(tmp_path, px4=1, takeoff=False) as gcs:
        starts = above(gcs, "v1")
        await load(gcs, timed(starts, north(starts)))
        with pytest.raises(Exception) as caught:
            await gcs("plan.load", plan=content)
        assert "Traceback" not in str(caught.value) and "plan" in str(caught.value)
        assert gcs.daemon.fleet.plans.status()["name"] == "test"
