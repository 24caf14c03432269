from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from skygcs.core.mavlink.frame import Frame
from skygcs.core.radio_link.transmit_queue import Priority
from support.vehicles import ARDUPILOT, PX4, Ground, ScriptedVehicle, Sent, accept_everything

pytestmark = pytest.mark.looptime

INTERVAL, READ_INTERVAL, ATTITUDE, SYSTEM_TIME, POSITION = 511, 510, 30.0, 2.0, 33.0

Script = Callable[[ScriptedVehicle, Sent], None]


def wanting(**rates_hz: float) -> dict[str, Any]:
    return {"defaults": {"streams": rates_hz}}


def asked(ground: Ground) -> list[tuple[float, float]]:
    """(message id, microseconds) of every SET_MESSAGE_INTERVAL."""
    return [(s.param1, s.param2) for s in ground.sent if s.name == "COMMAND_LONG" and s.command == INTERVAL]


async def test_only_what_does_not_come_is_asked_for_at_its_rate() -> None:
    async with Ground(wanting(ATTITUDE=2.0, GLOBAL_POSITION_INT=1.0, EXTENDED_SYS_STATE=1.0)) as ground:
        vehicle = ScriptedVehicle(ground, 1, PX4)  # positions and landed states come with its heartbeats
        frame = vehicle.mav

        def stream(v: ScriptedVehicle, sent: Sent) -> None:
            accept_everything(v, sent)
            for n in range(100 if sent.name == "COMMAND_LONG" and sent.command == INTERVAL else 0):
                v.tell(v.say(frame.attitude_encode(n, 0, 0, 0, 0, 0, 0)), 0.5 * n)

        vehicle.script = stream
        await asyncio.sleep(40)
        assert asked(ground) == [(ATTITUDE, 500_000.0)]


async def test_old_firmware_is_asked_the_old_way() -> None:
    async with Ground(wanting(ATTITUDE=0.5)) as ground:
        vehicle = ScriptedVehicle(ground, 1, ARDUPILOT)
        vehicle.script = lambda v, sent: v.reply(sent, 3) if sent.name == "COMMAND_LONG" else None
        await asyncio.sleep(120)
        assert len(asked(ground)) == 1
        requests = [s for s in ground.sent if s.name == "REQUEST_DATA_STREAM"]
        assert 2 <= len(requests) <= 6, "ever more rarely, for none comes"
        assert {(s.req_stream_id, s.req_message_rate, s.start_stop) for s in requests} == {(10, 1, 1)}


async def test_a_message_the_vehicle_refuses_is_not_asked_for_again_until_it_reboots() -> None:
    async with Ground(wanting(ATTITUDE=1.0)) as ground:
        vehicle = ScriptedVehicle(ground, 1, PX4)
        vehicle.script = lambda v, sent: v.reply(sent, 2)
        await asyncio.sleep(120)
        assert len(asked(ground)) == 1
        identified = [s for s in ground.sent if s.priority is Priority.PROTOCOL]
        vehicle.restart(4.0)
        await asyncio.sleep(24)
        assert len(asked(ground)) == 2
        assert len([s for s in ground.sent if s.priority is Priority.PROTOCOL]) > len(identified)


async def test_a_rate_a_person_has_set_is_left_alone() -> None:
    async with Ground(wanting(ATTITUDE=1.0, SYSTEM_TIME=1.0)) as ground:
        vehicle = ScriptedVehicle(ground, 1, PX4)
        (actor,) = await ground.met(vehicle)
        assert (await actor.set_message_interval("ATTITUDE", 0)).ok
        await asyncio.sleep(60)
        assert (ATTITUDE, -1.0) in asked(ground)
        assert [i for i, _ in asked(ground)].count(ATTITUDE) == 1
        assert SYSTEM_TIME in [i for i, _ in asked(ground)]


async def test_the_estimator_of_an_ardupilot_is_asked_for_and_that_of_a_px4_comes_by_itself() -> None:
    async with Ground(wanting(EKF_STATUS_REPORT=0.2)) as ground:
        ScriptedVehicle(ground, 1, PX4)
        ScriptedVehicle(ground, 2, ARDUPILOT)
        await asyncio.sleep(8)
        requests = [s for s in ground.sent if s.name == "COMMAND_LONG" and s.command == INTERVAL]
        assert {(s.sysid, s.param1) for s in requests} == {(2, 193.0)}


async def test_nobody_is_asked_while_lost() -> None:
    async with Ground(wanting(ATTITUDE=1.0)) as ground:
        vehicle = ScriptedVehicle(ground, 1, PX4)
        await ground.met(vehicle)
        vehicle.silent = True
        await asyncio.sleep(8)
        before = len(ground.sent)
        await asyncio.sleep(100)
        assert len(ground.sent) == before


POSITION_MISSING = wanting(HOME_POSITION=2.0)
"""A message that a scripted vehicle does not stream by itself."""
HOME = 242.0


def telling(interval_us: int, result: int = 0) -> Script:
    """A vehicle that says how often it streams a message, and obeys."""

    def script(v: ScriptedVehicle, sent: Sent) -> None:
        if sent.name == "COMMAND_LONG" and sent.command == READ_INTERVAL:
            if result == 0:
                v.tell(v.say(v.mav.message_interval_encode(int(sent.param1), interval_us)))
            v.reply(sent, result)
        else:
            accept_everything(v, sent)

    return script


@pytest.mark.parametrize(("interval_us", "is_asked"), [(200_000, False), (-1, True), (0, True), (1_000_000, True)])
async def test_a_px4_is_not_asked_for_what_it_streams_as_soon_as_it_has_it(interval_us: int, is_asked: bool) -> None:
    """200 ms: its own 5 Hz of a position that its estimator does not have yet."""
    async with Ground(POSITION_MISSING) as ground:
        vehicle = ScriptedVehicle(ground, 1, PX4)
        vehicle.script = telling(interval_us)
        await asyncio.sleep(100)
        assert ((HOME, 500_000.0) in asked(ground)) == is_asked
        questions = [s for s in ground.sent if s.name == "COMMAND_LONG" and s.command == READ_INTERVAL]
        assert 1 <= len(questions) <= 6  # ever more rarely


@pytest.mark.parametrize("result", [1, 2, 3, 4])
async def test_a_vehicle_that_cannot_say_is_asked(result: int) -> None:
    async with Ground(POSITION_MISSING) as ground:
        vehicle = ScriptedVehicle(ground, 1, PX4)
        vehicle.script = telling(0, result)
        await asyncio.sleep(60)
        assert (HOME, 500_000.0) in asked(ground)


async def test_an_ardupilot_is_asked_at_once() -> None:
    """It streams what it is told to, whether it knows it or not."""
    async with Ground(POSITION_MISSING) as ground:
        ScriptedVehicle(ground, 1, ARDUPILOT).script = telling(200_000)
        await asyncio.sleep(10)
        assert asked(ground)[0] == (HOME, 500_000.0)
        assert not [s for s in ground.sent if s.name == "COMMAND_LONG" and s.command == READ_INTERVAL]


def read(ground: Ground, name: str) -> int:
    """How often a parameter was requested."""
    return sum(s.name == "PARAM_REQUEST_READ" and s.param_id == name for s in ground.sent)


class Plane(ScriptedVehicle):
    """One that shows a fixed wing."""

    def beat(
        self, autopilot: int = ARDUPILOT, mode: int = 0, *, armed: bool = False, status: int = 3, kind: int = 1
    ) -> Frame:
        return super().beat(autopilot, mode, armed=armed, status=status, kind=kind)


async def test_what_an_order_of_a_plane_waits_for_is_asked_for_until_it_is_known() -> None:
    """Five requests in the first minute were all: a plane whose answers were lost then never took off."""
    async with Ground(wanting(ATTITUDE=0.5)) as ground:
        vehicle = Plane(ground, 1, ARDUPILOT)
        (actor,) = await ground.met(vehicle)
        await asyncio.sleep(70)
        before = read(ground, "TKOFF_ALT")
        await asyncio.sleep(600)
        assert before + 9 <= read(ground, "TKOFF_ALT") <= before + 11, "once a minute"
        assert actor.vehicle.rotors_known, "by its EXTENDED_SYS_STATE"
        assert read(ground, "Q_ENABLE") <= 5, "a build without QuadPlanes has none"
        vehicle.tell(vehicle.say(vehicle.mav.param_value_encode(b"TKOFF_ALT", 50.0, 9, 900, 1)))
        await asyncio.sleep(1)
        before = read(ground, "TKOFF_ALT")
        await asyncio.sleep(200)
        assert read(ground, "TKOFF_ALT") == before
