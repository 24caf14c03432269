"""Control by setpoints and an order that takes over: the stream holds the vehicle until the order has taken effect."""

from __future__ import annotations

import asyncio
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pytest

from skygcs.ext.joystick.commands import JoystickFlight
from skygcs.ext.joystick.stick_mapping import AxisChoice, StickAxes, StickLimits
from skygcs.ext.joystick.stick_session import StickSession
from skygcs.sim.conditions import conditions_of
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.flown import KINDS, Flown, aloft

WINDY = conditions_of(wind_mps=6.0)

DENIED: dict[str, tuple[str, dict[str, Any]]] = {
    "mode": ("vehicles.mode", {"mode": "{mission}"}),
    "mission": ("missions.start", {}),
}


@dataclass
class StationInTheLoop:
    """The methods that a joystick calls, without a socket."""

    gcs: Flown

    async def call(self, method: str, **params: Any) -> Any:
        return await self.gcs(method, **params)

    async def setpoint(self, targets: str, **setpoint: Any) -> Any:
        return (await self.gcs("control.setpoint", targets=targets, **setpoint))["outcomes"]

    async def hold(self, targets: str) -> Any:
        return (await self.gcs("vehicles.hold", targets=targets))["outcomes"]


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("order", DENIED)
async def test_an_order_that_is_denied_leaves_it_held(tmp_path: Path, kind: dict[str, int], order: str) -> None:
    """There is no mission. Ended at the order, control left it to the wind: 32.6 m in 10 s."""
    async with aloft(tmp_path, conditions=WINDY, **kind) as gcs:
        await gcs.fly("attitude")
        await asyncio.sleep(5)
        method, given = DENIED[order]
        mission = "AUTO.MISSION" if gcs.actor().vehicle.family == "px4" else "AUTO"
        since = gcs.now
        outcome = await gcs.outcome(method, **{k: v.format(mission=mission) for k, v in given.items()})
        assert not outcome["ok"], outcome
        await asyncio.sleep(10)
        assert gcs.farthest_m(since) < 1.5
        assert gcs.control()["state"] == "flying" and gcs.last_setpoint() > gcs.now - 0.3
        (text,) = gcs.texts(since)
        assert text.startswith("control goes on, it holds its position"), text
        await gcs.step(2.0, 0.0, 0.0)
        await gcs.done("vehicles.land")


@KINDS
async def test_an_order_that_is_not_heard_leaves_it_held(tmp_path: Path, kind: dict[str, int]) -> None:
    """Setpoints pass, the order does not: it is flown until its mode is seen."""
    async with aloft(tmp_path, conditions=WINDY, **kind) as gcs:
        await gcs.fly("attitude")
        await asyncio.sleep(5)
        gcs.loses = frozenset({"COMMAND_LONG", "COMMAND_INT"})
        since = gcs.now
        landing = asyncio.create_task(gcs.outcome("vehicles.land"))
        await asyncio.sleep(1.5)
        assert gcs.setpoints(gcs.now - 0.2), "it is not left to the wind"
        follow = await gcs.outcome("control.setpoint", vel_enu_mps=[1.0, 0.0, 0.0])
        assert "land was ordered" in follow["message"], "no client moves it meanwhile"
        gcs.loses = frozenset()
        outcome = await landing
        assert outcome["ok"], outcome
        assert gcs.farthest_m(since) < 1.5
        quiet = gcs.now
        await asyncio.sleep(3)
        assert not gcs.setpoints(quiet) and gcs.texts(since) == ["control ended: land was ordered"]


async def test_a_joystick_that_is_let_go_leaves_another_persons_landing_alone(tmp_path: Path) -> None:
    """Until its mode showed, the status said "flying" without a reason: hold was sent over the landing."""
    async with aloft(tmp_path, px4=1) as gcs:
        await gcs.fly("velocity")
        landing = asyncio.create_task(gcs.outcome("vehicles.land"))
        await asyncio.sleep(0.2)
        shown = (await gcs("control.status", targets="v1"))[0]
        assert shown["state"] == "flying" and shown["successor"] == "land was ordered"
        assert shown["reasons"] == ["another order takes over: land was ordered"]
        joystick = JoystickFlight(cast(Any, StationInTheLoop(gcs)), "v1", engage=False, fleet_frame=True)
        joystick._session = StickSession(StickAxes(*map(AxisChoice, range(4))), StickLimits(), 5, gcs.now)
        await joystick._stop(flying=True)
        await joystick._stop(flying=False)  # a click, as nothing is taken under control by it
        assert (await landing)["ok"]
        await asyncio.sleep(3)
        assert gcs.actor().vehicle.mode == "AUTO.LAND"


@KINDS
async def test_a_goto_while_control_is_being_engaged_is_flown(tmp_path: Path, kind: dict[str, int]) -> None:
    """An ArduCopter in GUIDED follows the setpoints of the entry: one that came after the goto took its place."""
    async with aloft(tmp_path, **kind) as gcs:
        engaging = asyncio.create_task(gcs.outcome("control.set", mode="velocity"))
        await gcs.until(lambda: gcs.setpoints(0.0))
        await gcs.step(12.0, 0.0, 0.0)
        went = gcs.now
        assert not (await engaging)["ok"]
        await asyncio.sleep(15)
        assert gcs.place()[0] == pytest.approx(12.0, abs=1.0)
        assert not gcs.setpoints(went) and not gcs.texts(0.0, "unattended")


@KINDS
async def test_an_order_that_is_denied_while_control_is_being_engaged(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, conditions=WINDY, **kind) as gcs:
        engaging = asyncio.create_task(gcs.outcome("control.set", mode="attitude"))
        await gcs.until(lambda: gcs.setpoints(0.0))
        since = gcs.now
        assert not (await gcs.outcome("missions.start"))["ok"]
        assert not (await engaging)["ok"]
        await asyncio.sleep(10)
        assert gcs.is_safe() and gcs.farthest_m(since) < 1.5


@KINDS
async def test_control_that_is_set_during_a_hand_over_follows_it(tmp_path: Path, kind: dict[str, int]) -> None:
    """Set 0.02 s after a hold, it was refused for a newer order; during a hold that was not heard, control ended."""
    async with aloft(tmp_path, conditions=WINDY, **kind) as gcs:
        await gcs.fly("velocity")
        await asyncio.sleep(3)
        holding = asyncio.create_task(gcs.outcome("vehicles.hold"))
        await asyncio.sleep(0.02)
        await gcs.fly("velocity")
        assert (await holding)["ok"]
        # one that is not heard: it is flown all the while
        gcs.loses = frozenset({"COMMAND_LONG", "COMMAND_INT", "SET_MODE"})
        since = gcs.now
        holding = asyncio.create_task(gcs.outcome("vehicles.hold"))
        await asyncio.sleep(0.5)
        setting = asyncio.create_task(gcs.outcome("control.set", mode="velocity"))
        assert not (await holding)["ok"]
        gcs.loses = frozenset()
        assert (await setting)["message"] == "flown by velocity setpoints"
        sent = [s.at for s in gcs.setpoints(since)]
        assert max(b - a for a, b in itertools.pairwise(sent)) < 0.5 and gcs.farthest_m(since) < 1.5
        # an order that came later is not overtaken
        gcs.loses = frozenset({"COMMAND_LONG", "COMMAND_INT", "SET_MODE"})
        holding = asyncio.create_task(gcs.outcome("vehicles.hold"))
        await asyncio.sleep(0.5)
        setting = asyncio.create_task(gcs.outcome("control.set", mode="velocity"))
        await asyncio.sleep(0.1)
        landing = asyncio.create_task(gcs.outcome("vehicles.land"))
        await asyncio.sleep(1.0)
        gcs.loses = frozenset()
        assert (await landing)["ok"] and not (await setting)["ok"] and not (await holding)["ok"]
        await asyncio.sleep(2.0)
        assert gcs.actor().vehicle.mode in ("AUTO.LAND", "LAND")


@KINDS
async def test_control_that_is_set_again_while_it_is_entered(tmp_path: Path, kind: dict[str, int]) -> None:
    """A PX4 that showed OFFBOARD by then was taken for one that another program flies, and left."""
    for after_s in (0.3, 1.0, 2.0):
        async with aloft(tmp_path / str(after_s), **kind) as gcs:
            first = asyncio.create_task(gcs.outcome("control.set", mode="velocity"))
            await asyncio.sleep(after_s)
            second = await gcs.outcome("control.set", mode="velocity")
            await first
            await asyncio.sleep(3.0)
            assert second["ok"] and gcs.control()["state"] == "flying", (after_s, second)


@KINDS
async def test_an_entry_that_is_overtaken_leaves_the_rates_as_they_were(tmp_path: Path, kind: dict[str, int]) -> None:
    """The position stayed at 50 Hz for good."""
    async with aloft(tmp_path, **kind) as gcs:
        await asyncio.sleep(10.0)
        slot = gcs.actor().vehicle.slot("GLOBAL_POSITION_INT")
        before_hz = slot.rate_hz
        setting = asyncio.create_task(gcs.outcome("control.set", mode="attitude"))
        await gcs.until(
            lambda: [s for s in gcs.sent if s.values.get("param1") == 33.0 and s.values.get("param2") == 20000.0]
        )
        await gcs.done("vehicles.hold")
        assert not (await setting)["ok"]
        await asyncio.sleep(30.0)
        assert slot.rate_hz == pytest.approx(before_hz, rel=0.3)


@KINDS
@pytest.mark.parametrize("then", ["off", "authority_lost"])
async def test_an_end_of_control_also_ends_the_control_that_waits(
    tmp_path: Path, kind: dict[str, int], then: str
) -> None:
    """A PX4 shows the OFFBOARD of before, or a hold is under way: it was answered "control is off", and was flown."""
    async with aloft(tmp_path, setpoints_end=False, **kind) as gcs:
        await gcs.fly("velocity")
        await asyncio.sleep(2.0)
        gcs.loses = frozenset({"COMMAND_LONG", "COMMAND_INT", "SET_MODE"})
        holding = asyncio.create_task(gcs.outcome("vehicles.hold"))
        await asyncio.sleep(0.3)
        setting = asyncio.create_task(gcs.outcome("control.set", mode="velocity"))
        await asyncio.sleep(0.1)
        if then == "off":
            gcs.loses = frozenset()
            await gcs.done("control.set", mode="off")
        else:
            gcs.actor().authority_lost("a test")
        assert not (await setting)["ok"]
        await holding
        await asyncio.sleep(5.0)
        assert gcs.control()["state"] == "off" and gcs.actor().vehicle.mode not in ("OFFBOARD",)


@KINDS
async def test_control_that_waits_is_not_begun_over_a_pilot(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        px4 = gcs.actor().vehicle.family == "px4"
        await gcs.fly("velocity")
        await asyncio.sleep(2.0)
        gcs.loses = frozenset({"COMMAND_LONG", "COMMAND_INT", "SET_MODE"})
        holding = asyncio.create_task(gcs.outcome("vehicles.mode", mode="AUTO.LOITER" if px4 else "BRAKE"))
        await asyncio.sleep(0.5)
        setting = asyncio.create_task(gcs.outcome("control.set", mode="velocity"))
        await asyncio.sleep(0.2)
        gcs.sim().mode = Px4Mode.POSCTL if px4 else CopterMode.LOITER  # by his transmitter
        pilots = "POSCTL" if px4 else "LOITER"
        await gcs.until(lambda: gcs.actor().vehicle.mode == pilots, 3.0)
        gcs.loses = frozenset()
        assert not (await setting)["ok"]
        await holding
        await asyncio.sleep(5.0)
        assert gcs.actor().vehicle.mode == pilots


@KINDS
@pytest.mark.parametrize("order", ["rtl", "land"])
async def test_the_hold_of_the_guard_takes_no_return_or_landing_back(
    tmp_path: Path, kind: dict[str, int], order: str
) -> None:
    """The link was cut for 2 s meanwhile: the guard's hold was the newer order."""
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.fly("velocity")
        await asyncio.sleep(3.0)
        gcs.cut = True
        await asyncio.sleep(0.5)
        ordered = asyncio.create_task(gcs.outcome(f"vehicles.{order}"))
        await asyncio.sleep(2.0)
        gcs.cut = False
        assert (await ordered)["ok"]
        await asyncio.sleep(3.0)
        assert gcs.actor().vehicle.mode in ("AUTO.RTL", "RTL", "AUTO.LAND", "LAND")
