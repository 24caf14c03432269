"""Orders that meet returns one after another in the same moment: which of them counts, in a whole daemon.

v1 and v3 stand each on the far side of the other's home, so that their ways home cross, and v2 stands on the crossing
and flies home first. Both become free in the same decision; v1 leaves, and v3 waits for it.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.mavlink import mav_cmd
from skygcs.runtime.returns import SAME_S
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.sim.firmware_modes import CopterMode
from support.flown import Flown, aloft
from support.planned import MARGIN_M, least_distance
from support.returning import all_down, swapped

COSTS = "returns of three vehicles one after another, some flown twice"

PERIOD_S = 0.5
"""The daemon decides so often who leaves."""

CROSSING_NORTH_M = 10.0

RETURN_M = 15.0
"""The simulated ArduCopters fly home so high."""


async def crossed(tmp_path_gcs: Flown) -> None:
    gcs = tmp_path_gcs
    for name, x, y in (("v1", 10.0, 20.0), ("v3", 0.0, 20.0), ("v2", 5.0, CROSSING_NORTH_M)):
        await gcs.done("vehicles.goto", targets=name, enu_m=[x, y, 10.0], force=True)
    await asyncio.sleep(20.0)


def sent_home(gcs: Flown, name: str, since: float) -> float | None:
    """When its order to return was sent; None: it was not."""
    homewards = [s.at for s in gcs.commands(since, name) if s.values["command"] == mav_cmd.NAV_RETURN_TO_LAUNCH]
    return homewards[0] if homewards else None


async def kept_apart(gcs: Flown, since: float) -> None:
    """v3 was not sent home before v1 was past the crossing, and all come down apart."""
    await gcs.until(lambda: sent_home(gcs, "v3", since) is not None, 120.0)
    assert sent_home(gcs, "v1", since) is not None
    north_m = gcs.place("v1")[1]
    assert north_m < CROSSING_NORTH_M - MARGIN_M, f"v1 was {north_m:.1f} m north as v3 left"
    await all_down(gcs)
    assert least_distance(gcs, since)[0] > MARGIN_M


async def leaves(gcs: Flown) -> tuple[int, float]:
    """Order all to return, and let the time pass by periods of the daemon's decisions until v1 is sent home: how many,
    and since when."""
    since = gcs.now
    await gcs("vehicles.rtl", targets="all")
    for periods in range(1, 100):
        await asyncio.sleep(PERIOD_S)
        for _ in range(20):
            await asyncio.sleep(0)
        if sent_home(gcs, "v1", since) is not None:
            return periods, since
    raise AssertionError("v1 never left")


async def test_what_is_being_sent_home_is_on_its_way_before_it_has_answered(tmp_path: Path) -> None:
    """It counted as standing still until its answer came, and v3 left into its way."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await crossed(gcs)
        since = gcs.now
        outcomes = (await gcs("vehicles.rtl", targets="all"))["outcomes"]
        assert {n for n, o in outcomes.items() if "until v2 is out of its way" in o["message"]} == {"v1", "v3"}
        gcs.uplink_delay_s = 3.0
        await kept_apart(gcs, since)


async def test_those_that_wait_keep_clear_of_one_that_is_ordered_to_return_alone(tmp_path: Path) -> None:
    """v1 was none of those that return together, and v3 left into its way."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await crossed(gcs)
        since = gcs.now
        await gcs("vehicles.rtl", targets="v2,v3")
        gcs.uplink_delay_s = 3.0
        alone = asyncio.create_task(gcs("vehicles.rtl", targets="v1"))
        await kept_apart(gcs, since)
        assert (await alone)["outcomes"]["v1"]["ok"]


async def test_one_that_waits_and_is_ordered_to_return_alone_is_on_its_way_before_it_has_answered(
    tmp_path: Path,
) -> None:
    """It counted as standing where it waited, and v3 left into its way."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await crossed(gcs)
        since = gcs.now
        await gcs("vehicles.rtl", targets="all")
        gcs.uplink_delay_s = 3.0
        await gcs.until(lambda: gcs.place("v2")[1] < MARGIN_M + 4.0, 60.0)
        alone = asyncio.create_task(gcs("vehicles.rtl", targets="v1"))
        await kept_apart(gcs, since)
        assert (await alone)["outcomes"]["v1"]["ok"]


async def test_those_that_return_keep_clear_of_one_that_was_ordered_home_before_and_waited_for_nobody(
    tmp_path: Path,
) -> None:
    """The members of an earlier order were forgotten as soon as none of them waited: v3 came within 1 m of v1."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await crossed(gcs)
        await gcs.done("vehicles.goto", targets="v2", enu_m=[-20.0, 0.0, 10.0], force=True)
        await asyncio.sleep(15.0)
        since = gcs.now
        await gcs("vehicles.rtl", targets="v1")
        outcomes = (await gcs("vehicles.rtl", targets="v2,v3"))["outcomes"]
        assert "it holds until v1 is out of its way home" in outcomes["v3"]["message"], outcomes
        await all_down(gcs)
        assert least_distance(gcs, since)[0] > MARGIN_M


async def test_one_that_was_ordered_home_before_and_is_lost_keeps_nobody_in_the_air(tmp_path: Path) -> None:
    """Its space grows, so the others would be given up."""
    async with aloft(tmp_path, px4=0, ardupilot=3, settings={"vehicle_timeout_s": 2.0}) as gcs:
        await crossed(gcs)
        since = gcs.now
        for _ in range(2):  # v2 is in its way: it waits for that only once
            await gcs("vehicles.rtl", targets="v1")
            await asyncio.sleep(SAME_S)
        assert sent_home(gcs, "v1", since)
        gcs.muted.add(1)
        await gcs.until(lambda: any(t.kind == "vehicle_lost" and t.vehicle == "v1" for t in gcs.told), 10.0)
        await gcs("vehicles.rtl", targets="v2,v3")
        await gcs.until(lambda: sent_home(gcs, "v2", since) and sent_home(gcs, "v3", since), 30.0)


async def test_one_that_is_lost_on_its_way_home_keeps_only_its_own_way_from_others(tmp_path: Path) -> None:
    """Its space grew until it reached the others, far away, and they were given up."""
    async with aloft(tmp_path, px4=0, ardupilot=4, settings={"vehicle_timeout_s": 2.0}) as gcs:
        await gcs.done("vehicles.goto", targets="v4", enu_m=[60.0, 0.0, 10.0])
        await crossed(gcs)
        since = gcs.now
        outcomes = (await gcs("vehicles.rtl", targets="all"))["outcomes"]
        assert {n for n, o in outcomes.items() if "until v2 is out of its way" in o["message"]} == {"v1", "v3"}
        gcs.muted.add(4)
        await gcs.until(lambda: not any(sim.armed for sim in gcs.sims[:3]), 150.0)
        assert least_distance(gcs, since)[0] > MARGIN_M


async def test_those_that_wait_keep_clear_of_one_that_comes_down_where_it_is(tmp_path: Path) -> None:
    """v1 waits high above the way of v3, for v2; v3 waits for v4, which crosses its way. As v1 came down it was taken
    to stand, and then to fly home: v3 left below it, and was passed at 0.4 m."""
    async with aloft(tmp_path, px4=0, ardupilot=4) as gcs:
        await gcs("params.get", targets="all", names=["RTL_ALT", "RTL_CLIMB_MIN"])
        for name, *place in (("v1", 10, 3, 34), ("v2", 5, 7, 34), ("v3", 10, 75, 10), ("v4", -5, 12, 10)):
            await gcs.done("vehicles.goto", targets=name, enu_m=place, force=True)
        await asyncio.sleep(25.0)
        since = gcs.now
        outcomes = (await gcs("vehicles.rtl", targets="all"))["outcomes"]
        assert "it holds until v2 is out of its way home" in outcomes["v1"]["message"], outcomes
        assert "it holds until v4 is out of its way home" in outcomes["v3"]["message"], outcomes
        gcs.uplink_delay_s = 2.0
        await gcs.until(lambda: gcs.place("v4")[0] > 11.0, 30.0)
        assert sent_home(gcs, "v3", since) is None
        await gcs.done("vehicles.land", targets="v1")
        await gcs.until(lambda: sent_home(gcs, "v3", since) is not None, 120.0)
        assert gcs.place("v1")[2] < RETURN_M - MARGIN_M, "it is below the way of v3"
        await gcs.until(lambda: not any(sim.armed for sim in gcs.sims), 150.0)
        assert least_distance(gcs, since)[0] > MARGIN_M


async def test_an_order_to_return_that_is_repeated_forgets_nobody_who_has_left(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await crossed(gcs)
        _, since = await leaves(gcs)
        await gcs.until(lambda: "rtl: returning to launch" in gcs.texts(since, "command"), 3.0)
        outcomes = (await gcs("vehicles.rtl", targets="v2,v3"))["outcomes"]
        assert "it holds until v1" in outcomes["v3"]["message"], outcomes
        await kept_apart(gcs, since)


async def test_a_person_who_repeats_the_order_as_often_as_it_is_decided_changes_nothing(tmp_path: Path) -> None:
    """Two decisions at the same time each let another one leave."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await crossed(gcs)
        since = gcs.now
        await gcs("vehicles.rtl", targets="all")
        due = gcs.now
        while sent_home(gcs, "v1", since) is None:
            due += PERIOD_S
            await asyncio.sleep(due - gcs.now)
            await gcs.daemon.fleet.orders.command_all("v2,v3", VehicleActor.rtl)
        await kept_apart(gcs, since)


@pytest.mark.parametrize("turns", range(3))
async def test_an_order_that_comes_as_one_is_sent_home_is_the_later_one(tmp_path: Path, turns: int) -> None:
    """A landing that was ordered between the decision and its order, so many turns of the loop later, was superseded
    by the return."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await crossed(gcs)
        periods, _ = await leaves(gcs)
    async with aloft(tmp_path / "again", px4=0, ardupilot=3) as gcs:
        await crossed(gcs)
        since = gcs.now
        await gcs("vehicles.rtl", targets="all")
        for _ in range(periods):
            await asyncio.sleep(PERIOD_S)
        for _ in range(turns):
            await asyncio.sleep(0)
        place = gcs.place("v1")
        await gcs.done("vehicles.land", targets="v1")
        await gcs.until(lambda: not gcs.sim("v1").armed, 60.0)
        assert abs(gcs.place("v1")[1] - place[1]) < 3.0, "it has landed where it was"
        sent = [one.values["command"] for one in gcs.commands(since, "v1")]
        assert sent[-1] == mav_cmd.NAV_LAND, sent


async def test_an_order_to_all_does_not_reach_one_that_was_ordered_something_later(tmp_path: Path) -> None:
    """All three were told to land by one frame, and v2 had been sent somewhere meanwhile; the goto was the later order,
    though the landing got its number after it."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        since, (x, y, up) = gcs.now, gcs.place("v2")
        land = asyncio.create_task(gcs("vehicles.land", targets="all"))
        goto = asyncio.create_task(gcs("vehicles.goto", targets="v2", enu_m=[x, y + 30.0, up]))
        outcomes = (await land)["outcomes"]
        assert [outcomes[name]["ok"] for name in ("v1", "v2", "v3")] == [True, False, True], outcomes
        assert "a newer order" in outcomes["v2"]["message"]
        assert (await goto)["outcomes"]["v2"]["ok"]
        await asyncio.sleep(15.0)
        assert gcs.sim("v2").mode == CopterMode.GUIDED and abs(gcs.place("v2")[1] - y - 30.0) < 1.0
        assert not [one for one in gcs.sent if one.at > since and one.sysid == 0 and "COMMAND" in one.name]


async def test_an_order_that_is_refused_takes_none_from_its_wait(tmp_path: Path) -> None:
    """v1 did not wait any more, and hovered: after a mode that it refused, and after another order to return."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await crossed(gcs)
        since, faults = gcs.now, gcs.sim("v1").faults
        # while it waits, and while it is decided that it waits
        faults.refuse_mode = "not now"
        rtl = asyncio.create_task(gcs("vehicles.rtl", targets="all"))
        mode = asyncio.create_task(gcs.outcome("vehicles.mode", mode="LOITER", force=True))
        assert not (await mode)["ok"]
        faults.refuse_mode = ""
        outcomes = (await rtl)["outcomes"]
        assert "it holds until v2" in outcomes["v1"]["message"], outcomes
        faults.refuse_mode = "not now"
        assert not (await gcs.outcome("vehicles.mode", mode="LOITER", force=True))["ok"]
        await gcs.until(
            lambda: any("goes on waiting after another order" in t for t in gcs.texts(since, "command")), 3.0
        )
        # as it is to leave
        await gcs.until(lambda: sent_home(gcs, "v1", since) is not None, 60.0)
        await gcs.until(lambda: "rtl: failed: Mode change to RTL failed: not now" in gcs.texts(since, "command"), 3.0)
        assert not (await gcs("vehicles.rtl", targets="v1,v3"))["outcomes"]["v1"]["ok"]
        assert any("the newer order to return failed" in text for text in gcs.texts(since, "command"))
        faults.refuse_mode = ""
        await all_down(gcs)
        assert least_distance(gcs, since)[0] > MARGIN_M


async def test_one_that_was_stopped_on_its_way_up_by_a_repeated_order_climbs_again(tmp_path: Path) -> None:
    """It was taken for one that climbs, and hovered until it was given up."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await swapped(gcs)
        since = gcs.now
        await gcs("vehicles.rtl", targets="v1,v2")
        await gcs.until(lambda: any("it climbs by" in text for text in gcs.texts(since, "command", "v2")), 5.0)
        await gcs.until(lambda: gcs.place("v2")[2] > 11.0, 5.0)
        gcs.uplink_delay_s = 0.3
        hold = asyncio.create_task(gcs("vehicles.hold", targets="v2"))  # so that the next one has to be sent, too
        again = asyncio.create_task(gcs("vehicles.rtl", targets="v1,v2"))
        assert (await again)["outcomes"]["v2"]["ok"] and not (await hold)["outcomes"]["v2"]["ok"]
        await gcs.until(lambda: not gcs.sim("v1").armed and not gcs.sim("v2").armed, 200.0)
        assert not [t for t in gcs.told if "does not return" in t.text]
        assert least_distance(gcs, since)[0] > MARGIN_M


@pytest.mark.parametrize("climbs", [True, False])
async def test_a_return_of_its_own_is_not_broken_off_by_a_repeat_that_comes_late(tmp_path: Path, climbs: bool) -> None:
    """It goes home by its own failsafe, as for a lost ground station, while it does not hear our hold or our climb."""
    async with aloft(tmp_path, px4=0, ardupilot=2 if climbs else 3) as gcs:
        await (swapped if climbs else crossed)(gcs)
        since = gcs.now
        if not climbs:
            gcs.sim("v1").faults.deaf = True
        rtl = asyncio.create_task(gcs("vehicles.rtl", targets="all"))
        if climbs:
            await rtl
            gcs.sim("v2").faults.deaf = True
            await gcs.until(lambda: any("it climbs by" in text for text in gcs.texts(since, "command", "v2")), 5.0)
        await asyncio.sleep(1.2)
        name = "v2" if climbs else "v1"
        gcs.sim(name).faults.deaf = False
        gcs.other_sets_mode(CopterMode.RTL, sysid=int(name[1]))
        outcomes = (await rtl)["outcomes"]
        assert climbs or "it is in RTL" in outcomes["v1"]["message"], outcomes
        await asyncio.sleep(10.0)
        assert gcs.sim(name).mode == CopterMode.RTL


@pytest.mark.deep
async def test_one_that_is_forgotten_is_in_nobodys_way(tmp_path: Path) -> None:
    """v2 is lost on the crossing while it waits for nobody; its space grew until the others were given up."""
    async with aloft(tmp_path, px4=0, ardupilot=3, settings={"vehicle_timeout_s": 2.0}) as gcs:
        await crossed(gcs)
        since = gcs.now
        gcs.sim("v2").faults.refuse_mode = "not now"
        await gcs("vehicles.rtl", targets="all")
        gcs.muted.add(2)
        await gcs.until(lambda: any(t.kind == "vehicle_lost" and t.vehicle == "v2" for t in gcs.told), 10.0)
        assert sent_home(gcs, "v1", since) is None
        assert (await gcs("vehicles.forget", targets="v2", force=True))["outcomes"]["v2"]["ok"]
        await gcs.until(lambda: not gcs.sim("v1").armed and not gcs.sim("v3").armed, 120.0)


@pytest.mark.deep
@pytest.mark.parametrize("below", [True, False])
async def test_one_that_is_given_up_lands_where_it_is_only_onto_nobody(tmp_path: Path, below: bool) -> None:
    """The watch over the operator brings them home in this way."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await swapped(gcs)
        x, y, _ = gcs.place_of_home("v1")  # v2 is above it
        await gcs.done("vehicles.goto", targets="v3", enu_m=[x, y if below else -20.0, 4.0], force=True)
        await asyncio.sleep(15.0)
        since = gcs.now
        await gcs.daemon.fleet.orders.command_all("all", VehicleActor.rtl, at_end="land")
        for sysid in (1, 3):  # their pilots keep them where they are
            gcs.other_sets_mode(CopterMode.LOITER, sysid=sysid)
        ends = "does not land" if below else "it lands where it is"
        await gcs.until(lambda: any(ends in text for text in gcs.texts(since, "command", "v2")), 120.0)
        await asyncio.sleep(3.0)
        assert gcs.sim("v2").mode == (CopterMode.GUIDED if below else CopterMode.LAND)


@pytest.mark.parametrize("turns", range(4))
async def test_an_order_to_return_that_a_standstill_ends_is_answered(tmp_path: Path, turns: int) -> None:
    """It ended without a word while it was decided who leaves first."""
    async with aloft(tmp_path, px4=0, ardupilot=3) as gcs:
        await crossed(gcs)
        since, loop = gcs.now, asyncio.get_running_loop()
        rtl: asyncio.Task[Any] = asyncio.create_task(gcs("vehicles.rtl", targets="all"))
        for _ in range(turns):
            await asyncio.sleep(0)
        assert not [name for name in ("v1", "v2", "v3") if gcs.commands(since, name)], "it is under decision"
        loop.stand_still(10.0)  # type: ignore[attr-defined]
        outcomes = (await rtl)["outcomes"]
        assert {outcome["result"] for outcome in outcomes.values()} == {"cancelled"}, outcomes
        assert all("skygcs stood still" in outcome["message"] for outcome in outcomes.values()), outcomes
        for name in ("v1", "v2", "v3"):
            told = [text for text in gcs.texts(since, "command", name) if text.startswith("rtl: ")]
            assert any("skygcs stood still" in text for text in told), told
            assert not gcs.commands(since, name)


async def test_one_that_was_sent_elsewhere_since_is_not_on_its_way_home(tmp_path: Path) -> None:
    """It counted as flying home for 10 s after its rtl, and another vehicle came down onto it: 0.66 m."""
    async with aloft(tmp_path, px4=2) as gcs:
        await gcs.done("vehicles.goto", targets="v1", enu_m=[0.0, 40.0, 10.0])
        await gcs.done("vehicles.goto", targets="v2", enu_m=[8.0, 16.0, 10.0])
        await asyncio.sleep(20.0)
        await gcs.done("vehicles.rtl", targets="v2")
        await gcs.done("vehicles.goto", targets="v2", enu_m=[-4.0, -8.0, 10.0])
        await gcs.until(lambda: gcs.place("v2")[1] < 12.0)
        outcome = await gcs.outcome("vehicles.rtl", "v1")
        assert "it holds until v2 is out of its way home" in outcome["message"], outcome
