"""Control at the companion: two daemons in virtual time, and a simulated vehicle behind the companion."""

from __future__ import annotations

import asyncio
import itertools
import math
import random
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.trajectory import ClockState
from skygcs.core.trajectory.trajectory_clock import MAX_NOTED
from skygcs.core.vehicle.order_ledger import ClientIdentity
from skygcs.ext.companions import companion_control
from skygcs.runtime.loop_clock import Standstill
from support.companion_pair import Pair, circle, circle_pieces, companion_pair, start_circle
from support.flown import KINDS, SETPOINTS


@KINDS
async def test_the_ground_orders_and_the_companion_flies(tmp_path: Path, kind: dict[str, Any]) -> None:
    async with companion_pair(tmp_path, **kind) as pair:
        shown = pair.control()
        assert shown["state"] == "off" and shown["companion"]["up"]
        outcome = await pair.outcome("control.set", mode="attitude")
        assert outcome["message"] == "flown by attitude setpoints", outcome
        assert pair.control()["state"] == "flying" and pair.control()["control_mode"] == "attitude"
        await pair.done("vehicles.goto", enu_m=[5.0, 0.0, 12.0])
        await asyncio.sleep(12)
        assert pair.pi.place() == pytest.approx((5.0, 0.0, 12.0), abs=0.3)
        assert pair.control()["reference"]["pos_enu_m"] == pytest.approx([5.0, 0.0, 12.0], abs=0.01)
        assert not SETPOINTS & set(pair.from_ground)
        await pair.done("vehicles.hold")
        await pair.until(lambda: pair.control()["state"] == "off", 2.0)
        ended = pair.now
        await asyncio.sleep(10)
        assert not pair.pi.setpoints(ended + 0.1)
        assert pair.pi.is_safe()


async def test_a_companion_obeys_a_ground_that_stood_still(tmp_path: Path) -> None:
    """It took the orders of the ground's new actor, whose numbers began anew, for repeats of those before."""
    async with companion_pair(tmp_path, px4=1) as pair:
        await pair.done("control.set", mode="attitude")
        for x_m in (5.0, 0.0, 5.0, 0.0):
            await pair.done("vehicles.goto", enu_m=[x_m, 0.0, 12.0])
            await asyncio.sleep(2)
        pair.ground.fleet._woke(Standstill(10.0, slept=False))
        await asyncio.sleep(10)
        await pair.done("control.set", mode="attitude")
        await pair.done("vehicles.goto", enu_m=[5.0, 0.0, 12.0])
        await asyncio.sleep(12)
        assert pair.pi.place() == pytest.approx((5.0, 0.0, 12.0), abs=0.3)


@KINDS
async def test_an_order_that_is_denied_leaves_its_companion_flying_it(tmp_path: Path, kind: dict[str, Any]) -> None:
    """The companion never heard that the order was denied: it took no goto, and the next engagement ended control."""
    async with companion_pair(tmp_path, engaged="position", **kind) as pair:
        assert not (await pair.outcome("missions.start"))["ok"]
        await asyncio.sleep(2)
        assert pair.control()["state"] == "flying" and pair.control()["successor"] is None
        await pair.done("vehicles.goto", enu_m=[5.0, 0.0, 10.0])
        await pair.done("control.set", mode="velocity")
        await asyncio.sleep(10)
        assert pair.pi.place()[0] == pytest.approx(5.0, abs=0.5)
        assert pair.pi.setpoints(pair.now - 0.5) and not [t for t in pair.told if t.kind == "unattended"]


async def test_a_hand_over_whose_end_nobody_tells_is_shown_and_ends_with_its_ground(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with companion_pair(tmp_path, px4=1, engaged="position") as pair:
        pair.calls.lose = lambda method, given: given.get("order") == "keep"
        assert not (await pair.outcome("missions.start"))["ok"]
        await asyncio.sleep(2)
        shown = pair.control()
        assert shown["state"] == "flying" and shown["successor"] == "the ground: mission was ordered", shown
        assert "another order takes over" in (await pair.outcome("control.setpoint", pos_enu_m=[5, 0, 10]))["message"]
        await another_ground(pair, monkeypatch)
        await pair.done("vehicles.goto", enu_m=[5.0, 0.0, 10.0])
        await asyncio.sleep(8)
        assert pair.pi.place()[0] == pytest.approx(5.0, abs=0.5) and pair.control()["state"] == "flying"


@pytest.mark.parametrize("radio", [False, True])
async def test_a_goto_while_a_copter_in_guided_is_engaged_is_flown(tmp_path: Path, radio: bool) -> None:
    """Its companion saw no other mode, and held it by setpoints against the goto."""
    async with companion_pair(tmp_path, px4=0, ardupilot=1, radio=radio) as pair:
        engaging = asyncio.create_task(pair.outcome("control.set", mode="velocity"))
        await pair.until(lambda: pair.pi.setpoints(0.0))
        await pair.done("vehicles.goto", enu_m=[8.0, 0.0, 10.0])
        assert not (await engaging)["ok"]
        await asyncio.sleep(15)
        assert pair.pi.place()[0] == pytest.approx(8.0, abs=1.0)
        assert pair.control()["state"] == "off" and not pair.pi.setpoints(pair.now - 5.0)


async def another_ground(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    """The ground's daemon dies and begins again as another process does, with new numbers."""
    await pair.lose_ground()
    monkeypatch.setattr(companion_control, "RUN", "another")
    monkeypatch.setattr(companion_control, "NUMBERS", itertools.count(1))
    await asyncio.sleep(2)
    await pair.ground_begins_again()
    pair.calls.up = True
    await pair.until(lambda: (pair.control().get("companion") or {}).get("up"), 15.0)


async def test_the_setpoints_of_another_ground_are_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The companion took them for older ones than those of the ground before, and answered ok."""
    async with companion_pair(tmp_path, px4=1, engaged="position") as pair:
        for k in range(100):
            await pair.done("control.setpoint", pos_enu_m=[0.01 * k, 0.0, 10.0])
            await asyncio.sleep(0.02)
        await another_ground(pair, monkeypatch)
        await pair.done("control.set", mode="position")
        for _ in range(60):
            await pair.done("control.setpoint", pos_enu_m=[8.0, 0.0, 10.0])
            await asyncio.sleep(0.1)
        assert pair.pi.place()[0] == pytest.approx(8.0, abs=0.5)


async def test_a_client_of_the_companions_own_and_the_ground_do_not_fly_it_in_turns(tmp_path: Path) -> None:
    async with companion_pair(tmp_path, px4=1, engaged="velocity") as pair:
        still = {"vel_enu_mps": [0.0, 0.0, 0.0], "valid_s": 2.0}
        await pair.pi.done("control.setpoint", **still)
        await pair.done("control.setpoint", **still)  # relayed; the answer is that of the next one
        await asyncio.sleep(0.5)
        refused = await pair.outcome("control.setpoint", **still)
        assert "follows the setpoints of client 0" in refused["message"], refused
        await pair.outcome("control.setpoint", take_over=True, **still)
        await asyncio.sleep(0.5)
        assert pair.pi.control()["stream"]["client"] == "the ground"
        assert (await pair.pi.outcome("control.setpoint", **still))["taken"]
        other = ClientIdentity(lambda: "script")
        assert (await pair.outcome("control.setpoint", client=other, **still))["taken"]
        await pair.done("vehicles.goto", enu_m=[3.0, 0.0, 10.0])
        await asyncio.sleep(0.5)
        assert pair.pi.control()["stream"] is None
        await pair.done("control.setpoint", client=other, **still)


async def test_what_the_companion_refuses_the_ground_ends_no_stream_at_either(tmp_path: Path) -> None:
    async with companion_pair(tmp_path, px4=1, engaged="raw") as pair:
        level = {"acc_enu_mps2": [0.0, 0.0, 0.0], "valid_s": 2.0}
        for side, first in ((pair.pi, {}), (pair, {"take_over": True})):
            await side.done("control.setpoint", **level, **first)
            await asyncio.sleep(0.3)
            refused = await pair.outcome("vehicles.goto", enu_m=[3.0, 0.0, 10.0])
            assert not refused["ok"] and "it is flown in raw" in refused["message"], refused
            await side.done("control.setpoint", **level)


async def test_a_setpoint_that_the_ground_refuses_does_not_make_the_next_one_insist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with companion_pair(tmp_path, px4=1, engaged="velocity") as pair:
        still = {"vel_enu_mps": [0.0, 0.0, 0.0], "valid_s": 2.0}
        await pair.pi.done("control.setpoint", **still)
        with monkeypatch.context() as near:
            near.setattr(pair.ground.fleet.monitor, "setpoint_refusal", lambda *_: "too close")
            assert "too close" in (await pair.outcome("control.setpoint", take_over=True, **still))["message"]
        await pair.outcome("control.setpoint", **still)
        await asyncio.sleep(0.5)
        assert pair.pi.control()["stream"]["client"] == "client 0"


async def test_a_goto_is_not_undone_by_a_setpoint_that_was_given_before_it(tmp_path: Path) -> None:
    """It waited for a place on the way, and left after the goto."""
    async with companion_pair(tmp_path, px4=1, delay_s=0.7, engaged="position") as pair:
        for _ in range(30):
            await pair.done("control.setpoint", pos_enu_m=[0.0, 0.0, 10.0], valid_s=2.0)
            await asyncio.sleep(0.02)
        await pair.done("vehicles.goto", enu_m=[8.0, 0.0, 10.0])
        await asyncio.sleep(15)
        assert pair.pi.place()[0] == pytest.approx(8.0, abs=0.5)


async def on_a_circle(pair: Pair, *, loss: float = 0.1) -> float:
    """Stream 30 s of a circle of 5 m at 2 m/s to the ground, and the root mean square of the vehicle's distance to it
    after the first 12 s."""
    luck, began = random.Random(7), pair.now
    while pair.now < began + 30.0:
        (x, y), (vx, vy), (ax, ay) = circle(pair.now - began)
        if luck.random() >= loss:
            given = {"pos_enu_m": [x, y, 10.0], "vel_enu_mps": [vx, vy, 0.0], "acc_enu_mps2": [ax, ay, 0.0]}
            await pair.outcome("control.setpoint", **given, valid_s=2.0)
        await asyncio.sleep(0.1)
    looks = [look for look in pair.pi.truth[1] if look.at >= began + 12.0]
    return math.sqrt(sum(math.dist(k.pos_m[:2], circle(k.at - began)[0]) ** 2 for k in looks) / len(looks))


async def test_a_raw_setpoint_is_as_old_as_its_way_to_the_companion(tmp_path: Path) -> None:
    async with companion_pair(tmp_path, px4=1, delay_s=0.4, engaged="raw") as pair:
        level = {"roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 90.0, "thrust": 0.5}
        given = pair.now
        await pair.done("control.setpoint", **level, valid_s=0.7)
        await asyncio.sleep(0.5)
        assert pair.pi.control()["raw"] == "attitude"
        await pair.until(lambda: pair.pi.control()["raw"] is None, 2.0)
        assert pair.now - given == pytest.approx(0.7, abs=0.1)
        began = pair.now
        await pair.done("control.setpoint", **level, valid_s=0.45)
        await asyncio.sleep(1.0)
        refused = await pair.outcome("control.setpoint", **level, valid_s=0.45)
        assert "0.40 s old and valid for 0.45 s" in refused["message"], refused
        assert "SET_ATTITUDE_TARGET" not in {s.name for s in pair.pi.setpoints(began + 0.1)}


@pytest.mark.parametrize("newer", ["trajectory.resume", "control.set"])
async def test_an_order_to_the_clock_that_was_lost_comes_with_the_next_or_after_it(tmp_path: Path, newer: str) -> None:
    """The companion refused the pause, as a newer order came before its repeat, and was ahead for good."""
    async with companion_pair(tmp_path, delay_s=0.4, engaged="position") as pair:
        began = await start_circle(pair)
        await asyncio.sleep(began + 8.0 - pair.now)
        lost: list[int] = []

        def lose(method: str, given: dict[str, Any]) -> bool:
            if given.get("order") != "clock" or lost:
                return False
            lost.append(given["number"])
            return True

        pair.calls.lose = lose
        await pair.done("trajectory.pause")
        await asyncio.sleep(0.9)
        await pair.done(newer, **({"mode": "velocity"} if newer == "control.set" else {}))
        await asyncio.sleep(6)
        flights = [actor.offboard.controller.flight for actor in (pair.ground.fleet.find("v1"), pair.pi.actor())]
        here, there = (flight.clock.at(pair.now) for flight in flights if flight is not None)
        assert lost and here.state is there.state
        assert there.trajectory_s == pytest.approx(here.trajectory_s, abs=0.02)
        assert not [t.text for t in pair.told if "ordered to" in t.text]


async def test_a_start_gives_way_to_an_order_that_came_while_it_was_prepared(tmp_path: Path) -> None:
    """It began, and the vehicle flew the trajectory in place of the newer goto."""
    async with companion_pair(tmp_path, delay_s=0.4, engaged="position") as pair:
        await pair.done("vehicles.goto", enu_m=[5.0, 0.0, 10.0])
        await asyncio.sleep(12)
        outcomes = []
        for delay_s in (0.05, 0.4):  # the goto has arrived when the start would begin, or is on its way
            pair.calls.delay_s = 0.4
            await pair("trajectory.load", target="v1", pieces=circle_pieces(20), name="circle")
            starting = asyncio.create_task(pair.outcome("trajectory.start"))
            await asyncio.sleep(0.1)
            pair.calls.delay_s = delay_s
            await pair.done("vehicles.goto", enu_m=[5.0, 0.5, 10.0])
            outcomes.append((await starting)["message"])
        assert "newer order" in outcomes[0] and "a goto is on its way" in outcomes[1], outcomes
        assert pair.pi.actor().offboard.controller.flight is None


async def test_a_pause_that_comes_before_the_start_stops_it_there(tmp_path: Path) -> None:
    """The companion refused the start, as the pause was newer, and the ground took its vehicle for one that left."""
    async with companion_pair(tmp_path, delay_s=0.1, engaged="position") as pair:
        lost: list[str] = []

        def lose(method: str, given: dict[str, Any]) -> bool:
            if given.get("order") == "start":
                lost.append(given["order"])
            return len(lost) == 1 and given.get("order") == "start"

        pair.calls.lose = lose
        await start_circle(pair)
        await pair.done("trajectory.pause")
        await asyncio.sleep(5)
        actors = (pair.ground.fleet.find("v1"), pair.pi.actor())
        flights = [actor.offboard.controller.flight for actor in actors]
        assert len(lost) > 1 and all(flights), pair.texts("trajectory", "control")
        assert [f.clock.at(pair.now)[:2] for f in flights if f is not None] == [(0.0, 0.0)] * 2
        await pair.done("trajectory.resume")
        await asyncio.sleep(5)
        here, there = (f.clock.at(pair.now).trajectory_s for f in flights if f is not None)
        assert there == pytest.approx(here, abs=0.02) and here > 2.0


async def test_no_pause_stands_without_the_resume_that_followed_it(tmp_path: Path) -> None:
    """Nothing reaches the companion for longer than the resume alone is repeated."""
    async with companion_pair(tmp_path, delay_s=0.05, engaged="position") as pair:
        began = await start_circle(pair)
        await asyncio.sleep(began + 8.0 - pair.now)
        until = pair.now + 8.0
        pair.calls.lose = lambda method, given: pair.now < until and method == "companion.order"
        await pair.done("trajectory.pause")
        await asyncio.sleep(0.5)
        await pair.done("trajectory.resume")
        await asyncio.sleep(12)
        flights = [a.offboard.controller.flight for a in (pair.ground.fleet.find("v1"), pair.pi.actor())]
        here, there = (f.clock.at(pair.now) for f in flights if f is not None)
        assert here.state is there.state is ClockState.RUNNING
        assert there.trajectory_s == pytest.approx(here.trajectory_s, abs=0.6)


async def test_a_pause_has_room_beside_any_number_of_orders_to_the_clock(tmp_path: Path) -> None:
    async with companion_pair(tmp_path, delay_s=0.8, engaged="position") as pair:
        began = await start_circle(pair)
        await asyncio.sleep(began + 8.0 - pair.now)
        given = [await pair.outcome("trajectory.speed", speed=0.5 + 0.01 * (k % 20)) for k in range(40)]
        assert [outcome["ok"] for outcome in given] == [True] * MAX_NOTED + [False] * (40 - MAX_NOTED)
        await pair.done("trajectory.pause")
        await asyncio.sleep(8)
        for actor in (pair.ground.fleet.find("v1"), pair.pi.actor()):
            flight = actor.offboard.controller.flight
            assert flight is not None and flight.clock.at(pair.now).state is ClockState.PAUSED


@pytest.mark.deep
async def test_a_streamed_circle_is_flown_as_well_at_a_delay_of_0_8_s_as_at_0_02_s(tmp_path: Path) -> None:
    """By attitude, with 10 % of all messages lost each way."""
    found = {}
    for delay_s in (0.02, 0.8):
        folder = tmp_path / str(delay_s)
        folder.mkdir()
        async with companion_pair(folder, delay_s=delay_s, loss=0.1, engaged="attitude") as pair:
            await pair.done("vehicles.goto", enu_m=[5.0, 0.0, 10.0])
            await asyncio.sleep(12)
            found[delay_s] = await on_a_circle(pair)
            assert pair.control()["control_mode"] == "attitude"
    assert found[0.8] < found[0.02] + 0.1 and found[0.8] < 0.3, found


@pytest.mark.deep
async def test_a_trajectory_is_flown_as_well_at_a_delay_of_0_8_s_as_at_0_02_s(tmp_path: Path) -> None:
    found, kind = {}, {"px4": 0, "ardupilot": 1}
    for delay_s in (0.02, 0.8):
        folder = tmp_path / str(delay_s)
        folder.mkdir()
        async with companion_pair(folder, delay_s=delay_s, loss=0.1, engaged="attitude", **kind) as pair:
            began = await start_circle(pair)
            await asyncio.sleep(began + 24.0 - pair.now)
            looks = [look for look in pair.pi.truth[1] if look.at >= began + 6.0]
            off = [math.dist(k.pos_m[:2], circle(k.at - began)[0]) for k in looks]
            found[delay_s] = math.sqrt(sum(d * d for d in off) / len(off))
    assert found[0.8] == pytest.approx(found[0.02], abs=0.05) and found[0.8] < 0.3, found


@KINDS
async def test_no_control_waits_at_a_companion_for_the_end_of_an_order(tmp_path: Path, kind: dict[str, Any]) -> None:
    """It was begun over a landing that was ordered meanwhile, of which the companion had not heard."""
    async with companion_pair(tmp_path, engaged="velocity", **kind) as pair:
        pair.pi.loses = frozenset({"COMMAND_LONG", "COMMAND_INT", "SET_MODE"})
        holding = asyncio.create_task(pair.outcome("vehicles.hold"))
        await asyncio.sleep(0.5)
        refused = await pair.outcome("control.set", mode="velocity")
        assert "another order takes over: hold was ordered" in refused["message"]
        pair.calls.lose = lambda method, given: given.get("order") == "taken_over"
        landing = asyncio.create_task(pair.outcome("vehicles.land"))
        await asyncio.sleep(0.5)
        pair.pi.loses = frozenset()
        assert (await landing)["ok"] and not (await holding)["ok"]
        pair.calls.lose = lambda method, given: False
        await asyncio.sleep(8.0)
        assert pair.pi.actor().vehicle.mode in ("AUTO.LAND", "LAND")
