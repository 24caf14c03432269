"""One mission for several vehicles: arranged, refused where the missions come too near each other, flown together, and
one after another."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mission.item import MissionItem
from skygcs.core.mission.plan import MissionPlan
from skygcs.core.mission.qgc import write_qgc
from skygcs.core.protocols.command import Outcome
from skygcs.ext.missions.methods import turns_of
from skygcs.runtime import onboard_orders
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.sim.firmware_modes import CopterMode
from support.flown import FIELD, Flown, flown
from support.sim_pilot import int_param

COSTS = "missions of two and three vehicles, each flown from the ground to its landing"


def item(command: int, east_m: float, north_m: float, up_m: float) -> MissionItem:
    lat, lon = FIELD.to_geodetic(east_m, north_m)
    return MissionItem.from_params(command, 3, (0.0, 0.0, 0.0, None, lat, lon, up_m), True)


def mission(*points: tuple[float, float, float], end: str = "return") -> str:
    """Up, along these points (east, north, height), and home, or down, or nothing more."""
    items = [item(22, *points[0]), *(item(16, *point) for point in points[1:])]
    if end == "return":
        items.append(MissionItem.from_params(20, 2, (0.0,) * 7, True))
    elif end == "land":
        items.append(item(21, *points[-1][:2], 0.0))
    return write_qgc(MissionPlan(tuple(items)))


NORTH = ((0.0, 0.0, 10.0), (0.0, 25.0, 10.0), (0.0, 45.0, 10.0))
"""Along the north axis, from the place of v1; the others stand 5 m apart to the east."""

NEAR = ((0.0, 0.0, 6.0), (0.0, 10.0, 6.0), (0.0, 20.0, 6.0))
"""The same, a short one, for those that fly one after another."""

LOW: dict[str, float] = {"RTL_RETURN_ALT": 8.0, "RTL_ALT": 800.0}
"""Heights at which both firmwares return, so that a turn does not take a minute to come down."""


async def landed(gcs: Flown, *names: str, within_s: float = 240.0) -> None:
    await gcs.until(lambda: not any(gcs.sim(name).armed for name in names), within_s)


async def turn(gcs: Flown, name: str) -> dict[str, Any] | None:
    (status,) = await gcs("missions.status", targets=name)
    found: dict[str, Any] | None = status["turn"]
    return found


async def test_where_a_silent_vehicle_was_is_no_place_to_arrange_others_by(tmp_path: Path) -> None:
    """The others were moved by where the first one had been two minutes before."""
    async with flown(tmp_path, takeoff=False, px4=2) as gcs:
        gcs.muted.add(1)
        await asyncio.sleep(30.0)
        call = {"plan": mission(*NORTH), "arrangement": {"kind": "present"}}
        outcomes = (await gcs("missions.upload", targets="all", **call))["outcomes"]
        assert outcomes["v2"]["result"] == "refused", outcomes
        assert "has to be known" in outcomes["v2"]["message"], outcomes


async def test_missions_that_come_too_near_are_refused_and_go_up_when_insisted_on(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        plan = mission(*NORTH)
        narrow = {"kind": "line", "spacing_m": 2.0}
        outcomes = (await gcs("missions.upload", targets="all", plan=plan, arrangement=narrow))["outcomes"]
        for name, other in (("v1", "v2"), ("v2", "v1")):
            text = outcomes[name]["message"]
            assert outcomes[name]["result"] == "refused" and f"{name} would come" in text and f"near {other}" in text
            assert "--force" in text
            (status,) = await gcs("missions.status", targets=name)
            assert status["counts"]["mission"] in (None, 0), "nothing was uploaded"
        await gcs.done("missions.upload", targets="all", plan=plan, arrangement=narrow, force=True)
        # the start is checked again, as of any missions
        refused = (await gcs("missions.start", targets="all"))["outcomes"]["v2"]
        assert refused["result"] == "refused" and "near v1" in refused["message"]


async def test_heights_that_end_with_a_return_need_return_heights_that_differ(tmp_path: Path) -> None:
    """Both came home at one height, 0.8 m apart, by an arrangement that was accepted."""
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        over = mission((2.0, -20.0, 10.0), (2.0, -60.0, 10.0), (2.0, -60.0, 10.0))
        outcomes = (await gcs("missions.upload", targets="all", plan=over, arrangement={"kind": "heights"}))["outcomes"]
        assert outcomes["v1"]["result"] == "refused" and "v1 would come" in outcomes["v1"]["message"], outcomes
        await gcs.done("missions.upload", targets="all", plan=over, arrangement={"kind": "heights"}, force=True)
        refused = (await gcs("missions.start", targets="all"))["outcomes"]["v1"]
        assert refused["result"] == "refused" and "near v2" in refused["message"], refused


async def test_a_vehicle_without_a_mission_to_arrange_is_refused_in_words(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False) as gcs:
        hover = mission((0.0, 0.0, 10.0), end="hold")
        outcomes = (await gcs("missions.upload", targets="all", plan=hover, arrangement={"kind": "line"}))["outcomes"]
        assert all("give a heading" in o["message"] and o["result"] == "refused" for o in outcomes.values()), outcomes


@pytest.mark.parametrize("kind", [{"px4": 3}, {"px4": 1, "ardupilot": 2}], ids=["px4", "mixed"])
async def test_one_after_another_each_starts_when_the_one_before_has_landed(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with flown(tmp_path, takeoff=False, params=LOW, **kind) as gcs:
        await gcs.done("missions.upload", targets="all", plan=mission(*NEAR))
        outcomes = (await gcs("missions.start", targets="all", one_after_another=True))["outcomes"]
        assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
        assert outcomes["v2"]["message"] == "starts when v1 is done or has landed"
        assert await turn(gcs, "v1") == {"turn": 1, "of": 3, "state": "flies"}
        assert await turn(gcs, "v3") == {"turn": 3, "of": 3, "state": "waits"}
        for name in ("v1", "v2", "v3"):
            await gcs.until(lambda name=name: gcs.sim(name).armed, 300.0)  # type: ignore[misc]
            assert sum(sim.armed for sim in gcs.sims) == 1
        await landed(gcs, "v3")
        for truth in gcs.truth.values():
            assert max(look.pos_m[1] for look in truth) > 18.0, "each has flown it"
        together = [looks for looks in zip(*gcs.truth.values(), strict=False) if sum(not t.landed for t in looks) > 1]
        assert not together
        assert await turn(gcs, "v3") is None


async def test_the_next_one_starts_when_the_one_before_holds_at_its_end_out_of_the_way(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False, params=LOW) as gcs:
        await gcs.done("missions.upload", targets="v1", plan=mission(*NEAR, end="hold"))
        away = mission((5.0, 0.0, 6.0), (30.0, 0.0, 6.0), end="hold")
        await gcs.done("missions.upload", targets="v2", plan=away)
        await gcs.done("missions.start", targets="all", one_after_another=True)
        await gcs.until(lambda: gcs.sim("v2").armed, 120.0)
        assert gcs.place("v1")[1] > 17.0 and gcs.sim("v1").armed


async def test_nobody_starts_after_this_computer_has_slept(tmp_path: Path) -> None:
    """The one that flew had been dropped, looked connected for ever, and its mission looked complete."""
    async with flown(tmp_path, px4=2, takeoff=False, params=LOW) as gcs:
        await gcs.done("missions.upload", targets="all", plan=mission(*NEAR))
        await gcs.done("missions.start", targets="all", one_after_another=True)
        await gcs.until(lambda: gcs.place("v1")[2] > 3.0, 60.0)
        before, known = gcs.actor("v1"), gcs.daemon.fleet.sleep.slept_s()
        loop = asyncio.get_running_loop()
        gcs.daemon.fleet.sleep.slept_s = lambda: known + 3600.0
        gcs.daemon.fleet.sleep.clock = lambda: loop.time() + 3600.0
        await asyncio.sleep(5.0)
        assert gcs.actor("v1") is not before and gcs.actor("v1").vehicle.connected
        assert not before.vehicle.connected
        assert await turn(gcs, "v2") is None
        ended = [t for t in gcs.told if t.kind == "mission" and "ended" in t.data]
        assert len(ended) == 1 and "slept for 3600 s; v2 does not start" in ended[0].text, ended
        assert (await before.land()).result == "refused"
        stopped = await before.stop("kill")
        assert stopped.result == "refused" and "slept for 3600 s" in stopped.message, "a stop asked of what was before"
        await gcs.done("vehicles.land", targets="v1")
        await landed(gcs, "v1")
        await asyncio.sleep(20.0)
        assert not gcs.sim("v2").armed


@pytest.mark.deep
@pytest.mark.parametrize(("px4", "mode"), [(2, "AUTO.LAND"), (0, "LAND")], ids=["px4", "ardupilot"])
async def test_nobody_starts_after_another_station_has_landed_the_one_that_flies(
    tmp_path: Path, px4: int, mode: str
) -> None:
    async with flown(tmp_path, px4=px4, ardupilot=2 - px4, takeoff=False, params=LOW) as gcs:
        await gcs.done("missions.upload", targets="all", plan=mission(*NEAR))
        await gcs.done("missions.start", targets="all", one_after_another=True)
        await gcs.until(lambda: gcs.place("v1")[2] > 3.0, 60.0)
        gcs.by_other_station(mav.MAVLink_command_long_message(1, 1, 21, 0, 0, 0, 0, 0, 0, 0, 0))
        await landed(gcs, "v1")
        await asyncio.sleep(20.0)
        assert not gcs.sim("v2").armed
        (ended,) = [t.text for t in gcs.told if t.kind == "mission" and "ended" in t.data]
        assert f"v1 was taken over ({mode}); v2 does not start" in ended


@pytest.mark.parametrize("px4", [2, 0], ids=["px4", "ardupilot"])
@pytest.mark.parametrize("how", ["switched off", "crash check"])
async def test_nobody_starts_after_the_one_that_flies_has_fallen_on_its_last_way_down(
    tmp_path: Path, px4: int, how: str
) -> None:
    """It is on the ground and disarmed by its last item, and counted as landed."""
    async with flown(tmp_path, px4=px4, ardupilot=2 - px4, takeoff=False, params=LOW) as gcs:
        await gcs.done("missions.upload", targets="all", plan=mission(*NEAR, end="land"))
        await gcs.done("missions.start", targets="all", one_after_another=True)
        await gcs.until(lambda: gcs.place("v1")[1] > 18.0 and gcs.place("v1")[2] < 5.0, 120.0)
        if how == "switched off":
            gcs.by_other_station(mav.MAVLink_command_long_message(1, 1, 400, 0, 0, 21196, 0, 0, 0, 0, 0))
        else:
            await gcs.until(lambda: gcs.place("v1")[2] < 1.0, 60.0)
            sim = gcs.sim("v1")
            sim.tx.say(mav.MAV_SEVERITY_EMERGENCY, "Crash: Disarming: AngErr=40>30, Accel=1.2<3.0")
            sim.switch_off("crash")
        await landed(gcs, "v1")
        await asyncio.sleep(20.0)
        assert not gcs.sim("v2").armed
        (ended,) = [t.text for t in gcs.told if t.kind == "mission" and "ended" in t.data]
        assert "v1 has not landed: " in ended and "v2 does not start" in ended


async def test_the_next_one_starts_though_the_ground_lies_above_home(tmp_path: Path) -> None:
    """An ArduCopter keeps home until it is armed: 6 m above it a disarmed one counted as flying, without end."""
    async with flown(tmp_path, px4=0, ardupilot=2, takeoff=False, params=LOW) as gcs:
        await gcs.done("missions.upload", targets="v1", plan=mission(*NEAR, end="land"))
        await gcs.done("missions.upload", targets="v2", plan=mission((5.0, 0.0, 6.0), (30.0, 0.0, 6.0), end="hold"))
        await gcs.done("missions.start", targets="all", one_after_another=True)
        await gcs.until(lambda: gcs.place("v1")[1] > 18.0 and gcs.place("v1")[2] < 5.0, 120.0)
        home = gcs.sim("v1").home
        assert home is not None
        gcs.sim("v1").set_home(replace(home, up_m=home.up_m - 6.0))
        await gcs.until(lambda: gcs.sim("v2").armed, 120.0)
        assert not gcs.sim("v1").armed


async def test_without_evidence_of_a_landing_nobody_starts_and_an_event_says_why(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False, params=LOW) as gcs:
        await gcs.done("missions.upload", targets="all", plan=mission(*NEAR, end="land"))
        await gcs.done("missions.start", targets="all", one_after_another=True)
        await gcs.until(lambda: gcs.place("v1")[1] > 18.0 and gcs.place("v1")[2] < 5.0, 120.0)
        sim = gcs.sim("v1")
        sim.builders = {name: build for name, build in sim.builders.items() if name != "ATTITUDE"}
        await landed(gcs, "v1")
        await asyncio.sleep(80.0)
        assert not gcs.sim("v2").armed
        (ended,) = [t.text for t in gcs.told if t.kind == "mission" and "ended" in t.data]
        assert "no attitude has come since it was disarmed" in ended and "v2 does not start" in ended


@pytest.mark.deep
async def test_stop_to_all_ends_the_turns_in_the_moment_between_two_of_them(tmp_path: Path) -> None:
    """The first one is down and disarmed, so that STOP moves nobody."""
    async with flown(tmp_path, px4=2, takeoff=False, params=LOW) as gcs:
        await gcs.done("missions.upload", targets="all", plan=mission(*NEAR))
        await gcs.done("missions.start", targets="all", one_after_another=True)
        await gcs.until(lambda: gcs.place("v1")[2] > 3.0, 60.0)
        await gcs.until(lambda: gcs.actor("v1").vehicle.armed is False, 240.0)
        await gcs("vehicles.stop", targets="all")
        await asyncio.sleep(20.0)
        assert not gcs.sim("v2").armed


async def test_nobody_starts_after_the_one_that_flies_is_lost_or_the_turns_are_ended(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False, params=LOW) as gcs:
        await gcs.done("missions.upload", targets="all", plan=mission(*NEAR))
        await gcs.done("missions.start", targets="all", one_after_another=True)
        second = gcs("missions.start", targets="all", one_after_another=True)
        with pytest.raises(Exception, match="one after another; end that first"):
            await second
        await gcs.until(lambda: gcs.place("v1")[2] > 3.0, 60.0)
        gcs.muted.add(1)
        await gcs.until(lambda: any("v1 is not heard" in t.text for t in gcs.told), 120.0)
        await asyncio.sleep(20.0)
        assert not gcs.sim("v2").armed
        assert await gcs("missions.end_turns") == {"ended": False}
        gcs.muted.clear()
        await landed(gcs, "v1")
        await asyncio.sleep(5.0)
        await gcs.done("missions.start", targets="all", one_after_another=True)
        assert await gcs("missions.end_turns") == {"ended": True}
        await landed(gcs, "v1")
        await asyncio.sleep(20.0)
        assert not gcs.sim("v2").armed


async def test_a_refused_start_ends_the_turns_before_anything_flies(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False, params=LOW) as gcs:
        gcs.sim("v1").faults.refuse_arming = "not today"
        await gcs.done("missions.upload", targets="all", plan=mission(*NEAR))
        outcomes = (await gcs("missions.start", targets="all", one_after_another=True))["outcomes"]
        assert not outcomes["v1"]["ok"] and outcomes["v2"]["result"] == "refused", outcomes
        await asyncio.sleep(20.0)
        assert not any(sim.armed for sim in gcs.sims)


async def test_the_current_item_has_one_number_everywhere(tmp_path: Path) -> None:
    """A PX4 counts from 0 on the wire; its state, its status, its events and the file count from 1."""
    async with flown(tmp_path, px4=1, ardupilot=1, takeoff=False) as gcs:
        await gcs.done("missions.upload", targets="all", plan=mission(*NORTH), arrangement={"kind": "present"})
        await gcs.done("missions.start", targets="all")
        for name, seq in (("v1", 2), ("v2", 3)):
            await gcs.until(
                lambda name=name: (
                    (gcs.actor(name).vehicle.telemetry("mission") or {})["seq"]  # type: ignore[misc]
                    == (2 if name == "v1" else 3)
                ),
                120.0,
            )
            state = await gcs("vehicles.get", target=name)
            (status,) = await gcs("missions.status", targets=name)
            assert (state["mission"]["seq"], state["mission"]["item"], status["item"]) == (seq, 3, 3)
            await gcs.until(lambda name=name: gcs.place(name)[1] > 30.0, 60.0)  # type: ignore[misc]
            texts = gcs.texts(0.0, "mission", name)
            assert any("goes on with item 3" in text for text in texts), texts


async def test_rovers_take_turns_though_they_stand_armed_after_their_return(tmp_path: Path) -> None:
    """The second one never started: a return counted as ending disarmed on the ground."""
    async with flown(tmp_path, px4=0, takeoff=False, others={"rover": 2}) as gcs:
        for n, sim in enumerate(gcs.sims):
            east_m = sim.motion.pos_enu_m[0]
            items = (item(16, east_m, 15.0, 0.0), item(16, east_m, 25.0, 0.0))
            plan = MissionPlan((*items, MissionItem.from_params(20, 2, (0.0,) * 7, True)))
            await gcs.done("missions.upload", targets=f"v{n + 1}", plan=write_qgc(plan))
        outcomes = (await gcs("missions.start", targets="all", one_after_another=True))["outcomes"]
        assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
        first, second = gcs.sims
        await gcs.until(lambda: first.motion.pos_enu_m[1] > 20.0, 120.0)
        assert not second.armed
        await gcs.until(lambda: second.armed, 180.0)
        assert first.armed and first.motion.pos_enu_m[1] < 6.0


async def test_the_next_one_starts_when_a_return_that_began_above_its_home_has_ended_there(tmp_path: Path) -> None:
    """A PX4 whose last waypoint is above its home stood there as its return began, and the next one started into the
    space in which it then climbed, and came down again."""
    params = {"RTL_LAND_DELAY": -1.0, "RTL_RETURN_ALT": 25.0, "RTL_CONE_ANG": int_param(0), "RTL_DESCEND_ALT": 12.0}
    async with flown(tmp_path, px4=2, takeoff=False, params=params) as gcs:
        lat, lon = FIELD.to_geodetic(0.0, 0.0)
        above_home = MissionItem.from_params(16, 3, (3.0, 0.0, 0.0, None, lat, lon, 6.0), True)
        items = (item(22, *NEAR[0]), item(16, *NEAR[1]), above_home, MissionItem.from_params(20, 2, (0.0,) * 7, True))
        plan = write_qgc(MissionPlan(items))
        await gcs.done("missions.upload", targets="all", plan=plan, arrangement={"kind": "present"})
        await gcs.done("missions.start", targets="all", one_after_another=True)
        await gcs.until(lambda: any("with item 4" in text for text in gcs.texts(0.0, "mission")), 120.0)
        assert abs(gcs.place("v1")[2] - 6.0) < 1.0 and math.hypot(*gcs.place("v1")[:2]) < 1.0, "it is above its home"
        await gcs.until(lambda: gcs.sim("v2").armed, 120.0)
        looks = [look.pos_m[2] for look in gcs.truth[1]]
        assert max(looks) > 24.0 and abs(looks[-1] - 12.0) < 0.5, "it has climbed, and holds at RTL_DESCEND_ALT"


async def test_one_that_waits_and_that_its_pilot_takes_ends_the_turns(tmp_path: Path) -> None:
    """Its mission began when its turn came, minutes after he had taken it."""
    async with flown(tmp_path, px4=0, ardupilot=2) as gcs:
        await gcs.done("missions.upload", targets="v1", plan=mission(*NEAR, end=""))
        await gcs.done("missions.upload", targets="v2", plan=mission((5.0, 0.0, 10.0), (5.0, 15.0, 10.0), end=""))
        await gcs.done("missions.start", targets="all", one_after_another=True, force=True)
        gcs.other_sets_mode(CopterMode.LOITER, sysid=2)
        await gcs.until(lambda: gcs.actor("v1").missions.complete, 120.0)
        await asyncio.sleep(10.0)
        assert gcs.actor("v2").vehicle.mode == "LOITER"
        texts = gcs.texts(0.0, "mission")
        assert any("v2: it was switched to LOITER since, which its pilot flies" in text for text in texts), texts


async def test_an_order_that_is_refused_ends_no_turns(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=2, takeoff=False, params=LOW) as gcs:
        await gcs.done("missions.upload", targets="all", plan=mission(*NEAR))
        await gcs.done("missions.start", targets="all", one_after_another=True)
        await gcs.until(lambda: gcs.place("v1")[2] > 3.0, 60.0)
        for name in ("v1", "v2"):
            gcs.sim(name).faults.refuse_mode = "not now"
            assert not (await gcs.outcome("vehicles.mode", targets=name, mode="AUTO.LOITER"))["ok"]
            gcs.sim(name).faults.refuse_mode = ""
        await gcs.until(lambda: gcs.sim("v2").armed, 240.0)


async def test_an_order_that_comes_before_the_start_has_been_answered_ends_the_turns(tmp_path: Path) -> None:
    """It was taken for the start itself: its number was the last one when the start's answer was looked at."""
    async with flown(tmp_path, px4=0, ardupilot=2, takeoff=False) as gcs:
        await gcs.done("missions.upload", targets="all", plan=mission(*NEAR), force=True)
        orders, starts = gcs.daemon.fleet.orders, onboard_orders.start_mission

        async def start(actor: VehicleActor) -> Outcome:
            outcomes = await orders.command_all(actor.name, starts, force=True)
            assert (await orders.command_all(actor.name, starts, first=2, force=True))[actor.name].ok
            return outcomes[actor.name]

        assert (await turns_of(gcs.daemon).begin([gcs.actor("v1"), gcs.actor("v2")], start))["v1"].ok
        await gcs.until(
            lambda: any("v1 was ordered something else; v2 does not start" in t for t in gcs.texts(0.0, "mission")), 5.0
        )
