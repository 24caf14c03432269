"""Each vehicle's outcome as it comes, in a whole daemon: an emergency stop of four of which one does not hear us."""

from __future__ import annotations

import asyncio
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import MissionType
from skygcs.core.monitor.departures import Departures
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.offboard_controller import OffboardState
from skygcs.runtime import returns
from skygcs.runtime.task_set import ORDER_SERIAL, ask
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.sim.firmware_modes import CopterMode
from support.flown import FIELD, Flown, aloft
from support.grounded import on_the_ground
from support.returning import all_down, swapped
from support.table import each


class Seen:
    """What a client is told, with the seconds since the order."""

    def __init__(self, gcs: Flown) -> None:
        self._gcs, self._began = gcs, gcs.now
        self.vehicles: list[str] = []
        self.came: dict[str, tuple[float, Any]] = {}

    def begun(self, vehicles: Iterable[str], /) -> None:
        self.vehicles = list(vehicles)

    def ended(self, vehicle: str, outcome: Any, /) -> None:
        self.came[vehicle] = (self._gcs.now - self._began, outcome)


async def put_mission(gcs: Flown, name: str) -> None:
    """A mission 40 m to the north, as another station puts it on board: it is read before its start."""
    x, y, up = gcs.place(name)
    lat, lon = FIELD.to_geodetic(x, y + 40.0)
    items = [f"{n}\t0\t3\t{what}\t0\t0\t0\t0\t{lat}\t{lon}\t{up}\t1" for n, what in enumerate((16, 22, 16))]
    await gcs.done("missions.upload", targets=name, plan="\n".join(["QGC WPL 110", *items]))
    gcs.actor(name).missions.forget(MissionType.MISSION)


@pytest.mark.deep
async def test_a_stop_shows_who_holds_at_once_although_one_does_not_hear_it(tmp_path: Path) -> None:
    """It showed nothing for 30 s: of ten seven had confirmed and two had refused within a second."""
    async with aloft(tmp_path, px4=2, ardupilot=2) as gcs:
        gcs.sim("v2").faults.deaf = True
        gcs.sim("v4").faults.refuse_mode = "requires position"
        seen = Seen(gcs)
        outcomes = (await gcs("vehicles.stop", targets="all", reports=seen))["outcomes"]
        assert seen.vehicles == list(outcomes)
        assert {name: outcome.as_dict() for name, (_, outcome) in seen.came.items()} == outcomes
        took_s = {name: at for name, (at, _) in seen.came.items()}
        assert max(at for name, at in took_s.items() if name != "v2") < 2.0, took_s
        assert took_s["v2"] > 25.0 and not outcomes["v2"]["ok"]
        assert [name for name in outcomes if not outcomes[name]["ok"]] == ["v2", "v4"]
        assert "requires position" in outcomes["v4"]["message"]


@pytest.mark.parametrize(
    ("earlier", "later"),
    [("vehicles.goto", "vehicles.land"), ("vehicles.goto", "a pilot"), ("missions.start", "vehicles.land")],
)
async def test_an_order_that_waited_does_not_overtake_one_that_came_later(
    tmp_path: Path, earlier: str, later: str
) -> None:
    """A goto that waited for the take-off of v2, and a mission start that read the missions, broke off a landing that
    v1 was ordered meanwhile, or that its pilot had chosen."""
    async with aloft(tmp_path, px4=0, ardupilot=2) as gcs:
        x, y, up = gcs.place("v1")
        if earlier == "vehicles.goto":
            await gcs.lands("v2")
            await gcs.done("vehicles.takeoff", targets="v2", height_m=15.0)
            params: dict[str, Any] = {"enu_m": [x + 40.0, y, up]}
        else:
            for name in ("v1", "v2"):
                await put_mission(gcs, name)
            params = {}
        waits = asyncio.create_task(gcs(earlier, targets=["v1", "v2"], **params))
        await asyncio.sleep(0.1)
        assert not waits.done()
        if later == "a pilot":
            gcs.other_sets_mode(CopterMode.LAND)
            await gcs.until(lambda: gcs.actor("v1").vehicle.mode == "LAND", 3.0)
        else:
            await gcs.done(later, targets="v1")
        outcome = (await waits)["outcomes"]["v1"]
        assert not outcome["ok"], outcome
        assert ("LAND while this order waited" if later == "a pilot" else "a newer order") in outcome["message"]
        await gcs.until(lambda: not gcs.sim("v1").armed, 60.0)
        assert abs(gcs.place("v1")[0] - x) < 3.0 and abs(gcs.place("v1")[1] - y) < 3.0


async def test_an_order_to_return_is_made_void_by_no_older_one_and_none_of_the_daemons_own(tmp_path: Path) -> None:
    """A start of missions, or another order to return, that was asked for before and came too late took those that
    wait for their return out of it without a word; so did a hold of the daemon's own, or a mode of a failsafe, while it
    was decided who leaves first: both hovered until their batteries were empty."""
    async with aloft(tmp_path, px4=0, ardupilot=2) as gcs:
        await swapped(gcs)
        for name in ("v1", "v2"):
            await put_mission(gcs, name)
        held = gcs.actor("v1")
        decide, decided = returns.departing, 0

        def departing(*args: Any) -> Generator[None, None, Departures]:
            nonlocal decided
            decided += 1
            if decided == 1:
                holds = held.unattended
                holds._tasks.start(holds._hold(), "hold")
                gcs.actor("v2").vehicle.custom_mode = int(CopterMode.BRAKE)
                yield
            return (yield from decide(*args))

        start = asyncio.create_task(gcs("missions.start", targets=["v1", "v2"]))
        await asyncio.sleep(0.1)
        assert not start.done()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(returns, "departing", departing)
            first, second = await asyncio.gather(gcs("vehicles.rtl", targets="all"), gcs("vehicles.rtl", targets="all"))
        assert decided >= 2
        assert [o["ok"] for o in second["outcomes"].values()] == [True, True], second
        assert [o["ok"] for o in first["outcomes"].values()] == [False, False], "the hold of the other one"
        late = (await start)["outcomes"]
        assert all("a newer order" in late[name]["message"] for name in ("v1", "v2")), late
        await all_down(gcs)


async def test_a_failsafe_that_acts_while_returns_are_decided_is_not_broken_off(tmp_path: Path) -> None:
    """The hold of one that had to wait ended the landing of its own failsafe."""
    async with aloft(tmp_path, px4=0, ardupilot=2) as gcs:
        await swapped(gcs)
        decide, changed = returns.departing, False

        def departing(*args: Any) -> Generator[None, None, Departures]:
            nonlocal changed
            if not changed:
                changed = True
                for name in ("v1", "v2"):
                    gcs.sim(name).mode = CopterMode.LAND
                    gcs.actor(name).vehicle.custom_mode = int(CopterMode.LAND)
            return (yield from decide(*args))

        since = gcs.now
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(returns, "departing", departing)
            outcomes = (await gcs("vehicles.rtl", targets="all"))["outcomes"]
        waited = [name for name, outcome in outcomes.items() if "it is in LAND" in outcome["message"]]
        assert waited and not any(gcs.commands(since, name) for name in waited), outcomes


async def test_one_that_waits_for_its_return_is_left_to_whoever_took_it(tmp_path: Path) -> None:
    """v1 was brought home out of its pilot's hands, and v2, which was ordered to land while it was decided that it
    leaves, flew home."""
    async with aloft(tmp_path, px4=0, ardupilot=2) as gcs:
        await swapped(gcs)
        going = gcs.daemon.fleet.returns
        decide, lands = going._decide, list[asyncio.Task[Any]]()

        async def deciding(free: Sequence[VehicleActor]) -> Departures:
            decided = await decide(free)
            if not lands and any(actor.name == "v2" for actor in free):
                lands.append(asyncio.create_task(gcs("vehicles.land", targets="v2")))
                await asyncio.sleep(0.002)
            return Departures((gcs.actor("v2").vehicle.key,), {}, {}) if len(lands) == 1 else decided

        await gcs("vehicles.rtl", targets="all")
        going._decide = deciding  # type: ignore[method-assign]
        gcs.other_sets_mode(int(CopterMode.LOITER))
        await gcs.until(lambda: gcs.actor("v1").vehicle.mode == "LOITER", 3.0)
        since = gcs.now
        await gcs.until(lambda: not gcs.sim("v2").armed, 60.0)
        assert gcs.actor("v1").vehicle.mode == "LOITER" and gcs.actor("v2").vehicle.mode == "LAND"
        assert not [one for one in gcs.commands(since) if one.values["command"] == mav_cmd.NAV_RETURN_TO_LAUNCH]
        told = {name: " ".join(gcs.texts(0.0, "command", name)) for name in ("v1", "v2")}
        assert "it was switched to LOITER" in told["v1"] and "it was ordered something else" in told["v2"]


@pytest.mark.parametrize("ordered_here", [True, False])
async def test_a_goto_that_waited_for_a_takeoff_breaks_off_no_landing(tmp_path: Path, ordered_here: bool) -> None:
    """It went on although a pilot, or the station that had the vehicle take off, landed it at the end of that."""
    async with aloft(tmp_path, px4=1, control={"engage_after_takeoff": "position"} if ordered_here else {}) as gcs:
        await gcs.lands()
        actor = gcs.actor("v1")
        await gcs.done("vehicles.takeoff", targets="v1", height_m=6.0 if ordered_here else 25.0)
        if not ordered_here:
            actor.takeoffs.cancel()
            await gcs.until(lambda: actor.vehicle.mode == "AUTO.TAKEOFF", 10.0)
        x, y, _ = gcs.place("v1")
        waits = asyncio.create_task(gcs("vehicles.goto", targets="v1", enu_m=[x + 30.0, y, 12.0]))
        if ordered_here:
            await gcs.until(lambda: actor.offboard.controller.state is OffboardState.ENGAGING, 60.0)
        else:
            await asyncio.sleep(2.0)
        assert not waits.done()
        gcs.other_sets_mode(4, 6)  # AUTO.LAND
        outcome = (await waits)["outcomes"]["v1"]
        assert not outcome["ok"] and "it was switched to AUTO.LAND" in outcome["message"], outcome
        await gcs.until(lambda: not gcs.sim("v1").armed, 60.0)
        assert abs(gcs.place("v1")[0] - x) < 3.0


async def test_an_order_during_our_climb_takes_one_that_waits_for_its_return(tmp_path: Path) -> None:
    """The number of that order was taken for that of the climb, and v2 was brought home out of its way there."""
    async with aloft(tmp_path, px4=0, ardupilot=2) as gcs:
        await swapped(gcs)
        await gcs("vehicles.rtl", targets="all")
        await gcs.until(lambda: any("it climbs by" in text for text in gcs.texts(0.0, "command", "v2")), 5.0)
        await asyncio.sleep(0.3)
        x, y, up = gcs.place("v2")
        await gcs.done("vehicles.goto", targets="v2", enu_m=[x + 20.0, y + 20.0, up], force=True)
        told = " ".join(gcs.texts(0.0, "command", "v2"))
        assert "a newer order took its place since" in told, "it came during the climb"
        await gcs.until(lambda: not gcs.sim("v1").armed, 120.0)
        assert gcs.sim("v2").armed and abs(gcs.place("v2")[0] - x - 20.0) < 1.0
        assert "it was ordered something else" in " ".join(gcs.texts(0.0, "command", "v2"))


async def test_an_order_that_is_sent_in_the_same_turn_of_the_loop_is_the_later_one_too(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=1) as gcs:
        given, (x, y, up) = gcs.daemon.fleet.orders, gcs.place("v1")
        looks, lands = given._late, list[asyncio.Task[Any]]()

        async def land() -> Outcome:
            ORDER_SERIAL.set(ask())
            return await gcs.actor("v1").land()

        def late(*args: Any) -> dict[VehicleActor, str]:
            if not lands:
                lands.append(asyncio.create_task(land()))  # it starts before the tasks that send the goto
            return looks(*args)

        given._late = late  # type: ignore[method-assign]
        outcome = await gcs.outcome("vehicles.goto", enu_m=[x + 30.0, y, up])
        assert not outcome["ok"] and "a newer order" in outcome["message"], outcome
        assert (await lands[0]).ok


async def test_what_a_pilot_switches_while_control_is_being_prepared_wins(tmp_path: Path) -> None:
    """A joystick with --engage does this: the mode of setpoints went out over a switch of the same second, while
    parameters were read."""
    async with aloft(tmp_path, px4=1) as gcs:
        since, gcs.uplink_delay_s = gcs.now, 1.0
        engaging = asyncio.create_task(gcs.outcome("control.set", mode="attitude"))
        await asyncio.sleep(0.2)
        gcs.other_sets_mode(4, 6)  # AUTO.LAND
        outcome = await engaging
        assert not outcome["ok"] and "another program switched it to AUTO.LAND meanwhile" in outcome["message"]
        assert not gcs.commands(since) and not gcs.setpoints(since)
        # who orders it after the switch is obeyed
        gcs.uplink_delay_s = 0.0
        await gcs.fly("attitude")
        await gcs.done("vehicles.hold")


@pytest.mark.parametrize("later", ["goto", "trajectory", "control mode"])
async def test_a_goto_that_waited_does_not_move_the_reference_of_a_later_order(tmp_path: Path, later: str) -> None:
    """Under control by setpoints these are no orders to the autopilot, and did not count as the later ones: a
    trajectory was broken off in its first second."""
    async with aloft(tmp_path, px4=2) as gcs:
        await gcs.lands("v2")
        await gcs.fly("position", "v1")
        await gcs.done("vehicles.takeoff", targets="v2", height_m=15.0)
        x, y, up = gcs.place("v1")
        waits = asyncio.create_task(gcs("vehicles.goto", targets=["v1", "v2"], enu_m=[x, y + 40.0, up]))
        await asyncio.sleep(0.1)
        assert not waits.done()
        match later:
            case "goto":
                await gcs.done("vehicles.goto", targets="v1", enu_m=[x, y - 10.0, up])
            case "trajectory":
                t, by_m = 20.0, -10.0
                north = [y, 0.0, 3 * by_m / t**2, -2 * by_m / t**3]
                piece = {"duration_s": t, "x": [x], "y": north, "up": [up], "yaw": [0.0]}
                await gcs("trajectory.load", target="v1", pieces=[piece], name="leg")
                await gcs.done("trajectory.start", targets="v1", after_s=0.5)
            case _:
                await gcs.fly("velocity", "v1")
        outcome = (await waits)["outcomes"]["v1"]
        assert not outcome["ok"] and "a newer order" in outcome["message"], outcome
        if later != "control mode":
            await gcs.until(lambda: abs(gcs.place("v1")[1] - y + 10.0) < 1.0, 30.0)
        await gcs.done("vehicles.hold", targets="v1")


async def test_a_goto_that_waits_for_a_takeoff_is_made_void_by_no_order_that_is_refused(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=1) as gcs:
        await gcs.lands()
        await gcs.done("vehicles.takeoff", targets="v1", height_m=15.0)
        x, y, _ = gcs.place("v1")
        waits = asyncio.create_task(gcs.outcome("vehicles.goto", enu_m=[x, y + 30.0, 15.0]))
        await asyncio.sleep(0.5)
        gcs.sim("v1").faults.refuse_mode = "not now"
        assert not (await gcs.outcome("vehicles.mode", mode="LOITER", force=True))["ok"]
        gcs.sim("v1").faults.refuse_mode = ""
        assert not (await gcs.outcome("vehicles.takeoff", height_m=20.0))["ok"]
        assert not waits.done()
        assert (await waits)["ok"]
        await gcs.until(lambda: abs(gcs.place("v1")[1] - y - 30.0) < 1.0, 30.0)


async def test_where_one_flies_is_forgotten_by_no_order_that_it_refuses(tmp_path: Path) -> None:
    """The place was free for another one as soon as anything else had been tried with the first."""
    async with aloft(tmp_path, px4=0, ardupilot=2) as gcs:
        x, y, up = gcs.place("v1")
        there = {"enu_m": [x, y + 80.0, up]}
        await gcs.done("vehicles.goto", targets="v1", **there)
        gcs.sim("v1").faults.refuse_mode = "not now"
        assert not (await gcs.outcome("vehicles.mode", mode="LOITER", force=True))["ok"]
        outcome = await gcs.outcome("vehicles.goto", targets="v2", **there)
        assert outcome["result"] == "refused" and "v1" in outcome["message"], outcome


@pytest.mark.parametrize("order", ["vehicles.land", "vehicles.rtl"])
@pytest.mark.parametrize("name", ["v1", "v2"])
@pytest.mark.parametrize("after_s", [0.05, 0.3])
async def test_a_landing_that_comes_before_the_heartbeat_shows_the_arming_brings_it_down(
    tmp_path: Path, name: str, order: str, after_s: float
) -> None:
    """A PX4 and an ArduCopter in SITL stayed armed: "it is on the ground and disarmed already; nothing was sent"."""
    async with on_the_ground(tmp_path, delay_s=0.1) as gcs:
        sim = gcs.sim(name)
        takes_off = asyncio.create_task(gcs("vehicles.takeoff", targets=name, height_m=6.0))
        await asyncio.sleep(after_s)
        outcome = (await gcs(order, targets=name))["outcomes"][name]
        await takes_off
        assert outcome["ok"] and "nothing was sent" not in outcome["message"], outcome
        await gcs.until(lambda: not sim.armed, 60.0)


def armings(gcs: Flown, since: float, name: str) -> list[float]:
    """The commands that were sent to it since then: 1 for each that arms, 0 for each that disarms."""
    ids = [c for c in gcs.commands(since - 1e-6, name) if c.values["command"] == mav_cmd.COMPONENT_ARM_DISARM]
    return [c.values["param1"] for c in ids]


@each("name", ["v1", "v2"])
@each(
    ("disarmed_s", "answers", "sent"),
    [
        (None, ["accepted", "accepted"], [1.0, 1.0]),
        (0.1, ["cancelled", "cancelled"], [1.0, 0.0]),
        (0.3, ["accepted", "cancelled"], [1.0, 1.0, 0.0]),
        (1.2, ["accepted", "accepted"], [1.0, 1.0, 0.0]),
    ],
)
async def test_two_clients_who_arm_at_once_undo_no_disarming_by_a_third(
    tmp_path: Path, disarmed_s: float | None, answers: list[str], sent: list[float], name: str
) -> None:
    async with on_the_ground(tmp_path, delay_s=0.1) as gcs:
        since = gcs.now
        both = [asyncio.create_task(gcs.outcome("vehicles.arm", name)) for _ in range(2)]
        if disarmed_s is not None:
            await asyncio.sleep(disarmed_s)
            await gcs.done("vehicles.disarm", name)
        assert [(await one)["result"] for one in both] == answers
        await asyncio.sleep(5.0)
        assert armings(gcs, since, name) == sent and gcs.sim(name).armed is (disarmed_s is None)


@each("name", ["v1", "v2"])
@each("disarms", [True, False])
async def test_an_arming_that_waited_for_an_equal_one_is_not_sent_once_that_has_shown(
    tmp_path: Path, name: str, disarms: bool
) -> None:
    """Its answer was lost. The other client's went out after it, and armed what a pilot had disarmed meanwhile.

    What the second is told depends on whether a heartbeat has shown the disarming when its turn comes.
    """
    async with on_the_ground(tmp_path) as gcs:
        gcs.sim(name).faults.ack_loss = 1.0
        since = gcs.now
        both = [asyncio.create_task(gcs.outcome("vehicles.arm", name)) for _ in range(2)]
        await gcs.until(lambda: gcs.actor(name).vehicle.armed, 2.0)
        if disarms:
            gcs.by_other_station(mav.MAVLink_command_long_message(gcs.sim(name).sysid, 1, 400, 0, *[0.0] * 7))
        first, second = [await one for one in both]
        shown_armed = gcs.actor(name).vehicle.armed
        again = "refused: it was armed since this was ordered, and is disarmed again"
        assert (first["message"], second["message"]) == ("armed", "armed" if shown_armed else again)
        await asyncio.sleep(5.0)
        assert armings(gcs, since, name) == [1.0] and gcs.sim(name).armed is not disarms
