"""The monitor in a whole daemon: encounters, refused orders, formations that are left alone, shutdown."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.geo import EnuFrame
from skygcs.sim.conditions import Conditions, Dynamics
from support.encounters import KINDS, arena, encounter, judge
from support.flown import FIELD, Flown, aloft
from support.made_files import waypoints

EXACT = Conditions(dynamics=Dynamics.KINEMATIC)


@pytest.mark.deep
@pytest.mark.parametrize("seed", range(len(KINDS)), ids=KINDS)
async def test_encounters_are_warned_of_in_time_and_a_hold_prevents_the_collision(seed: int, tmp_path: Path) -> None:
    (judged,) = await judge([seed], tmp_path)
    assert judged.warned_ahead_s >= 5.0, judged
    assert judged.advisory.collided_s is not None and judged.advisory.held == (), "nobody held, and they met"
    assert judged.acting.collided_s is None and judged.acting.held, judged
    assert len(set(judged.acting.held)) == len(judged.acting.held), "each holds once"


def refused_for(outcomes: dict[str, Any], name: str, other: str) -> bool:
    outcome = outcomes[name]
    return not outcome["ok"] and outcome["result"] == "refused" and f" near {other} " in outcome["message"]


async def test_orders_into_another_vehicle_are_refused_with_its_name_unless_insisted_on(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, ardupilot=1, conditions=EXACT) as gcs:
        at = gcs.actor("v2").vehicle.enu_m()
        assert at is not None
        # to its place, through it, and above it within the downwash; beside it and high above it are free
        for enu_m in (at, [at[0] + 2.0, at[1], at[2]], [at[0], at[1], at[2] + 4.0]):
            outcomes = (await gcs("vehicles.goto", targets="v1", enu_m=list(enu_m)))["outcomes"]
            assert refused_for(outcomes, "v1", "v2") and "--force" in outcomes["v1"]["message"], outcomes
        await gcs.done("vehicles.goto", targets="v1", enu_m=[at[0] - 4.0, at[1] + 8.0, at[2]])
        # to where another one was sent, and of two in one order only the one in the way
        outcomes = (await gcs("vehicles.goto", targets="v2", enu_m=[at[0] - 4.0, at[1] + 8.0, at[2]]))["outcomes"]
        assert refused_for(outcomes, "v2", "v1"), outcomes
        await gcs.done("vehicles.goto", targets="v2", enu_m=[at[0] - 4.0, at[1] + 8.0, at[2]], together="v1")
        await gcs.done("vehicles.hold", targets="all")
        # what ends a flight is never refused, and force insists
        await gcs.done("vehicles.goto", targets="v3", enu_m=list(at), force=True)
        for order in ("hold", "land"):
            await gcs.done(f"vehicles.{order}", targets="all")
        # of two that land side by side none returns across the other one, until it is ordered to again
        outcomes = (await gcs("vehicles.rtl", targets="all"))["outcomes"]
        assert {name: outcome["ok"] for name, outcome in outcomes.items()} == {"v1": True, "v2": False, "v3": False}
        assert "not clear of v3" in outcomes["v2"]["message"] and "not clear of v2" in outcomes["v3"]["message"]
        await asyncio.sleep(1.0)
        await gcs.done("vehicles.rtl", targets="v2")
        status = await gcs("monitor.status")
        assert status["counters"]["orders_refused"] == 4


@pytest.mark.parametrize("doing", ["flies", "returns", "takes off"])
async def test_nobody_is_sent_across_the_way_that_another_one_has_still_to_fly(tmp_path: Path, doing: str) -> None:
    """Vehicles under way to a goto were modelled at 5 m/s, returning ones as flying straight on, and those that take
    off as standing."""
    async with aloft(tmp_path, px4=2, conditions=EXACT) as gcs:
        across, takes_off = [-4.0, 12.0, 7.0], None
        match doing:
            case "flies":
                await gcs.done("vehicles.goto", targets="v1", enu_m=[0.0, 24.0, 4.0])
                await asyncio.sleep(2.5)
            case "returns":
                await gcs.done("vehicles.goto", targets="v1", enu_m=[0.0, 24.0, 10.0])
                await asyncio.sleep(12.0)
                await gcs.done("vehicles.rtl", targets="v1")
                across = [0.0, 0.0, 3.0]
            case "takes off":
                await gcs.lands()
                takes_off = asyncio.create_task(gcs.done("vehicles.takeoff", targets="v1", height_m=9.0))
                await asyncio.sleep(0.0)
                across = [0.0, 0.0, 9.0]
        outcomes = (await gcs("vehicles.goto", targets="v2", enu_m=across))["outcomes"]
        assert refused_for(outcomes, "v2", "v1"), outcomes
        if takes_off is not None:
            await takes_off
            outcomes = (await gcs("vehicles.goto", targets="v2", enu_m=across))["outcomes"]
            assert refused_for(outcomes, "v2", "v1"), outcomes
            await gcs.until(lambda: gcs.place("v1")[2] > 8.5, 30.0)
            await gcs.done("vehicles.goto", targets="v1", enu_m=[-8.0, 0.0, 9.0])


@pytest.mark.parametrize("order", ["goto", "mission"])
async def test_nobody_is_sent_so_that_it_turns_into_another_one(order: str, tmp_path: Path) -> None:
    """The way of a fast vehicle to its new place left out the space in which it turns."""
    async with aloft(tmp_path, px4=3, conditions=EXACT) as gcs:
        await gcs.done("vehicles.goto", targets="v1", enu_m=[-40.0, 0.0, 10.0])
        rows = [(3, 16, 0, 0, 0, 0, *FIELD.to_geodetic(east, 60.0), 10.0) for east in (-13.0, -14.0)]
        await gcs("missions.upload", targets="v1", plan=waypoints(*rows).decode(), name="m.waypoints")
        await asyncio.sleep(15.0)
        await gcs.done("vehicles.goto", targets="v2", enu_m=[-5.5, 5.0, 10.0])
        await asyncio.sleep(10.0)
        await gcs.done("vehicles.goto", targets="v1", enu_m=[0.0, 0.0, 10.0])
        await gcs.until(lambda: gcs.place("v1")[0] > -14.0)
        method, where = ("vehicles.goto", {"enu_m": [-13.0, 60.0, 10.0]}) if order == "goto" else ("missions.start", {})
        outcomes = (await gcs(method, targets="v1", **where))["outcomes"]
        assert refused_for(outcomes, "v1", "v2"), outcomes
        # from rest it may
        await gcs.done("vehicles.hold", targets="v1")
        await asyncio.sleep(5.0)
        await gcs.done("vehicles.goto", targets="v1", enu_m=[-40.0, 0.0, 10.0])
        await asyncio.sleep(20.0)
        await gcs.done(method, targets="v1", **where)


@pytest.mark.parametrize("ends", ["by a hold", "disarmed"])
async def test_a_take_off_that_is_over_is_in_nobodys_way(tmp_path: Path, ends: str) -> None:
    """Its way up counted as long as another of the same order went on, and for good if it never left the ground."""
    async with aloft(tmp_path, px4=0, ardupilot=3, conditions=EXACT) as gcs:
        await gcs.done("vehicles.goto", targets="v3", enu_m=[0.0, 8.0, 16.0])
        await gcs.lands("v1", "v2")
        both = asyncio.create_task(gcs("vehicles.takeoff", targets="v1,v2", height_m=30.0))
        if ends == "disarmed":
            await both
            gcs.sim("v1").disarm()
            gcs.sim("v1").motion.up_m = 0.0
            await asyncio.sleep(3.0)
        else:
            await asyncio.sleep(0.0)
            gcs.muted.add(2)
            await gcs.until(lambda: gcs.place("v1")[2] > 0.5, 6.0)
            await gcs.done("vehicles.hold", targets="v1")
            assert not both.done() and gcs.place("v1")[2] < 5.0
        await gcs.done("vehicles.goto", targets="v3", enu_m=[0.0, 0.0, 16.0])
        await both


async def test_a_formation_that_moves_into_its_own_places_is_not_refused(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=3, conditions=EXACT) as gcs:
        before = [gcs.actor(f"v{i}").vehicle.enu_m() for i in (1, 2, 3)]
        middle = before[1]
        assert middle is not None
        await gcs.done("vehicles.goto", targets="all", enu_m=[middle[0] + 5.0, middle[1], middle[2]])
        await asyncio.sleep(15)
        assert [t.text for t in gcs.told if t.kind == "separation" and t.data.get("level") != "notice"] == []


async def test_a_setpoint_into_another_vehicle_is_refused_and_one_away_from_it_taken(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, conditions=EXACT) as gcs:
        await gcs.fly("position")
        at = gcs.actor("v2").vehicle.enu_m()
        assert at is not None
        into = (await gcs("control.setpoint", targets="v1", pos_enu_m=at))["outcomes"]
        assert refused_for(into, "v1", "v2"), into
        velocity = (await gcs("control.setpoint", targets="v1", vel_enu_mps=[2.0, 0.0, 0.0]))["outcomes"]
        assert refused_for(velocity, "v1", "v2"), velocity
        away = [at[0] - 8.0, at[1], at[2]]
        await gcs.done("control.setpoint", targets="v1", pos_enu_m=away)
        await gcs.done("control.setpoint", targets="v1", vel_enu_mps=[-1.0, 0.0, 0.0])
        await gcs.done("control.setpoint", targets="v1", pos_enu_m=at, force=True)


@pytest.mark.deep
async def test_off_watches_nothing_and_refuses_nothing(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, conditions=EXACT, tables={"monitor": {"mode": "off"}}) as gcs:
        await ready_on(gcs, "v1", 10.0, 12.0)
        await gcs.done("trajectory.start", targets="v1")
        await gcs.done("vehicles.hold", targets="v1")
        at = gcs.actor("v2").vehicle.enu_m()
        await gcs.done("vehicles.goto", targets="v1", enu_m=at)
        await asyncio.sleep(10)
        assert not [t for t in gcs.told if t.kind == "separation"]
        status = await gcs("monitor.status")
        assert status["mode"] == "off" and status["counters"]["evaluations"] == 0


async def test_without_an_origin_of_the_fleet_it_watches_as_well(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, conditions=EXACT) as gcs:
        gcs.daemon.fleet.set_origin(None, force=True)
        there = gcs.sim("v2").true_position()
        order = {"targets": "v1", "lat_deg": there[0], "lon_deg": there[1]}
        assert refused_for((await gcs("vehicles.goto", **order))["outcomes"], "v1", "v2")
        await gcs.done("vehicles.goto", **order, force=True)
        await gcs.until(lambda: levels(gcs)[-1:] == ["action"], 10.0)
        assert (await gcs("vehicles.get", target="v1"))["separation"]["with"] == "v2"


async def test_an_operator_who_orders_on_after_a_hold_is_obeyed(tmp_path: Path) -> None:
    async with arena(tmp_path, "acting") as field:
        met = encounter(0)
        flown_once = await field.meet(met)
        assert flown_once.held
        gcs, holder = field.gcs, flown_once.held[0]
        held = [t for t in gcs.told if t.data.get("order") == "hold"]
        goal = met.goals[int(holder[1:]) - 1]
        assert goal is not None
        await gcs.done("vehicles.goto", targets=holder, enu_m=list(goal), force=True)
        await asyncio.sleep(20)
        again = [t for t in gcs.told if t.data.get("order") == "hold" and t.vehicle == holder]
        assert len(again) == len([t for t in held if t.vehicle == holder])
        place = gcs.place(holder)
        assert math.dist(place, goal) < 25.0, "it went on"


async def test_shutdown_in_the_middle_of_a_hold_ends_in_order(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, conditions=EXACT, tables={"monitor": {"mode": "acting"}}) as gcs:
        at = gcs.actor("v2").vehicle.enu_m()
        assert at is not None
        gcs.uplink_delay_s = 1.0
        await gcs.step(-40.0, 0.0, 0.0)
        await asyncio.sleep(15)
        gcs.daemon.loop.create_task(gcs("vehicles.goto", targets="v1", enu_m=at, force=True))
        await gcs.until(lambda: any(t.data.get("order") == "hold" for t in gcs.told), 30.0)
        await gcs.stopped(6.0)


def levels(gcs: Flown) -> list[str]:
    return [t.data["level"] for t in gcs.told if t.kind == "separation" and "level" in t.data]


# --- trajectories -----------------------------------------------------------------------------------------------------


def along_x(x_m: float, y_m: float, by_m: float, seconds: float) -> list[dict[str, Any]]:
    """From rest to rest at 10 m."""
    t = seconds
    return [{"duration_s": t, "x": [x_m, 0.0, 3 * by_m / t**2, -2 * by_m / t**3], "y": [y_m], "up": [10.0]}]


async def ready_on(gcs: Flown, name: str, by_m: float, seconds: float) -> None:
    """Under control, with a trajectory from where it is."""
    await gcs.fly("position", name)
    x_m, y_m, _ = gcs.place(name)
    answer = await gcs("trajectory.load", target=name, pieces=along_x(x_m, y_m, by_m, seconds))
    assert answer["outcomes"][name]["ok"], answer


@pytest.mark.parametrize("doing", ["is sent", "returns"])
async def test_a_trajectory_across_the_way_that_another_one_has_still_to_fly_is_refused(
    doing: str, tmp_path: Path
) -> None:
    """It was taken to be past by then, at 5 m/s; and one that returns to fly straight on."""
    async with aloft(tmp_path, px4=2, conditions=EXACT) as gcs:
        await gcs.done("vehicles.goto", targets="v2", enu_m=[20.0, 30.0, 10.0])
        await asyncio.sleep(20.0)
        await ready_on(gcs, "v1", 40.0, 60.0)
        there = [20.0, -30.0, 10.0]
        await gcs.done("vehicles.goto", targets="v2", enu_m=there)
        if doing == "returns":
            await asyncio.sleep(25.0)
            await gcs.done("vehicles.rtl", targets="v2")
        refused = await gcs.outcome("trajectory.start", "v1")
        assert not refused["ok"] and " near v2 (" in refused["message"], refused
        if doing == "is sent":
            await asyncio.sleep(30.0)
            await gcs.done("trajectory.start", targets="v1")


@pytest.mark.parametrize("order", ["goto", "mission"])
async def test_nobody_is_sent_onto_a_trajectory_that_another_one_follows(order: str, tmp_path: Path) -> None:
    """It counted where it was, or as flying straight on."""
    async with aloft(tmp_path, px4=2, conditions=EXACT) as gcs:
        await gcs.done("vehicles.goto", targets="v2", enu_m=[30.0, 30.0, 10.0])
        await asyncio.sleep(20.0)
        rows = [(3, 16, 0, 0, 0, 0, *FIELD.to_geodetic(30.0, north), 10.0) for north in (20.0, -20.0)]
        await gcs("missions.upload", targets="v2", plan=waypoints(*rows).decode(), name="m.waypoints")
        await ready_on(gcs, "v1", 35.0, 60.0)
        await gcs.done("trajectory.start", targets="v1")
        await asyncio.sleep(2.0)
        if order == "goto":
            outcome = await gcs.outcome("vehicles.goto", "v2", enu_m=[30.0, 0.0, 10.0])
        else:
            outcome = await gcs.outcome("missions.start", "v2")
        assert not outcome["ok"] and "near v1 (on its trajectory)" in outcome["message"], outcome
        # where it was stopped it stands
        await gcs.done("trajectory.pause", targets="v1")
        await asyncio.sleep(3.0)
        assert (await gcs.outcome("vehicles.goto", "v2", enu_m=[30.0, 0.0, 10.0]))["ok"]


async def test_two_starts_at_once_are_checked_one_after_the_other(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2) as gcs:
        await ready_on(gcs, "v1", 2.0, 5.0)
        await ready_on(gcs, "v2", -2.0, 5.0)
        answers = await asyncio.gather(*(gcs.outcome("trajectory.start", name) for name in ("v1", "v2")))
        assert [answer["ok"] for answer in answers] == [True, False], answers
        assert "near v1 (on its trajectory)" in answers[1]["message"]


@pytest.mark.parametrize("known", [True, False], ids=["moved", "removed"])
async def test_a_change_of_origin_in_mid_conflict_changes_no_level_and_no_distance(tmp_path: Path, known: bool) -> None:
    async with aloft(tmp_path, px4=2, conditions=EXACT) as gcs:
        there = gcs.sim("v2").true_position()
        await gcs.done("vehicles.goto", targets="v1", lat_deg=there[0], lon_deg=there[1], force=True)
        await gcs.until(lambda: levels(gcs)[-1:] == ["action"], 10.0)
        before = (await gcs("vehicles.get", target="v1"))["separation"]
        count = len(levels(gcs))
        origin = gcs.daemon.fleet.origin
        assert origin is not None
        # 5 km away and turned, or none
        other = replace(origin, lat_deg=origin.lat_deg + 0.045, x_heading_deg=33.0) if known else None
        gcs.daemon.fleet.set_origin(other, force=True)
        await asyncio.sleep(1.0)
        after = (await gcs("vehicles.get", target="v1"))["separation"]
        assert after["with"] == before["with"] == "v2" and after["level"] == "action"
        assert abs(after["distance_m"] - before["distance_m"]) < 3.0, "no more than it flew meanwhile"
        assert levels(gcs)[count:] in ([], ["warning"]), "no level was begun anew"
        # and an order into the other one is refused as before
        order = {"targets": "v1", "lat_deg": there[0], "lon_deg": there[1]}
        assert refused_for((await gcs("vehicles.goto", **order))["outcomes"], "v1", "v2")


@pytest.mark.parametrize("moved_by", ["setpoints", "another station"])
async def test_a_vehicle_that_was_moved_on_from_where_we_sent_it_is_in_the_way_where_it_is(
    moved_by: str, tmp_path: Path
) -> None:
    """Its old destination was taken for its place: two vehicles met at 0.0005 m."""
    async with aloft(tmp_path, px4=2, conditions=EXACT) as gcs:
        x, y, z = gcs.place("v1")
        if moved_by == "setpoints":
            await gcs.fly("position")
        await gcs.done("vehicles.goto", targets="v1", enu_m=[x - 20.0, y, z])
        await asyncio.sleep(10.0)
        there = [x, y - 12.0, z]
        if moved_by == "setpoints":
            for _ in range(30):
                await gcs.done("control.setpoint", targets="v1", pos_enu_m=there, valid_s=2.0)
                await asyncio.sleep(0.5)
        else:
            lat_deg, lon_deg, alt_m = EnuFrame(gcs.daemon.fleet.origin).to_geodetic(*there)
            at = round(lat_deg * 1e7), round(lon_deg * 1e7)
            gcs.by_other_station(mav.MAVLink_command_int_message(1, 1, 0, 192, 0, 0, -1, 1, 0, math.nan, *at, alt_m))
            await asyncio.sleep(15.0)
        assert math.dist(gcs.place("v1"), there) < 0.5
        outcomes = (await gcs("vehicles.goto", targets="v2", enu_m=there))["outcomes"]
        assert refused_for(outcomes, "v2", "v1"), outcomes


async def test_a_destination_counts_again_when_the_order_that_replaced_it_fails(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, conditions=EXACT) as gcs:
        x, y, z = gcs.place("v1")
        there = [x, y - 80.0, z]
        await gcs.done("vehicles.goto", targets="v1", enu_m=there)
        await asyncio.sleep(2.0)
        with mock.patch.object(gcs.sim().faults, "refuse_mode", "not now"):
            assert (await gcs.outcome("vehicles.goto", enu_m=[x - 50.0, y, z]))["result"] == "temporarily_rejected"
        outcomes = (await gcs("vehicles.goto", targets="v2", enu_m=there))["outcomes"]
        assert refused_for(outcomes, "v2", "v1"), outcomes


async def test_one_that_does_not_go_with_the_others_is_in_their_way(tmp_path: Path) -> None:
    """One refused by its own limit was flown into at 0.04 m, and so was one that was lost in the air."""
    tables = {"vehicles": {"v2": {"sysid": 2, "goto_limit_m": 4.0}}}
    async with aloft(tmp_path, px4=3, conditions=EXACT, tables=tables) as gcs:
        x, y, z = gcs.place("v2")
        # all move by one place to the east: v2 stays, so v1 stays, and v3 goes
        outcomes = (await gcs("vehicles.goto", targets="all", enu_m=[x + 5.0, y, z]))["outcomes"]
        assert refused_for(outcomes, "v1", "v2") and outcomes["v3"]["ok"] and not outcomes["v2"]["ok"], outcomes
        gcs.muted.add(2)
        await asyncio.sleep(30.0)
        outcomes = (await gcs("vehicles.goto", targets="v1,v2", enu_m=[x, y, z], same_place=True))["outcomes"]
        assert refused_for(outcomes, "v1", "v2") and "lost in the air" in outcomes["v1"]["message"], outcomes


async def test_a_goto_that_is_replaced_leaves_the_destination_of_the_newer_one(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, conditions=EXACT) as gcs:
        x, y, z = gcs.place("v1")
        gcs.uplink_delay_s = 0.3
        first = asyncio.create_task(gcs.outcome("vehicles.goto", enu_m=[x - 120.0, y, z]))
        await asyncio.sleep(0.1)
        second = asyncio.create_task(gcs.outcome("vehicles.goto", enu_m=[x, y - 120.0, z]))
        await first
        await second
        outcomes = (await gcs("vehicles.goto", targets="v2", enu_m=[x, y - 120.0, z]))["outcomes"]
        assert refused_for(outcomes, "v2", "v1"), outcomes


async def test_a_destination_ends_with_the_hold_however_many_gotos_came_before(tmp_path: Path) -> None:
    """It was kept in another form when the one before it ended, and never came to its own end."""
    async with aloft(tmp_path, px4=2, conditions=EXACT) as gcs:
        x, y, z = gcs.place("v1")
        far = [[x - 60.0, y, z], [x - 60.0, y - 60.0, z], [x, y - 60.0, z]]
        await gcs.done("vehicles.goto", targets="v1", enu_m=far[0])
        gcs.uplink_delay_s = 0.3
        older = asyncio.create_task(gcs.outcome("vehicles.goto", enu_m=far[1]))
        await asyncio.sleep(0.1)
        newer = asyncio.create_task(gcs.outcome("vehicles.goto", enu_m=far[2]))
        await older
        await newer
        gcs.uplink_delay_s = 0.0
        await gcs.done("vehicles.hold", targets="v1")
        await asyncio.sleep(5.0)
        assert math.dist(gcs.place("v1"), far[2]) > 20.0
        await gcs.done("vehicles.goto", targets="v2", enu_m=far[2])
