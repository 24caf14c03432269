"""Each row of the table of conditions: refused without it, and whether somebody may insist."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.control import ControlSettings
from skygcs.core.control.guard import ControlMode
from skygcs.core.geo import Origin, geodetic_from_enu
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.runtime.entry_conditions import EntryConditions
from support.services import KnownLinks, services
from support.vehicles import HOME, PX4, PX4_LOITER, Voice, flight_dialect

pytestmark = pytest.mark.looptime

OFFBOARD = 6 << 16
ATTITUDE, VELOCITY, POSITION, RAW = (ControlMode.ATTITUDE, ControlMode.VELOCITY, ControlMode.POSITION, ControlMode.RAW)


class Links(KnownLinks):
    """Links with a gate, and with a radio that may be too slow."""

    gate: str | None = None
    too_slow: str | None = None

    def authority_refusal(self, sysid: int) -> str | None:
        return self.gate

    def stream_refusal(self, vehicle: Vehicle, flown: Callable[[], Iterable[Vehicle]]) -> str | None:
        return self.too_slow


class Hovering:
    """A PX4 that hovers at 10 m in the middle of the fence, and its conditions."""

    def __init__(self, log_dir: Path, kind: int = mav.MAV_TYPE_QUADROTOR) -> None:
        self.loop = asyncio.get_running_loop()
        self.voice = Voice(1)
        self.vehicle = Vehicle(1, 1, flight_dialect(), name="alpha", decoder=Decoder(flight_dialect()))
        self.vehicle.origin = Origin(*HOME)
        self.links = Links()
        self.plans: list[Plan] = []
        runner: Any = SimpleNamespace(attempt_in_control=self.attempt)
        shared = services(flight_dialect(), None, self.loop, lambda event: None, links=self.links, log_dir=log_dir)
        self.conditions = EntryConditions(self.vehicle, ControlSettings(), runner, shared)
        self.kind = kind
        self.say(PX4_LOITER)

    def say(self, mode: int, east_m: float = 0.0) -> None:
        lat, lon, alt = geodetic_from_enu(east_m, 0.0, 10.0, Origin(*HOME))
        beat = mav.MAVLink_heartbeat_message(self.kind, mav.MAV_AUTOPILOT_PX4, 128 | 1, mode, 4, 3)
        for frame in (self.voice.say(beat), self.voice.landed(2), self.voice.position(lat, lon, alt, 10.0)):
            self.vehicle.on_frame(frame, self.loop.time())

    def param(self, name: bytes, value: float) -> None:
        told = mav.MAVLink_param_value_message(name, value, mav.MAV_PARAM_TYPE_REAL32, 1, 0)
        self.vehicle.on_frame(self.voice.say(told), self.loop.time())

    async def attempt(self, planner: Callable[[float], Plan]) -> None:
        self.plans.append(planner(self.loop.time()))

    def refusal(self, *, active: bool = False) -> str | None:
        try:
            self.conditions.check(self.loop.time(), active=active)
        except RefusedError as error:
            return str(error)
        return None


async def test_a_hovering_vehicle_inside_its_fence_may_be_flown(tmp_path: Path) -> None:
    hovering = Hovering(tmp_path)
    assert hovering.vehicle.family == "px4" and PX4 == mav.MAV_AUTOPILOT_PX4
    assert hovering.refusal() is None
    hovering.conditions.check_radio()
    assert hovering.plans == []


async def test_what_is_known_without_asking_refuses_it(tmp_path: Path) -> None:
    hovering = Hovering(tmp_path)
    hovering.links.gate = "the other site has it"
    assert hovering.refusal() == "the other site has it"
    hovering.links.gate = None
    hovering.say(PX4_LOITER, east_m=60.0)
    assert "at x 60.0 m" in str(hovering.refusal())
    hovering.vehicle.origin = None
    assert "no origin yet, so there is no fence" in str(hovering.refusal())


async def test_a_px4_in_offboard_is_led_by_another_unless_these_are_our_setpoints(tmp_path: Path) -> None:
    hovering = Hovering(tmp_path)
    assert hovering.refusal() is None
    hovering.say(OFFBOARD)
    assert "it is in OFFBOARD already: another program sends it setpoints" in str(hovering.refusal())
    assert hovering.refusal(active=True) is None
    # it shows the mode of our own, which have ended, for a while
    hovering.conditions.ours_until = asyncio.get_running_loop().time() + 1.0
    assert hovering.refusal() is None


async def test_a_radio_that_carries_no_stream_refuses_it(tmp_path: Path) -> None:
    hovering = Hovering(tmp_path)
    hovering.links.too_slow = "its radio leaves 12 B/s"
    assert hovering.refusal() is None
    with pytest.raises(RefusedError, match="its radio leaves 12 B/s"):
        hovering.conditions.check_radio()


@pytest.mark.parametrize("control_mode", [ATTITUDE, RAW])
async def test_a_tilt_that_is_kept_without_setpoints_refuses_thrust_unless_somebody_insists(
    tmp_path: Path, control_mode: ControlMode
) -> None:
    hovering = Hovering(tmp_path)
    hovering.param(b"COM_OF_LOSS_T", 5.0)
    with pytest.raises(RefusedError, match=r"COM_OF_LOSS_T is 5 s: if the setpoints stop"):
        await hovering.conditions.check_parameters(control_mode, active=True, force=False)
    await hovering.conditions.check_parameters(control_mode, active=False, force=True)
    read = [[step.name for step in plan.steps] for plan in hovering.plans]
    assert read == [["read MPC_THR_HOVER", "read COM_OF_LOSS_T", "read COM_OBL_RC_ACT"]] * 2, "anew, each time"


async def test_a_thrust_without_meaning_is_refused_whoever_insists(tmp_path: Path) -> None:
    hovering = Hovering(tmp_path, mav.MAV_TYPE_DECAROTOR)
    with pytest.raises(RefusedError, match="for multirotors only, and its type is decarotor"):
        await hovering.conditions.check_parameters(ATTITUDE, active=False, force=True)


@pytest.mark.parametrize(("active", "asked"), [(False, [["read COM_OBL_RC_ACT"]]), (True, [])])
async def test_position_and_velocity_need_only_what_it_does_when_setpoints_end(
    tmp_path: Path, active: bool, asked: list[list[str]]
) -> None:
    hovering = Hovering(tmp_path)
    hovering.param(b"COM_OF_LOSS_T", 5.0)
    for control_mode in (VELOCITY, POSITION):
        hovering.plans.clear()
        await hovering.conditions.check_parameters(control_mode, active=active, force=False)
        assert [[step.name for step in plan.steps] for plan in hovering.plans] == asked
