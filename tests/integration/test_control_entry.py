"""Taking a vehicle over fails, is cancelled, or something newer is ordered meanwhile: everything is undone."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.radio_link.transmit_queue import TxQueue
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.flown import HOLDING, KINDS, Flown, aloft

ORDERS: dict[str, tuple[str, dict[str, Any], tuple[int, ...]]] = {
    "land": ("vehicles.land", {}, (Px4Mode.LAND, CopterMode.LAND)),
    "rtl": ("vehicles.rtl", {}, (Px4Mode.RTL, CopterMode.RTL)),
    "hold": ("vehicles.hold", {}, (Px4Mode.LOITER, CopterMode.GUIDED)),
    "mode": ("vehicles.mode", {"mode": "{holding}"}, (Px4Mode.LOITER, CopterMode.BRAKE)),
    "stop": ("vehicles.stop", {"action": "land"}, (Px4Mode.LAND, CopterMode.LAND)),
    "off": ("control.set", {"mode": "off"}, (Px4Mode.LOITER, CopterMode.GUIDED)),
}
ALL_ORDERS = pytest.mark.parametrize("order", ORDERS)

STAGES = pytest.mark.parametrize("after_s", [0.05, 0.5, 1.5, 1.9, 2.6])
"""While parameters are read, while it streams, about the switch of modes, and after it."""


async def carried_out(gcs: Flown, order: str) -> None:
    """The order's outcome is good, its mode is flown, and nothing of control is left."""
    method, params, modes = ORDERS[order]
    if order == "mode":
        params = {"mode": "AUTO.LOITER" if gcs.actor().vehicle.family == "px4" else "BRAKE"}
    if order == "off" and not gcs.setpoints(0.0):
        modes += (gcs.sim().mode,)  # there is nothing to switch off yet
    await gcs.done(method, **params)
    quiet = gcs.now
    assert gcs.sim().mode in modes
    await asyncio.sleep(8)
    assert gcs.sim().mode in modes, "something newer came from somewhere"
    assert not gcs.setpoints(quiet), "until the order's mode is seen it is held, and not longer"
    assert gcs.control()["state"] == "off"
    moved = {int(c.values["command"]) for c in gcs.commands(quiet)}
    assert not moved, f"commands {moved} after the order's outcome"


@KINDS
@ALL_ORDERS
async def test_an_order_while_it_flies_ends_control_at_once(tmp_path: Path, kind: dict[str, int], order: str) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.in_mid_step("attitude")
        since = gcs.now
        await carried_out(gcs, order)
        assert len(gcs.texts(since)) == 1, gcs.texts(since)


@KINDS
@pytest.mark.parametrize("order", ["land", "off"])
@STAGES
async def test_an_order_while_it_is_being_taken_over_wins(
    tmp_path: Path, kind: dict[str, int], order: str, after_s: float
) -> None:
    async with aloft(tmp_path, height_m=5.0, **kind) as gcs:
        taking = asyncio.create_task(gcs.outcome("control.set", mode="attitude"))
        await asyncio.sleep(after_s)
        taken_already = taking.done()
        await carried_out(gcs, order)
        outcome = await taking
        assert taken_already or not outcome["ok"], outcome


@KINDS
@STAGES
async def test_a_client_that_goes_away_leaves_it_as_it_was(
    tmp_path: Path, kind: dict[str, int], after_s: float
) -> None:
    async with aloft(tmp_path, height_m=5.0, **kind) as gcs:
        former, began = gcs.sim().mode, gcs.now
        taking = asyncio.create_task(gcs.outcome("control.set", mode="attitude"))
        await asyncio.sleep(after_s)
        if taking.done():
            return
        taking.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await taking
        gone = gcs.now
        await gcs.ends_safe(within_m=2.0, since=began)
        assert not gcs.setpoints(gone)
        assert gcs.control()["state"] == "off"
        assert gcs.sim().mode == former or gcs.sim().mode in HOLDING
        if gcs.setpoints(0.0):
            held = [c.values["param2"] for c in gcs.commands(began) if c.values["command"] == 176]
            if "ardupilot" in kind:
                assert held[-2:] == [CopterMode.BRAKE, CopterMode.GUIDED], "it holds, and does not wait for more"
            assert gcs.texts(began) == ["control ended: it could not be begun"]


@KINDS
async def test_the_mode_is_refused(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        if "ardupilot" in kind:
            await gcs.done("vehicles.mode", mode="LOITER", force=True)
        former, began = gcs.sim().mode, gcs.now
        gcs.sim().faults.refuse_mode = "not today"
        outcome = await gcs.outcome("control.set", mode="velocity")
        assert not outcome["ok"] and "not today" in outcome["message"], outcome
        ended = gcs.now
        gcs.sim().faults.refuse_mode = ""
        await gcs.ends_safe(within_m=1.0, since=began)
        assert not gcs.setpoints(ended)
        assert gcs.sim().mode == former
        assert len(gcs.texts(began)) == 1
        await gcs.fly("velocity")


async def test_the_stream_does_not_get_through(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """PX4 enters OFFBOARD only while setpoints come."""
    async with aloft(tmp_path) as gcs:
        sim, began = gcs.sim(), gcs.now
        monkeypatch.setattr(sim, "on_setpoint", lambda name, fields, now: None)
        outcome = await gcs.outcome("control.set", mode="velocity")
        assert not outcome["ok"] and "OFFBOARD" in outcome["message"], outcome
        await gcs.ends_safe(within_m=1.0, since=began)
        assert sim.mode == Px4Mode.LOITER


@pytest.mark.deep
async def test_a_landing_of_all_by_broadcast_ends_control_of_all(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=1, ardupilot=2) as gcs:
        await gcs.fly("attitude", targets="all")
        engaging = asyncio.create_task(gcs("control.set", targets="v2", mode="velocity"))
        await asyncio.sleep(0.2)
        ordered = gcs.now
        await gcs.done("vehicles.land", targets="all")
        await engaging
        assert any(s.name == "COMMAND_LONG" and s.sysid == 0 and s.at >= ordered for s in gcs.sent), "no broadcast"
        await asyncio.sleep(40)
        for name in ("v1", "v2", "v3"):
            assert not gcs.setpoints(ordered + 1.2, name), "longer than until a heartbeat shows the landing"
            assert gcs.sim(name).motion.on_ground
            assert gcs.texts(ordered, name=name) == ["control ended: land was ordered"]


async def test_what_the_guard_refuses_while_it_streams_ends_in_a_hold(tmp_path: Path) -> None:
    """An ArduCopter in GUIDED obeys the very first setpoint, long before its taking over is complete."""
    async with aloft(tmp_path, px4=0, ardupilot=1) as gcs:
        taking = asyncio.create_task(gcs.outcome("control.set", mode="attitude"))
        await gcs.until(lambda: gcs.control()["state"] == "engaging")
        await asyncio.sleep(0.6)
        broken = gcs.now
        gcs.sim().faults.nan_attitude = True
        outcome = await taking
        assert not outcome["ok"] and "NaN" in outcome["message"], outcome
        assert gcs.setpoints(0.0)
        await gcs.ends_safe(within_m=0.6, since=broken)
        assert gcs.sim().mode == CopterMode.GUIDED


@KINDS
async def test_a_fault_of_ours_ends_control_in_a_hold(
    tmp_path: Path, kind: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.in_mid_step("attitude")
        broken = gcs.now

        def attitude_target(*args: Any, **more: Any) -> None:
            raise ZeroDivisionError("a mistake")

        monkeypatch.setattr("skygcs.core.vehicle.setpoint.attitude_target", attitude_target)
        await asyncio.sleep(0.1)
        assert gcs.control()["state"] == "off"
        await gcs.ends_safe(within_m=4.0, since=broken)
        assert gcs.sim().mode in (Px4Mode.LOITER, CopterMode.GUIDED)
        (reported,) = gcs.texts(broken, "fault")
        assert "flight control failed inside skygcs and ends" in reported
        gcs.told.clear()


@KINDS
@pytest.mark.parametrize("after_s", [0.05, 0.5, 1.5, 2.0])
async def test_a_second_order_of_control_takes_the_place_of_the_first(
    tmp_path: Path, kind: dict[str, int], after_s: float
) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        began = gcs.now
        first = asyncio.create_task(gcs.outcome("control.set", mode="velocity"))
        await asyncio.sleep(after_s)
        if "mode" in gcs.texts(began, kind="mode") or first.done():
            return
        second = await gcs.outcome("control.set", mode="position")
        assert second["message"] == "flown by position setpoints", second
        superseded = await first
        assert superseded["ok"] or "newer" in superseded["message"], superseded
        start = gcs.place()
        await gcs.step(3.0, 0.0, 0.0)
        await asyncio.sleep(12)
        assert gcs.control()["state"] == "flying"
        assert gcs.place() == pytest.approx((start[0] + 3.0, start[1], start[2]), abs=0.3)
        assert {s.name for s in gcs.setpoints(gcs.now - 3.0)} == {"SET_POSITION_TARGET_GLOBAL_INT"}


async def test_thrust_that_would_mean_climb_rate_is_refused_before_anything_is_sent(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=1, params={"GUID_OPTIONS": 0}) as gcs:
        began = gcs.now
        outcome = await gcs.outcome("control.set", mode="attitude")
        assert outcome["result"] == "refused" and "GUID_OPTIONS to 8" in outcome["message"]
        assert not gcs.setpoints(0.0)
        await gcs.ends_safe(within_m=0.5, since=began)


async def test_a_vehicle_that_another_program_flies_is_not_taken_over(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        stream = mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0b110111000111, *(0.0,) * 11)

        async def fly_it() -> None:
            while True:
                gcs.by_other_station(stream)
                await asyncio.sleep(0.1)

        other = asyncio.create_task(fly_it())
        await asyncio.sleep(2)
        gcs.other_sets_mode(6)
        await asyncio.sleep(2)
        since = gcs.now
        outcome = await gcs.outcome("control.set", mode="velocity")
        assert outcome["result"] == "refused" and "OFFBOARD already" in outcome["message"], outcome
        assert not gcs.setpoints(since) and not gcs.commands(since)
        other.cancel()


@pytest.mark.deep  # as the first beginning
@KINDS
@pytest.mark.parametrize("order", ["off", "hold"])
async def test_control_begins_again_at_once_after_it_ended(tmp_path: Path, kind: dict[str, int], order: str) -> None:
    """A PX4 shows OFFBOARD until its next heartbeat: that was by our own setpoints."""
    async with aloft(tmp_path, **kind) as gcs:
        for _ in range(4):  # at four phases of the heartbeats
            await gcs.fly("position")
            method, params, _ = ORDERS[order]
            ending = asyncio.create_task(gcs.outcome(method, **params))
            await gcs.until(lambda: gcs.control()["state"] == "off", timeout_s=1.0)
            await asyncio.sleep(0.05)
            outcome = await gcs.outcome("control.set", mode="position")
            assert outcome["ok"], outcome
            await ending
            await gcs.done("control.set", mode="off")
            await asyncio.sleep(6.3)


@pytest.mark.deep  # the guard's table is held in unit/core/control
async def test_thrust_that_becomes_climb_rate_in_flight_ends_attitude(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=1) as gcs:
        await gcs.fly("attitude")
        changed = gcs.now
        gcs.by_other_station(mav.MAVLink_param_set_message(1, 1, b"GUID_OPTIONS", 0.0, 6))
        await asyncio.sleep(8)
        assert "SET_ATTITUDE_TARGET" not in {s.name for s in gcs.setpoints(changed + 0.2)}
        (reported,) = gcs.texts(changed)
        assert reported.startswith("flown by velocity setpoints: its GUID_OPTIONS is 0")
        assert gcs.farthest_m(changed) < 0.5


async def test_a_setpoint_that_waits_for_a_busy_link_does_not_leave_after_the_end(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.fly("attitude")
        queue: TxQueue[str] = TxQueue()
        commands = gcs.actor().commands
        before = commands._send

        def send(info: Any, values: Any, sysid: int, compid: int, priority: Any, **more: Any) -> bool:
            queue.offer(info.name, priority, gcs.now, more.get("key"))
            return before(info, values, sysid, compid, priority, **more)

        commands._send = send
        await asyncio.sleep(0.2)
        await gcs.done("vehicles.land")
        left = []
        while (entry := queue.pop(gcs.now)) is not None:
            left.append(entry[0])
        assert "SET_ATTITUDE_TARGET" not in left and "COMMAND_LONG" in left, left


async def test_on_the_ground_nothing_is_taken_over(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.lands()
        since = gcs.now
        outcome = await gcs.outcome("control.set", mode="position")
        assert outcome["result"] == "refused", outcome
        assert not gcs.setpoints(since) and not gcs.commands(since)


@pytest.mark.deep  # half a minute for each of two rates
@pytest.mark.parametrize("own_hz", [5.0, 2.0])
async def test_the_position_comes_as_before_when_control_ends(tmp_path: Path, own_hz: float) -> None:
    """It was asked down to 2 Hz of a PX4's own 5, for every program on that link."""
    async with aloft(tmp_path, px4=1) as gcs:
        sim = gcs.sim()
        sim.streams.set_default("GLOBAL_POSITION_INT", own_hz, gcs.now)
        await asyncio.sleep(20)
        for _ in range(2):
            await gcs.fly("attitude")
            assert sim.streams.interval("GLOBAL_POSITION_INT") == pytest.approx(1 / 50)
            await gcs.done("vehicles.hold")
            await asyncio.sleep(3)
            assert sim.streams.interval("GLOBAL_POSITION_INT") == pytest.approx(1 / own_hz)
