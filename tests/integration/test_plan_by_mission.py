"""Plans on board as missions: nobody waits for anybody, and losing the ground loses nothing."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.plan.fleet_plan import PhasedPlan
from skygcs.errors import RefusedError
from support.flown import SETPOINTS, Flown, aloft, flown
from support.planned import (
    MARGIN_M,
    UP_M,
    above,
    least_distance,
    load,
    phased,
    plan_events,
    refused,
    run,
    state,
    swap,
    timed,
)

OVER = ("finished", "stopped", "aborted")
BREAKS_OFF = {"FS_GCS_ENABLE": 1.0, "FS_OPTIONS": 16.0, "NAV_DLL_ACT": 2.0}
GOES_ON = {"FS_OPTIONS": 18.0, "COM_DLL_EXCEPT": 3.0}


def parallel(gcs: Flown) -> PhasedPlan:
    """Each to the north, up, and to the side; nobody's way is near another's."""
    homes = above(gcs, up_m=0.0)
    north = {name: (x, y + 12.0 + 33.0 * i, UP_M) for i, (name, (x, y, _)) in enumerate(homes.items())}
    aside = {name: (x + (4.0 if i else -4.0), y, UP_M + 4.0) for i, (name, (x, y, _)) in enumerate(north.items())}
    return phased(homes, ("climb", above(gcs)), ("north", north), ("aside", aside))


async def begun(gcs: Flown, **params: Any) -> PhasedPlan:
    """The plan while all are on their ways to the north."""
    plan = parallel(gcs)
    await run(gcs, plan, by="onboard", **params)
    await gcs.until(lambda: state(gcs) == "flying", 180.0)
    for sim in gcs.sims:
        home = gcs.place_of_home(f"v{sim.sysid}")
        await gcs.until(lambda sim=sim, home=home: gcs.place(f"v{sim.sysid}")[1] > home[1] + 5.0, 40.0)
    return plan


def at_goals(gcs: Flown, plan: PhasedPlan) -> bool:
    return all(math.dist(gcs.place(name), leg[1]) < 1.0 for name, leg in plan.legs()[-1][1].items())


@pytest.mark.deep
@pytest.mark.parametrize("silent_s", [20.0, 400.0])
async def test_losing_the_ground_loses_nothing(tmp_path: Path, silent_s: float) -> None:
    """For a while, or for good: both come to their goals in the time that it takes."""
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        for sim in gcs.sims:
            for param, value in (BREAKS_OFF | GOES_ON).items():
                sim.params.set(param, value)
        plan = await begun(gcs)
        began = gcs.now
        gcs.cut = True
        await asyncio.sleep(silent_s)
        if silent_s > 60.0:
            assert at_goals(gcs, plan)
            return
        assert state(gcs) == "flying", plan_events(gcs, began)
        gcs.cut = False
        await gcs.until(lambda: state(gcs) in OVER, 120.0)
        assert state(gcs) == "finished" and at_goals(gcs, plan), plan_events(gcs)
        assert least_distance(gcs, began)[0] > MARGIN_M and not [s for s in gcs.sent if s.name in SETPOINTS]


async def test_a_plan_that_needs_its_barriers_is_refused_with_the_pair(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        await load(gcs, swap(gcs))
        report = await gcs("plan.check", by="mission", margin_m=MARGIN_M, force=True)
        assert not report["ok"]
        text = " ".join(refused(report))
        assert (
            "as missions, without barriers" in text and "cross and descend" in text and "v1 and v2 come within" in text
        )
        report = await gcs("plan.check", by="goto", margin_m=MARGIN_M, force=True)
        assert report["ok"], refused(report)


async def test_a_timed_plan_is_refused_with_the_command_that_makes_phases(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=1, ardupilot=1) as gcs:
        here = {name: gcs.place(name) for name in ("v1", "v2")}
        await load(gcs, timed(here, {name: (x, y + 10.0, up) for name, (x, y, up) in here.items()}))
        with pytest.raises(RefusedError, match="missions, which have no times: `skygcs-cli plan make FILE"):
            await gcs("plan.check", by="mission")


async def test_a_vehicle_that_breaks_its_mission_off_without_the_ground_is_refused_until_it_does_not(
    tmp_path: Path,
) -> None:
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        for sim in gcs.sims:
            for param, value in BREAKS_OFF.items():
                sim.params.set(param, value)
        await load(gcs, parallel(gcs))
        for param, value in (("COM_DLL_EXCEPT", 3.0), ("FS_OPTIONS", 18.0)):
            report = await gcs("plan.check", by="mission", margin_m=MARGIN_M)
            found = [f for f in report["findings"] if f["check"] == "if skygcs dies" and f["severity"] == "refused"]
            command = found[0]["command"]
            assert command == f"skygcs-cli param set {found[0]['vehicle']} {param} {value:g}", found
            _, _, _, name, *_ = command.split()
            outcome = await gcs("params.set", targets=name, params={param: value})
            assert outcome
        report = await gcs("plan.check", by="mission", margin_m=MARGIN_M)
        assert not [f for f in report["findings"] if f["check"] == "if skygcs dies" and f["severity"] == "refused"]


async def test_one_that_has_ended_its_mission_stays_when_the_others_go_on_after_a_pause(tmp_path: Path) -> None:
    """A PX4 holds in AUTO.LOITER then, and would fly an ended mission again, from its begin."""
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        plan = await begun(gcs)
        goal = plan.legs()[-1][1]["v1"][1]
        first = next(actor for actor in gcs.daemon.fleet.vehicles.values() if actor.name == "v1")
        await gcs.until(lambda: first.vehicle.mode == "AUTO.LOITER" and math.dist(gcs.place("v1"), goal) < 0.5, 90.0)
        assert state(gcs) == "flying", plan_events(gcs)
        since = gcs.now
        await gcs("plan.pause")
        await asyncio.sleep(10.0)
        answer = await gcs("plan.resume")
        assert answer["ok"], answer
        await gcs.until(lambda: state(gcs) in OVER, 120.0)
        assert state(gcs) == "finished" and at_goals(gcs, plan), plan_events(gcs)
        assert all(math.dist(t.pos_m, goal) < 1.0 for t in gcs.truth[1] if t.at >= since)


@pytest.mark.deep
async def test_an_abort_while_an_order_is_repeated_is_the_last_word(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        await run(gcs, parallel(gcs), by="mission")
        await gcs.until(lambda: state(gcs) == "takeoff", 120.0)
        gcs.loses = frozenset({"COMMAND_INT", "MISSION_COUNT"})
        await gcs.until(lambda: state(gcs) == "engaging", 120.0)
        await gcs.until(lambda: any(t.kind == "command" and "no answer" in t.text for t in gcs.told), 40.0)
        await gcs("plan.abort")  # between two of them
        gcs.loses = frozenset()
        await gcs.until(lambda: state(gcs) == "aborted", 40.0)
        since = gcs.now
        await asyncio.sleep(70.0)
        late = [s for s in gcs.sent if s.at > since and s.name in ("COMMAND_INT", "MISSION_COUNT")]
        assert not late, [(s.at - since, s.name) for s in late]


async def test_a_pilot_stops_the_others_and_it_is_not_resumed(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        await begun(gcs)
        since = gcs.now
        gcs.other_sets_mode(5, sysid=2)  # LOITER
        await gcs.until(lambda: state(gcs) == "stopped", 5.0)
        assert "v2 left: it was switched to LOITER" in " ".join(plan_events(gcs, since))
        await asyncio.sleep(10.0)
        assert not gcs.commands(since + 2.0, "v2") and gcs.is_safe("v1")
        answer = await gcs("plan.resume", force=True)
        assert not answer["ok"] and "plan abort" in answer["message"], answer
