"""What programs have vehicles stream on a link of role vehicle, and what is left of it when they are gone."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from skygcs.sim.vehicle import SimVehicle
from support.gcs_flood import GroundStation
from support.on_air import OnAir, on_air

PX4, COPTER = 1, 2
GONE_AFTER_S = 20.0


@asynccontextmanager
async def by_cable(tmp_path: Path, stations: int = 1, **streams: float) -> AsyncIterator[OnAir]:
    """A PX4 and an ArduCopter on a link of role vehicle, met and asked for what skygcs wants."""
    wanted = {"defaults": {"streams": streams}} if streams else {}
    link = {"role": "vehicle", "radio": None}
    async with on_air(tmp_path, link=link, stations=stations, **wanted) as air:
        air.daemon.leftover_streams._gone_after_s = GONE_AFTER_S
        await asyncio.sleep(40)
        yield air


def mavproxy(air: OnAir, link: str = "gcs0", hz: int = 4, sysid: int = 255) -> GroundStation:
    """It asks for all streams again and again as long as it lives."""
    station = GroundStation(air.daemon, link, sysid=sysid, compid=230)
    station.every(1.0, "HEARTBEAT", type=6, autopilot=8, mavlink_version=3)
    for vehicle in (PX4, COPTER):
        target = {"target_system": vehicle, "target_component": 1}
        station.every(5.0, "REQUEST_DATA_STREAM", **target, req_stream_id=0, req_message_rate=hz, start_stop=1)
    return station


def bytes_per_s(air: OnAir, sysid: int) -> float:
    return sum(hz * (12 + air.daemon.dialect.by_name[name].length) for name, hz in air.rates(sysid).items())


async def test_the_streams_that_a_program_asked_for_end_when_it_is_gone(tmp_path: Path) -> None:
    async with by_cable(tmp_path) as air:
        before = air.rates(COPTER)
        station = mavproxy(air)
        await asyncio.sleep(30)
        flooded = bytes_per_s(air, COPTER)
        assert air.rates(COPTER)["RAW_IMU"] == 4.0
        station.disconnect()
        await asyncio.sleep(GONE_AFTER_S - 5)
        assert air.rates(COPTER)["RAW_IMU"] == 4.0  # a program that is silent for a while is still there
        await asyncio.sleep(15)
        assert air.rates(COPTER) == before
        assert bytes_per_s(air, COPTER) < 0.3 * flooded
        await asyncio.sleep(60)
        assert air.rates(COPTER) == before
        assert not air.events("warning")


@pytest.mark.deep  # a minute with a second program
async def test_a_program_that_is_connected_is_not_fought(tmp_path: Path) -> None:
    async with by_cable(tmp_path, stations=2) as air:
        before = air.rates(COPTER)
        first, second = mavproxy(air), mavproxy(air, "gcs1", sysid=254)
        await asyncio.sleep(30)
        first.disconnect()
        asked: list[str] = []
        air.daemon.hub.on_sent = lambda channel, message, raw: asked.append(message.info.name)  # type: ignore[method-assign]
        await asyncio.sleep(2 * GONE_AFTER_S)
        assert air.rates(COPTER)["RAW_IMU"] == 4.0
        assert "REQUEST_DATA_STREAM" not in asked
        second.disconnect()
        await asyncio.sleep(GONE_AFTER_S + 10)
        assert air.rates(COPTER) == before


@pytest.mark.deep  # a minute with a second program
async def test_the_position_does_not_pause_when_streams_are_put_back(tmp_path: Path) -> None:
    async with by_cable(tmp_path) as air:
        station = mavproxy(air)
        await asyncio.sleep(30)
        station.disconnect()
        vehicle = air.daemon.fleet.vehicles[COPTER << 8 | 1].vehicle
        oldest_s = 0.0
        for _ in range(400):
            await asyncio.sleep(0.1)
            slot = vehicle.slot("GLOBAL_POSITION_INT")
            assert slot is not None
            oldest_s = max(oldest_s, air.daemon.now() - slot.at)
        assert oldest_s < 1.0
        assert air.rates(COPTER)["GLOBAL_POSITION_INT"] == 2.0


async def test_a_message_that_a_program_asked_a_px4_for_goes_back_to_its_own_rate(tmp_path: Path) -> None:
    async with by_cable(tmp_path) as air:
        before = air.rates(PX4)
        station = GroundStation(air.daemon, "gcs0", compid=191)
        target = {"target_system": PX4, "target_component": 1, "command": 511}
        for msgid, interval_us in ((30, 20_000.0), (33, 1_000_000.0), (105, 100_000.0)):
            station.send("COMMAND_LONG", **target, param1=msgid, param2=interval_us)
        await asyncio.sleep(10)
        assert air.rates(PX4)["ATTITUDE"] == 50.0 and air.rates(PX4)["GLOBAL_POSITION_INT"] == 1.0
        await asyncio.sleep(GONE_AFTER_S + 5)
        assert air.rates(PX4) == before


@pytest.mark.deep
async def test_what_a_person_has_set_stays(tmp_path: Path) -> None:
    async with by_cable(tmp_path) as air:
        station = GroundStation(air.daemon, "gcs0", compid=191)
        target = {"target_system": PX4, "target_component": 1, "command": 511}
        station.send("COMMAND_LONG", **target, param1=30, param2=20_000.0)
        await asyncio.sleep(1)
        assert (await air.daemon.fleet.find(str(PX4)).set_message_interval("ATTITUDE", 8.0)).ok
        await asyncio.sleep(GONE_AFTER_S + 30)
        assert air.rates(PX4)["ATTITUDE"] == 8.0


def without_position(vehicle: SimVehicle) -> None:
    """A PX4 whose estimator has none yet sends no GLOBAL_POSITION_INT, at whatever rate."""
    vehicle.builders["GLOBAL_POSITION_INT"] = lambda *a: None  # type: ignore[assignment,return-value]


@pytest.mark.deep  # two minutes
async def test_a_px4_that_has_no_position_yet_keeps_its_own_rate(tmp_path: Path) -> None:
    """It was asked down to 2 Hz of 5, for every program, as it had nothing to send when it was met."""
    async with on_air(tmp_path, link={"role": "vehicle", "radio": None}, ardupilot=0) as air:
        own = 5.0  # PX4's on a link of mode Normal
        air.sim(PX4).streams.set_default("GLOBAL_POSITION_INT", own, air.daemon.now())
        build = air.sim(PX4).builders["GLOBAL_POSITION_INT"]
        without_position(air.sim(PX4))
        await asyncio.sleep(90)
        slot = air.daemon.fleet.vehicles[PX4 << 8 | 1].vehicle.slot("GLOBAL_POSITION_INT")
        assert slot is None
        assert air.rates(PX4)["GLOBAL_POSITION_INT"] == own
        air.sim(PX4).builders["GLOBAL_POSITION_INT"] = build
        await asyncio.sleep(20)
        assert air.rates(PX4)["GLOBAL_POSITION_INT"] == own
