"""Missions of whole vehicles: the actor and its transfers against scripted autopilots that store them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.frame import encode
from skygcs.core.mission.fence import FencePlan, FencePolygon
from skygcs.core.mission.firmware_items import for_firmware, grouped
from skygcs.core.mission.item import MissionItem, MissionType
from skygcs.core.mission.plan import MissionPlan, PlannedHome
from skygcs.core.protocols.mission_upload import event_id
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.runtime import onboard_orders
from skygcs.runtime.mission_transfers import MAX_WAITING
from skygcs.runtime.vehicle_actor import VehicleActor
from support.mission_vehicle import ArduPilotMission, MissionVehicle, Px4Mission, Reply
from support.vehicles import (
    ARDUPILOT,
    HOME,
    PX4,
    PX4_LOITER,
    Ground,
    ScriptedVehicle,
    Sent,
    accept_everything,
    flight_dialect,
    parsed,
)

pytestmark = pytest.mark.looptime

MISSION, FENCE, RALLY = MissionType.MISSION, MissionType.FENCE, MissionType.RALLY
PX4_MISSION = 4 << 16 | 4 << 24
SET_CURRENT, START, ARM, MODE = 224, 300, 400, 176


class Storing:
    """A scripted vehicle with the three lists of one autopilot; what `accept_everything` does, it does too."""

    def __init__(self, vehicle: ScriptedVehicle, kind: type[MissionVehicle]) -> None:
        self.vehicle = vehicle
        self.lists: dict[int, MissionVehicle] = {n: kind(kind=n) for n in range(3)}
        self.mute: set[str] = set()
        vehicle.script = self._script
        self._task = asyncio.get_running_loop().create_task(self._tick())

    def _script(self, vehicle: ScriptedVehicle, sent: Sent) -> None:
        if sent.name.startswith("MISSION_") and sent.name != "MISSION_SET_CURRENT":
            store = self.lists[sent.mission_type]
            store.now = asyncio.get_running_loop().time()
            self._answer(store, store.hear(sent.name, sent.message.to_dict()))
        else:
            accept_everything(vehicle, sent)
            if sent.name == "COMMAND_LONG" and sent.command == START:
                vehicle.mode = 3
                vehicle.flying = True

    def _answer(self, store: MissionVehicle, replies: list[Reply]) -> None:
        for name, fields, _ in replies:
            if name not in self.mute:
                whole = {"target_system": 255, "target_component": 25, "mission_type": store.kind, **fields}
                if name == "MISSION_ITEM_INT":
                    whole["current"] = 0
                kind = mav.mavlink_map[getattr(mav, f"MAVLINK_MSG_ID_{name}")]
                self.vehicle.tell(self.vehicle.say(kind(**whole)))

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(0.1)
            for store in self.lists.values():
                store.now = asyncio.get_running_loop().time()
                self._answer(store, store.tick())

    async def stop(self) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    def current(self, seq: int, state: int = 3, total: int = 0) -> None:
        self.vehicle.tell(self.vehicle.say(mav.MAVLink_mission_current_message(seq, total, state)))

    def reached(self, seq: int) -> None:
        self.vehicle.tell(self.vehicle.say(mav.MAVLink_mission_item_reached_message(seq)))


class Site:
    """A ground with one vehicle that stores missions."""

    def __init__(self, autopilot: int = PX4) -> None:
        self.autopilot = autopilot
        self.ground = Ground()

    async def __aenter__(self) -> tuple[Ground, Storing, VehicleActor]:
        vehicle = ScriptedVehicle(self.ground, 1, self.autopilot)
        self.storing = Storing(vehicle, Px4Mission if self.autopilot == PX4 else ArduPilotMission)
        (actor,) = await self.ground.met(vehicle)
        return self.ground, self.storing, actor

    async def __aexit__(self, *error: object) -> None:
        await self.storing.stop()
        await self.ground.__aexit__(*error)


def near(north_m: float = 0.0, height_m: float = 20.0, command: int = 16) -> MissionItem:
    place = (HOME[0] + north_m / 111_000, HOME[1])
    return MissionItem.from_params(command, 3, (0.0, 0.0, 0.0, None, *place, height_m), True)


JUMP = MissionItem(177, 2, (2.0, 1.0, 0.0, 0.0))
PLAN = MissionPlan(
    mission=(near(command=22), near(30), near(60), JUMP),
    fence=FencePlan((FencePolygon(True, tuple((HOME[0] + a, HOME[1] + b) for a, b in
                                          ((-0.01, -0.01), (-0.01, 0.01), (0.01, 0.01), (0.01, -0.01)))),)),
    rally=(near(10, 15, 5100),),
    home=PlannedHome(HOME[0], HOME[1], 488.0),
)  # fmt: skip
ALL = tuple(MissionType)


def all_set(item: MissionItem) -> MissionItem:
    p1, p2, p3, p4 = (value or 0.0 for value in item.params)
    return replace(item, params=(p1, p2, p3, p4))


async def test_a_flight_that_begins_while_an_upload_waits_for_its_turn_keeps_its_fence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with Site() as (_, storing, actor):
        asked = [asyncio.ensure_future(onboard_orders.upload_plan(actor, plan=PLAN, kinds=(FENCE,))) for _ in range(3)]
        await asyncio.sleep(0)
        monkeypatch.setattr(actor.services.locks, "refusal", lambda change: "a flight stands on it")
        assert [(await one).message for one in asked] == ["refused: a flight stands on it"] * 3
        assert not storing.lists[1].items


@pytest.mark.parametrize("order", ["upload", "clear"])
async def test_a_flight_that_begins_behind_another_transfer_keeps_its_fence(
    monkeypatch: pytest.MonkeyPatch, order: str
) -> None:
    async with Site() as (_, storing, actor):
        assert (await onboard_orders.upload_plan(actor, plan=PLAN, kinds=ALL)).ok
        before = list(storing.lists[1].items)
        reading = asyncio.ensure_future(onboard_orders.download_plan(actor, ALL))
        await asyncio.sleep(0.1)
        assert actor.missions.status()["transfer"] is not None, "it has to wait behind this one"
        asked = asyncio.ensure_future(
            onboard_orders.upload_plan(actor, plan=PLAN, kinds=(FENCE,))
            if order == "upload"
            else onboard_orders.clear_plan(actor, kinds=(FENCE,))
        )
        await asyncio.sleep(0.1)
        assert not asked.done() and not reading.done()
        monkeypatch.setattr(actor.services.locks, "refusal", lambda change: "a flight stands on it")
        assert (await asked).message == "fence: refused: a flight stands on it"
        assert (await reading)[0].ok
        assert storing.lists[1].items == before


async def test_a_mission_that_is_flown_by_its_turn_is_not_replaced() -> None:
    async with Site() as (_, storing, actor):
        assert (await onboard_orders.upload_plan(actor, plan=PLAN, kinds=ALL)).ok
        before = list(storing.lists[0].items)
        reading = asyncio.ensure_future(onboard_orders.download_plan(actor, ALL))
        await asyncio.sleep(0.1)
        asked = asyncio.ensure_future(onboard_orders.clear_plan(actor, kinds=(MISSION,)))
        await asyncio.sleep(0.1)
        assert not asked.done() and not reading.done()
        storing.vehicle.armed, storing.vehicle.mode = True, PX4_MISSION
        storing.vehicle.pulse()
        assert "it is flying its mission" in (await asked).message
        assert storing.lists[0].items == before
        await reading


@pytest.mark.parametrize("autopilot", [PX4, ARDUPILOT])
async def test_a_plan_goes_up_and_comes_down_unchanged(autopilot: int) -> None:
    async with Site(autopilot) as (ground, storing, actor):
        outcome = await onboard_orders.upload_plan(actor, plan=PLAN, kinds=ALL)
        assert outcome.ok
        assert outcome.message == "4 fence items taken; 1 rally item taken; 4 mission items taken"
        told, down = await onboard_orders.download_plan(actor, ALL)
        assert told.ok, told.message
        assert (down.fence, down.rally) == (PLAN.fence, PLAN.rally)
        if autopilot == PX4:
            assert down.mission == PLAN.mission
        else:
            assert down.mission == tuple(map(all_set, PLAN.mission)), "an ArduPilot keeps no unset number"
        first = storing.lists[0].items[0]
        assert first.command == (22 if autopilot == PX4 else 16)
        assert {s.priority for s in ground.sent if s.name.startswith("MISSION_")} == {Priority.PROTOCOL}
        assert actor.missions.status()["counts"] == {"mission": 4, "fence": 4, "rally": 1}


async def test_an_ardupilots_home_is_item_0_and_jumps_keep_their_numbers() -> None:
    async with Site(ARDUPILOT) as (_, storing, actor):
        await onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,))
        home, *items = storing.lists[0].items
        assert home == PLAN.home.item() if PLAN.home else False
        assert items[3].params[0] == 2.0
    async with Site(PX4) as (_, storing, actor):
        await onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,))
        assert storing.lists[0].items[3].params[0] == 1.0


async def test_a_plan_with_errors_is_refused_with_the_item_and_nothing_is_sent() -> None:
    async with Site() as (ground, storing, actor):
        bad = MissionPlan(mission=(near(command=22), near(5000), near(0, float("nan"))))
        outcome = await onboard_orders.upload_plan(actor, plan=bad, kinds=(MISSION,))
        assert outcome.result == "refused"
        assert "mission item 2: is 5,0" in outcome.message and "from the vehicle" in outcome.message
        assert "mission item 3: the altitude is not set (NaN)" in outcome.message
        assert not [s for s in ground.sent if s.name.startswith("MISSION_")]
        assert (await onboard_orders.upload_plan(actor, plan=bad, kinds=(MISSION,), force=True)).ok
        assert len(storing.lists[0].items) == 3


async def test_an_upload_says_what_it_changed_and_the_check_says_it_before() -> None:
    back = MissionItem.from_params(20, 3, (0.0, 0.0, 0.0, 0.0, *HOME[:2], 20.0), True)
    camera = MissionItem(530, 2)
    plan = MissionPlan(mission=(near(command=22), camera, near(30), back))
    names = load_dialect("ardupilotmega").enums["MAV_CMD"]
    async with Site(PX4) as (_, storing, actor):
        outcome = await onboard_orders.upload_plan(actor, plan=plan, kinds=(MISSION,))
        (line,) = grouped(for_firmware(plan.mission, "px4", names).changes)
        assert outcome.ok and outcome.message == f"4 mission items taken; mission {line}"
        assert line.startswith("item 4: the position of NAV_RETURN_TO_LAUNCH")
        assert (storing.lists[0].items[3].frame, storing.lists[0].items[3].x) == (2, 0)
    async with Site(ARDUPILOT) as (_, storing, actor):
        outcome = await onboard_orders.upload_plan(actor, plan=plan, kinds=(MISSION,))
        (line,) = grouped(for_firmware(plan.mission, "ardupilot", names).changes)
        assert outcome.ok and outcome.message == f"3 mission items taken; mission {line}"
        assert [item.command for item in storing.lists[0].items[1:]] == [22, 16, 20]
        fence = MissionPlan(mission=(camera,), fence=PLAN.fence)
        assert "SET_CAMERA_MODE" not in (await onboard_orders.upload_plan(actor, plan=fence, kinds=(FENCE,))).message


@pytest.mark.parametrize("by", ["event", "text"])
async def test_a_mission_that_a_px4_takes_and_will_not_fly_is_no_success(by: str) -> None:
    async with Site() as (_, storing, actor):
        if by == "event":
            reason = "the take-off is not the first item with a position"
            number = event_id("navigator_mis_takeoff_not_first")
            fields = {"id": number, "arguments": bytes(40)}
            raw = parsed(encode(flight_dialect().by_name["EVENT"], fields, sysid=1, compid=1, seq=0))
        else:
            reason = "Mission rejected: takeoff is not first"
            raw = storing.vehicle.say(mav.MAVLink_statustext_message(2, reason.encode()))
        asyncio.get_running_loop().call_later(0.9, storing.vehicle.tell, raw)
        outcome = await onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,))
        assert (outcome.ok, outcome.result) == (False, "denied")
        assert outcome.message == f"4 mission items taken, and it will not fly them: {reason}"
        again = await onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,))
        assert again.ok, "that was of the last upload"


async def test_a_mission_that_flies_is_not_replaced_or_cleared_unless_insisted_on() -> None:
    async with Site() as (_, storing, actor):
        storing.vehicle.armed, storing.vehicle.mode, storing.vehicle.flying = True, PX4_MISSION, True
        await asyncio.sleep(2)
        assert (
            "it is flying its mission (AUTO.MISSION)"
            in (await onboard_orders.upload_plan(actor, plan=PLAN, kinds=ALL)).message
        )
        assert "it is flying its mission" in (await onboard_orders.clear_plan(actor, kinds=(MISSION,))).message
        assert "without its fence" in (await onboard_orders.clear_plan(actor, kinds=(FENCE,))).message
        assert (await onboard_orders.clear_plan(actor, kinds=(FENCE,), force=True)).ok


async def test_a_list_that_is_not_taken_ends_the_upload_and_says_what_was_not_begun() -> None:
    async with Site() as (_, storing, actor):
        storing.lists[2].capacity = 0
        outcome = await onboard_orders.upload_plan(actor, plan=PLAN, kinds=ALL)
        assert (outcome.ok, outcome.result) == (False, "denied")
        assert outcome.message.startswith("4 fence items taken; ")
        assert "no space" in outcome.message and outcome.message.endswith("mission not begun")


async def test_progress_is_told_in_steps_and_not_per_item() -> None:
    async with Site() as (ground, _, actor):
        long = MissionPlan(mission=(near(command=22), *(near(n) for n in range(1, 100))))
        await onboard_orders.upload_plan(actor, plan=long, kinds=(MISSION,))
        told = [e.data["percent"] for e in ground.events if e.data.get("order") == "mission upload"]
        assert told == [10, 20, 30, 40, 50, 60, 70, 80, 90]


async def test_cancelling_an_upload_tells_the_vehicle_and_says_what_it_holds() -> None:
    async with Site(ARDUPILOT) as (ground, storing, actor):
        task = asyncio.create_task(onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,)))
        await asyncio.sleep(0.25)
        assert actor.missions.status()["transfer"]["what"] == "mission upload"
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert task.cancelled()
        (warning,) = [e for e in ground.events if e.kind == "warning"]
        assert warning.data["state"] == "partial" and "upload it again, or clear it" in warning.text
        await asyncio.sleep(1)
        assert storing.lists[0].cancelled
        assert actor.missions.status()["transfer"] is None
        assert (await onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,))).ok


@pytest.mark.parametrize("end", [VehicleActor.wind_down, VehicleActor.close], ids=["the daemon ends", "it is dropped"])
async def test_an_upload_that_the_daemon_ends_is_a_warning_that_says_what_the_vehicle_holds(
    end: Callable[[VehicleActor], Awaitable[None] | None],
) -> None:
    """It was an event that is not logged, and its client was gone: nobody learned of the mixture."""
    async with Site(ARDUPILOT) as (ground, _, actor):
        task = asyncio.create_task(onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,)))
        await asyncio.sleep(0.25)
        ended = end(actor)
        if ended is not None:
            await ended
        assert (await task).result == "cancelled"
        (warning,) = [e for e in ground.events if e.kind == "warning"]
        assert warning.data["state"] == "partial" and "skygcs is shutting down" in warning.text


async def test_a_lost_vehicle_ends_its_transfer_at_once() -> None:
    async with Site() as (_, storing, actor):
        storing.mute.add("MISSION_COUNT")
        task = asyncio.create_task(onboard_orders.download_plan(actor, (MISSION,)))
        await asyncio.sleep(1)
        storing.vehicle.silent = True
        outcome, _ = await task
        assert outcome.result == "lost" and "the vehicle was lost" in outcome.message


async def test_a_second_vehicle_with_its_id_ends_its_transfer_and_those_that_wait() -> None:
    async with Site() as (ground, storing, actor):
        tasks = [asyncio.create_task(onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,))) for _ in range(2)]
        await asyncio.sleep(0.25)
        ground.fleet.set_duplicate(1 << 8 | 1, "on udp and on radio")
        for outcome in await asyncio.gather(*tasks):
            assert outcome.result == "refused" and "two vehicles with system id 1 are on the air" in outcome.message
        sent = [s.name for s in ground.sent if s.name.startswith("MISSION_")]
        assert sent[-1] == "MISSION_ACK" and sent.count("MISSION_COUNT") == 1, "only that it is given up"
        assert not storing.lists[0].items


async def test_transfers_wait_for_their_turn_and_not_without_end() -> None:
    async with Site() as (_, storing, actor):
        storing.mute.add("MISSION_ACK")
        tasks = [
            asyncio.create_task(onboard_orders.clear_plan(actor, kinds=(MISSION,))) for _ in range(MAX_WAITING + 2)
        ]
        await asyncio.sleep(0.1)
        assert tasks[-1].done() and "transfers are waiting already" in tasks[-1].result().message
        storing.mute.clear()
        assert all(outcome.ok for outcome in await asyncio.gather(*tasks[:-1]))


async def test_answers_for_other_stations_and_other_lists_are_not_ours() -> None:
    async with Site() as (_, storing, actor):
        storing.mute.add("MISSION_ACK")
        task = asyncio.create_task(onboard_orders.clear_plan(actor, kinds=(MISSION,)))
        await asyncio.sleep(0.3)
        say, tell = storing.vehicle.say, storing.vehicle.tell
        tell(say(mav.MAVLink_mission_ack_message(255, 190, 0, 0)))
        tell(say(mav.MAVLink_mission_ack_message(255, 25, 0, 1)))
        await asyncio.sleep(0.3)
        assert not task.done()
        tell(say(mav.MAVLink_mission_ack_message(255, 25, 0, 0)))
        assert (await task).ok


async def test_starting_a_px4_sets_the_item_and_the_mode_and_arms_last() -> None:
    async with Site() as (_, storing, actor):
        outcome = await onboard_orders.start_mission(actor, first=2)
        assert outcome.ok and outcome.message == "flying its mission from item 2"
        commands = [c for c, _ in storing.vehicle.commands()]
        assert commands == [SET_CURRENT, MODE, ARM]
        assert storing.vehicle.commands()[0][1][0] == 1.0
        assert (storing.vehicle.mode, storing.vehicle.armed) == (PX4_MISSION, True)


async def test_a_px4_that_does_not_arm_is_taken_out_of_the_mission_mode_again() -> None:
    async with Site() as (_, storing, actor):
        script = storing.vehicle.script

        def refuse_arming(vehicle: ScriptedVehicle, sent: Sent) -> None:
            if sent.name == "COMMAND_LONG" and sent.command == ARM:
                vehicle.reply(sent, 1)
            else:
                script(vehicle, sent)

        storing.vehicle.script = refuse_arming
        outcome = await onboard_orders.start_mission(actor)
        assert not outcome.ok and "put it in AUTO.LOITER" in outcome.message
        assert storing.vehicle.mode == PX4_LOITER


async def test_starting_a_copter_arms_in_guided_and_then_starts() -> None:
    async with Site(ARDUPILOT) as (_, storing, actor):
        outcome = await onboard_orders.start_mission(actor)
        assert outcome.ok, outcome.message
        assert [c for c, _ in storing.vehicle.commands()] == [SET_CURRENT, MODE, ARM, START]
        assert storing.vehicle.commands()[0][1][0] == 1.0


async def test_resuming_sets_the_mission_mode_and_asks_for_an_armed_vehicle() -> None:
    async with Site() as (_, storing, actor):
        assert "it is not armed; start the mission" in (await onboard_orders.resume_mission(actor)).message
        storing.vehicle.armed = storing.vehicle.flying = True
        await asyncio.sleep(1.5)
        assert (await onboard_orders.resume_mission(actor)).ok
        assert storing.vehicle.mode == PX4_MISSION


async def test_setting_the_current_item_falls_back_to_the_message() -> None:
    async with Site(ARDUPILOT) as (_, storing, actor):
        script = storing.vehicle.script

        def old(vehicle: ScriptedVehicle, sent: Sent) -> None:
            if sent.name == "COMMAND_LONG" and sent.command == SET_CURRENT:
                vehicle.reply(sent, 3)
            elif sent.name == "MISSION_SET_CURRENT":
                storing.current(sent.seq)
            else:
                script(vehicle, sent)

        storing.vehicle.script = old
        outcome = await onboard_orders.set_mission_item(actor, item=2)
        assert outcome.ok and outcome.message == "the current item is 2"
        assert "no item 0" in (await onboard_orders.set_mission_item(actor, item=0)).message


async def test_the_mission_that_flies_is_told_item_by_item() -> None:
    async with Site() as (ground, storing, actor):
        await onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,))
        for seq in (0, 0, 1):
            storing.current(seq)
            await asyncio.sleep(0.2)
        storing.reached(1)
        storing.reached(1)
        await asyncio.sleep(0.2)
        storing.current(2, state=5)
        await asyncio.sleep(0.2)
        storing.current(2, state=1)
        await asyncio.sleep(0.2)
        told = [e.text for e in ground.events if e.kind == "mission"]
        assert told == [
            "goes on with item 2",
            "reached item 2 of 4",
            "goes on with item 3",
            "its mission is complete",
            "it has no mission",  # it was "the mission is no mission"
        ]
        status: dict[str, Any] = actor.missions.status()
        assert (status["item"], status["reached"], status["state"]) == (3, 2, "no mission")


async def test_a_fence_whose_items_make_none_is_no_plan() -> None:
    async with Site() as (_, storing, actor):
        storing.lists[1].items = [MissionItem(5001, 3, (5.0, 0.0, 0.0, 0.0), 470000000, 80000000)]
        outcome, plan = await onboard_orders.download_plan(actor, (FENCE,))
        assert not outcome.ok and "the fence is not closed" in outcome.message
        assert plan.fence == FencePlan()


async def test_an_empty_plan_is_nothing_to_upload() -> None:
    async with Site() as (_, _, actor):
        assert (
            "clear the vehicle's lists"
            in (await onboard_orders.upload_plan(actor, plan=MissionPlan(), kinds=())).message
        )


@pytest.mark.parametrize("order", ["start", "resume", "item"])
async def test_what_was_reached_in_one_run_does_not_count_in_the_next(order: str) -> None:
    """A PX4 goes on repeating the last item that it has reached."""
    async with Site() as (_, storing, actor):
        await onboard_orders.upload_plan(actor, plan=MissionPlan(PLAN.mission[:3]), kinds=(MISSION,))
        for seq in (0, 1, 2):
            storing.current(seq)
            await asyncio.sleep(0.1)  # asyncio's heap of timers does not keep the order of equal times
            storing.reached(seq)
            await asyncio.sleep(0.1)
        await asyncio.sleep(0.2)
        assert actor.missions.complete and actor.missions.status()["reached"] == 3
        storing.vehicle.mode, storing.vehicle.armed = PX4_LOITER, True
        await asyncio.sleep(2.0)
        orders = {
            "start": lambda: onboard_orders.start_mission(actor, first=1, force=True),
            "resume": lambda: onboard_orders.resume_mission(actor),
            "item": lambda: onboard_orders.set_mission_item(actor, item=1),
        }
        task = asyncio.create_task(orders[order]())
        await asyncio.sleep(0.2)
        assert not actor.missions.complete and actor.missions.status()["reached"] is None
        if order != "resume":
            storing.reached(2)
            storing.current(2, state=5)
            await asyncio.sleep(0.2)
            assert not actor.missions.complete and actor.missions.status()["reached"] is None
        for seq in (0, 1, 2):
            storing.current(seq)
            await asyncio.sleep(0.1)  # asyncio's heap of timers does not keep the order of equal times
            storing.reached(seq)
            await asyncio.sleep(0.1)
        await asyncio.sleep(0.2)
        assert actor.missions.complete
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _lost(storing: Storing, actor: VehicleActor) -> None:
    storing.vehicle.silent = True
    await asyncio.sleep(10.0)
    assert not actor.vehicle.connected
    storing.vehicle.silent = False
    await asyncio.sleep(2.0)


async def _restarted(storing: Storing, actor: VehicleActor) -> None:
    actor.restarted("another vehicle", asyncio.get_running_loop().time())


async def _hears(storing: Storing, message: Any) -> None:
    storing.vehicle.tell(storing.vehicle.say(message))
    await asyncio.sleep(0.2)


CHANGES: dict[str, Any] = {
    "another station's mission": lambda s, a: _hears(s, mav.MAVLink_mission_ack_message(250, 190, 0, 0)),
    "another station's fence": lambda s, a: _hears(s, mav.MAVLink_mission_ack_message(250, 190, 0, 1)),
    "another station clears all": lambda s, a: _hears(s, mav.MAVLink_mission_ack_message(250, 190, 0, 255)),
    "another station's is refused": lambda s, a: _hears(s, mav.MAVLink_mission_ack_message(250, 190, 4, 255)),
    "another station's is under way": lambda s, a: _hears(s, mav.MAVLink_mission_request_int_message(250, 190, 1, 0)),
    "another number of items": lambda s, a: _hears(s, mav.MAVLink_mission_current_message(0, 9)),
    "none any more": lambda s, a: _hears(s, mav.MAVLink_mission_current_message(0, 0xFFFF)),
    "lost": _lost,
    "another vehicle": _restarted,
}


@pytest.mark.parametrize(
    ("change", "autopilot", "read"),
    [
        ("another station's mission", PX4, [MISSION]),
        ("another station's fence", PX4, [FENCE]),
        ("another station clears all", PX4, [MISSION, FENCE]),
        ("another station's is refused", PX4, []),
        ("another station's is under way", PX4, []),
        ("another station's is under way", ARDUPILOT, [MISSION]),
        ("another number of items", ARDUPILOT, [MISSION]),
        ("none any more", PX4, [MISSION]),
        ("lost", ARDUPILOT, [MISSION, FENCE]),
        ("another vehicle", PX4, [MISSION, FENCE]),
    ],
)
async def test_a_list_that_may_have_changed_is_read_again_before_it_is_used(
    change: str, autopilot: int, read: list[MissionType]
) -> None:
    async with Site(autopilot) as (ground, storing, actor):
        missions = actor.missions
        assert (await onboard_orders.upload_plan(actor, plan=replace(PLAN, fence=FencePlan()), kinds=(MISSION,))).ok
        assert (await onboard_orders.clear_plan(actor, kinds=(FENCE,))).ok
        held = await missions.known_items()
        assert held is not None and len(held) == 4 and await missions.fence_shapes() == FencePlan()
        assert not [s for s in ground.sent if s.name == "MISSION_REQUEST_LIST"], "nothing is read that is known"
        storing.lists[0].items[-2:] = [near(90)]
        storing.lists[1].items = list(PLAN.items(FENCE))
        await CHANGES[change](storing, actor)
        now = await missions.known_items(), await missions.fence_shapes()
        assert [s.mission_type for s in ground.sent if s.name == "MISSION_REQUEST_LIST"] == read
        assert (len(now[0] or ()), now[1]) == (
            3 if MISSION in read else 4,
            PLAN.fence if FENCE in read else FencePlan(),
        )


async def test_a_run_that_has_ended_stays_so_whoever_changes_the_mission_then() -> None:
    """Else a plan would have it go on, with a mission of somebody else's."""
    async with Site() as (ground, storing, actor):
        await onboard_orders.upload_plan(actor, plan=MissionPlan(PLAN.mission[:2]), kinds=(MISSION,))
        for seq in (0, 1):
            storing.current(seq)
            await asyncio.sleep(0.1)
        await _hears(storing, mav.MAVLink_mission_item_reached_message(1))
        assert actor.missions.complete
        # the same one is read again, once for all who ask
        actor.missions.stop("lost", "a test")
        assert None not in await asyncio.gather(*(actor.missions.known_items() for _ in range(8)))
        assert [s.name for s in ground.sent].count("MISSION_REQUEST_LIST") == 1 and actor.missions.complete
        await CHANGES["another station's mission"](storing, actor)
        assert actor.missions.complete and actor.missions.status()["counts"]["mission"] is None
        actor.missions.run_begins()
        storing.current(1)
        await _hears(storing, mav.MAVLink_mission_item_reached_message(0))
        await _hears(storing, mav.MAVLink_mission_item_reached_message(1))
        assert not actor.missions.complete, "of which item is the last nothing is known"


@pytest.mark.parametrize("how", ["refused here", "denied", "denied after its last item"])
async def test_an_order_that_is_refused_leaves_the_run_that_is_flown_as_it_is(how: str) -> None:
    """Nothing that it reached meanwhile or afterwards counted: those that were to start next waited for two hours."""
    async with Site() as (ground, storing, actor):
        await onboard_orders.upload_plan(actor, plan=MissionPlan(PLAN.mission[:2]), kinds=(MISSION,))
        for seq in (0, 1):
            storing.current(seq)
            await asyncio.sleep(0.1)
        reached = mav.MAVLink_mission_item_reached_message(1)

        def denies(vehicle: ScriptedVehicle, sent: Sent) -> None:
            if how == "denied after its last item":
                vehicle.tell(vehicle.say(reached))
            vehicle.reply(sent, 2, after_s=0.1)

        if how == "refused here":
            actor.authority_refusal = lambda: "another site commands it"
        else:
            storing.vehicle.script = denies
        assert not (await onboard_orders.set_mission_item(actor, item=1)).ok
        storing.current(1)
        if how != "denied after its last item":
            await _hears(storing, reached)
        await asyncio.sleep(0.2)
        assert actor.missions.furthest == 2 and actor.missions.complete
        assert [e.text for e in ground.events if "reached" in e.text] == ["reached item 2 of 2"]


async def test_what_another_station_changes_meanwhile_is_not_what_was_read() -> None:
    async with Site() as (_, storing, actor):
        await onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,))
        task = asyncio.create_task(actor.missions.download(MISSION))
        await asyncio.sleep(0.15)
        await CHANGES["another station's mission"](storing, actor)
        assert (await task).ok and actor.missions.items is None


async def test_a_mission_that_is_being_replaced_is_not_the_one_on_board() -> None:
    async with Site() as (_, _, actor):
        await onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,))
        task = asyncio.create_task(
            onboard_orders.upload_plan(actor, plan=MissionPlan(PLAN.mission[:2]), kinds=(MISSION,))
        )
        await asyncio.sleep(0.15)
        assert len(await actor.missions.known_items() or ()) == 2
        assert (await task).ok


@pytest.mark.parametrize("rejected", [True, False])
@pytest.mark.parametrize("second", ["upload", "clear"])
async def test_the_next_transfer_begins_when_a_px4_has_checked_its_mission(second: str, rejected: bool) -> None:
    """It began before: an upload dropped the reason of a rejection, and a clear was taken for undone."""
    async with Site() as (_, storing, actor):
        first = asyncio.create_task(onboard_orders.upload_plan(actor, plan=PLAN, kinds=(MISSION,)))
        await asyncio.sleep(0.7)
        assert storing.lists[0].items and not first.done()
        if rejected:
            await _hears(storing, mav.MAVLink_statustext_message(2, b"Mission rejected: no"))
        if second == "upload":
            task = asyncio.create_task(onboard_orders.upload_plan(actor, plan=PLAN, kinds=(RALLY,)))
        else:
            task = asyncio.create_task(onboard_orders.clear_plan(actor, kinds=(MISSION,)))
        outcome = await first
        assert outcome.ok is not rejected, outcome.message
        assert outcome.message.endswith("will not fly them: Mission rejected: no" if rejected else " taken")
        assert storing.lists[0].items, "the next one waits"
        assert (await task).ok
        assert len(actor.missions.items or ()) == (4 if second == "upload" else 0) == len(storing.lists[0].items)
