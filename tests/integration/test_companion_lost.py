"""Control at the companion when the ground or the companion is lost, and when messages between them are."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.errors import RpcError
from skygcs.ext.companions.mirrored_control import REPORTS_SILENT_S
from skygcs.rpc.error_codes import INVALID_PARAMS
from skygcs.sim.conditions import conditions_of
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.companion_pair import Pair, companion_pair, start_circle
from support.daemons import memory_link
from support.flown import KINDS, SETPOINTS
from support.pymav import PymavPeer

RETURNING = frozenset({Px4Mode.RTL, CopterMode.RTL})
LANDING = frozenset({Px4Mode.LAND, CopterMode.LAND})
LOST_S = 5.0
CONTACT_S = 0.55
"""Between two signs of life of the ground, and their way."""


def mode(pair: Pair) -> int:
    return int(pair.pi.sim().mode)


def lost_texts(pair: Pair) -> list[str]:
    return [t.text for t in pair.pi.told if t.kind == "ground_lost"]


@pytest.mark.parametrize("action", ["return", "hold", "land"])
async def test_without_the_ground_it_ends_as_configured(tmp_path: Path, action: str) -> None:
    """In the middle of a trajectory; the ground is killed."""
    async with companion_pair(tmp_path, companion={"ground_lost": action}, engaged="position") as pair:
        await start_circle(pair)
        await asyncio.sleep(10)
        began = pair.now
        await pair.lose_ground()
        acted = await pair.until(lambda: lost_texts(pair), 15.0)
        assert LOST_S - CONTACT_S <= acted - began < LOST_S + 1.5, "from its last sign of life on"
        assert math.hypot(*pair.pi.place()[:2]) == pytest.approx(5.0, abs=0.7), "until then it flew on"
        modes = {"return": RETURNING, "land": LANDING, "hold": {Px4Mode.LOITER}}[action]
        await pair.until(lambda: mode(pair) in modes, 5.0)
        quiet = pair.now
        await asyncio.sleep(20)
        assert not pair.pi.setpoints(quiet + 1.2), "until a heartbeat shows the order's mode it is held"
        assert len(lost_texts(pair)) == 1, lost_texts(pair)
        assert pair.pi.is_safe()


async def test_a_companion_that_refuses_the_grounds_contact_is_named_with_its_reason(tmp_path: Path) -> None:
    async with companion_pair(tmp_path) as pair:
        call = pair.calls.call

        async def older(method: str, params: dict[str, Any] | None = None, timeout_s: float = 5.0) -> Any:
            if method == "companion.contact":
                raise RpcError(INVALID_PARAMS, "invalid params: compid: unknown")
            return await call(method, params, timeout_s)

        pair.calls.call = older  # type: ignore[method-assign]
        await asyncio.sleep(REPORTS_SILENT_S + 1.0)
        refused = await pair("control.set", targets="v1", mode="position")
        message = refused["outcomes"]["v1"]["message"]
        assert "has not answered for" in message and "invalid params: compid: unknown; is its skygcs another" in message


async def test_finish_does_not_wait_for_the_end_of_a_paused_trajectory(tmp_path: Path) -> None:
    """Nobody is left to resume it: it stayed there until its battery was empty."""
    async with companion_pair(tmp_path, companion={"ground_lost": "finish"}, engaged="position") as pair:
        await start_circle(pair)
        await asyncio.sleep(5)
        await pair.done("trajectory.pause")
        await asyncio.sleep(3)
        await pair.lose_ground()
        await pair.until(lambda: mode(pair) in RETURNING, LOST_S + 2.0)
        (text,) = lost_texts(pair)
        assert text.endswith("it is ordered to return")


@pytest.mark.deep  # a minute of two daemons
async def test_a_ground_that_is_only_slow_is_not_lost(tmp_path: Path) -> None:
    async with companion_pair(tmp_path, delay_s=0.8, loss=0.1, engaged="position") as pair:
        await asyncio.sleep(60)
        assert not lost_texts(pair) and pair.control()["state"] == "flying"


@KINDS
async def test_heartbeats_of_the_ground_count_while_its_calls_do_not_come(tmp_path: Path, kind: dict[str, Any]) -> None:
    async with companion_pair(tmp_path, engaged="position", **kind) as pair:
        pair.calls.up = False
        await asyncio.sleep(15)
        assert not lost_texts(pair)
        shown = pair.control()
        assert not shown["companion"]["up"] and shown["companion"]["age_s"] > 10.0
        assert shown["state"] == "flying", "the autopilot follows setpoints, so its companion flies it"
        refused = await pair.outcome("control.set", mode="velocity")
        assert "not connected" in refused["message"]
        # the ground ends it by MAVLink alone
        here = pair.pi.place()
        await pair.done("vehicles.hold")
        assert mode(pair) in (Px4Mode.LOITER, CopterMode.BRAKE)
        await asyncio.sleep(1)
        quiet = pair.now
        await asyncio.sleep(10)
        assert not pair.pi.setpoints(quiet) and pair.pi.is_safe()
        assert math.dist(here, pair.pi.place()) < 1.0, "no late setpoint moves it"
        assert pair.control()["state"] == "off"


@pytest.mark.deep
async def test_another_station_with_the_ids_of_the_ground_is_not_the_ground(tmp_path: Path) -> None:
    """Every station is 255/25 by default; one that came to the companion over a radio kept it flying for ever."""
    async with companion_pair(tmp_path, engaged="position") as pair:
        others = memory_link(pair.pi.daemon, "others")
        station = PymavPeer(*pair.ground.fleet._services.own)
        await pair.lose_ground()
        lost = pair.now
        while not lost_texts(pair) and pair.now < lost + 15.0:
            others.peer.send(station.pack(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
            await asyncio.sleep(0.5)
        assert pair.now - lost < LOST_S + 1.5
        await pair.until(lambda: mode(pair) in RETURNING, 5.0)


@pytest.mark.deep
@KINDS
async def test_without_the_companion_the_ground_holds_it(tmp_path: Path, kind: dict[str, Any]) -> None:
    """The ground still hears the vehicle, over a radio: left to the wind it was 324 m away after 60 s."""
    params = {"GUID_TIMEOUT": 1.0, "COM_OF_LOSS_T": 1.0}
    windy = conditions_of(wind_mps=6.0)
    async with companion_pair(
        tmp_path, engaged="attitude", params=params, radio=True, conditions=windy, in_air=True, **kind
    ) as pair:
        await start_circle(pair)
        await asyncio.sleep(5)
        await pair.lose_companion()
        began = pair.now
        await asyncio.sleep(25)
        assert not [name for at, name in pair.to_vehicle if at >= began and name in SETPOINTS]
        assert not pair.pi.setpoints(began)
        assert pair.pi.is_safe() and pair.pi.truth[1][-1].pos_m[2] == pytest.approx(10.0, abs=1.0)
        # a PX4 leaves OFFBOARD by itself
        if kind.get("ardupilot"):
            held = [t for t in pair.told if t.kind == "unattended"]
            assert "nobody flies it in GUIDED (its companion pi did)" in held[0].text
            assert held[0].at - began < REPORTS_SILENT_S + 1.0
            assert pair.pi.farthest_m(held[0].at + 3.0) < 1.0
        shown = pair.control()
        assert not shown["companion"]["up"] and shown["state"] == "off"
        refused = await pair.outcome("control.set", mode="position")
        assert refused["result"] == "refused" and "not connected" in refused["message"]
        assert pair.ground.fleet.find("v1").offboard.controller.flight is None, "the others of its group stop"
        await pair.done("vehicles.land")
        await pair.until(lambda: mode(pair) in LANDING, 10.0)


@pytest.mark.deep
@pytest.mark.parametrize("which", ["companion", "ground", "both"])
async def test_after_a_restart_somebody_flies_it_or_it_holds(tmp_path: Path, which: str) -> None:
    """Flown by attitude in wind; killed for 2 s are the companion, the ground, or both at once."""
    windy = conditions_of(wind_mps=6.0)
    async with companion_pair(tmp_path, engaged="attitude", radio=True, conditions=windy, px4=0, ardupilot=1) as pair:
        await asyncio.sleep(3)
        if which != "ground":
            pair.calls.up = False
            await pair.pi.die()
        if which != "companion":
            await pair.lose_ground()
        await asyncio.sleep(2)
        if which != "ground":
            await pair.companion_begins_again()
        if which != "companion":
            await pair.ground_begins_again()
        pair.calls.up = True
        begun = pair.now
        await asyncio.sleep(12)
        assert pair.pi.is_safe() or which == "ground"
        held = [t for t in [*pair.told, *pair.pi.told] if t.kind == "unattended" and "ordered to hold" in t.text]
        if which == "ground":
            assert not held, "its companion flies it, and is waited for"
            assert pair.pi.setpoints(pair.now - 0.5)
        else:
            assert min(t.at for t in held) - begun < 2.0, "a heartbeat, and no more than a second"
            assert pair.pi.farthest_m(begun + 2.0) < 8.0


@pytest.mark.deep
@KINDS
async def test_the_pilot_takes_it_and_nobody_takes_it_back(tmp_path: Path, kind: dict[str, Any]) -> None:
    async with companion_pair(tmp_path, engaged="position", **kind) as pair:
        if kind.get("ardupilot"):
            pair.pi.other_sets_mode(int(CopterMode.LOITER))
        else:
            pair.pi.other_sets_mode(4, 3)  # AUTO.LOITER
        await pair.until(lambda: pair.control()["state"] == "off", 5.0)
        taken = pair.now
        await pair.lose_ground()
        await asyncio.sleep(20)
        assert not pair.pi.setpoints(taken) and not pair.pi.commands(taken) and not lost_texts(pair)


async def test_a_lost_answer_is_asked_for_again_and_the_order_carried_out_once(tmp_path: Path) -> None:
    async with companion_pair(tmp_path) as pair:
        lost: list[int] = []

        def lose(method: str, given: dict[str, Any]) -> bool:
            if method != "companion.order" or given["order"] != "engage" or len(lost) >= 2:
                return False
            lost.append(given["number"])
            return True

        pair.calls.lose_answer = lose
        outcome = await pair.outcome("control.set", mode="position")
        assert outcome["ok"], outcome
        asked = [given for method, given in pair.calls.calls if method == "companion.order"]
        assert len(asked) >= 3 and len({given["number"] for given in asked}) == 1
        engaged = [t for t in pair.pi.told if t.kind == "command" and t.text.startswith("control:")]
        assert len(engaged) == 1


@pytest.mark.deep  # two daemons for the sake of one order of calls
async def test_a_release_ends_an_engagement_that_comes_after_it(tmp_path: Path) -> None:
    """The engagement is late on its way, the release is not."""
    async with companion_pair(tmp_path) as pair:
        pair.calls.lose = lambda method, given: given.get("order") == "engage" and pair.now < began + 2.0
        began = pair.now
        engaging = asyncio.create_task(pair.outcome("control.set", mode="position"))
        await asyncio.sleep(0.5)
        await pair.done("vehicles.hold")
        outcome = await engaging
        assert not outcome["ok"] and "newer order" in outcome["message"], outcome
        await asyncio.sleep(5)
        assert not pair.pi.setpoints(began)


async def test_an_engagement_that_was_lost_on_its_way_is_not_repeated_to_a_pilot(tmp_path: Path) -> None:
    async with companion_pair(tmp_path, px4=0, ardupilot=1) as pair:
        began = pair.now
        pair.calls.lose = lambda method, given: given.get("order") == "engage" and pair.now < began + 2.0
        engaging = asyncio.create_task(pair.outcome("control.set", mode="position"))
        await asyncio.sleep(0.1)
        pair.pi.other_sets_mode(int(CopterMode.LOITER))
        outcome = await engaging
        assert not outcome["ok"] and "switched to LOITER since, which its pilot flies" in outcome["message"], outcome
        assert not pair.pi.setpoints(began) and mode(pair) == CopterMode.LOITER
