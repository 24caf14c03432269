"""Control by setpoints and an order that takes over: the stream holds the vehicle until the order has taken effect."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pytest

from skygcs.ext.joystick.commands import JoystickFlight
from skygcs.ext.joystick.stick_mapping import AxisChoice, StickAxes, StickLimits
from skygcs.ext.joystick.stick_session import StickSession
from skygcs.sim.conditions import conditions_of
from support.examples import covered_by_other_flights
from support.flown import Flown, aloft

pytestmark = pytest.mark.looptime

KINDS = pytest.mark.parametrize("kind", [{"px4": 1}, {"px4": 0, "ardupilot": 1}], ids=["px4", "ardupilot"])
WINDY = conditions_of(wind_mps=6.0)

DENIED: dict[str, tuple[str, dict[str, Any]]] = {
    "mode": ("vehicles.mode", {"mode": "{mission}"}),
    "mission": ("missions.start", {}),
}


@dataclass
class StationInTheLoop:
    """What a joystick calls, without a socket."""

    gcs: Flown

    async def call(self, method: str, **params: Any) -> Any:
        return await self.gcs(method, **params)

    async def setpoint(self, targets: str, **setpoint: Any) -> Any:
        return (await self.gcs("control.setpoint", targets=targets, **setpoint))["outcomes"]

    async def hold(self, targets: str) -> Any:
        return (await self.gcs("vehicles.hold", targets=targets))["outcomes"]


@covered_by_other_flights
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
