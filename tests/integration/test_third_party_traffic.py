"""Ground stations and programs beside the daemon, before one emulated radio with ten vehicles; in virtual time."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from skygcs.core.mavlink.frame import Frame
from skygcs.core.radio_link.corrections import RtcmDeframer, content_of, fragments_of
from skygcs.sim.param_table import Param
from support.daemons import first_heard, listening
from support.gcs_flood import GroundStation
from support.on_air import OnAir, on_air
from support.rtcm import rtcm_frame

VEHICLES = list(range(1, 11))
AGE_S = 2.5
ASK_INTERVAL = 510

RADIO_FULL_S = 1.7
"""An ArduPilot sends its list until half of its radio's 1850 bytes are full, which take so long at 553 B/s. Its
positions and acknowledgements stand behind them, and nobody on the ground can help that."""

REPEAT_S = 1.6
"""Until a command is repeated, of which one in fifty is lost on its way or on its way back: a round and a half, and
.2 s. Some ten orders in a test go to the vehicle whose list comes, so that one of them decides the maximum."""


def p95(values: list[float]) -> float:
    return sorted(values)[int(0.95 * len(values))]


def in_time(acks_s: list[float], limit_s: float) -> bool:
    """Nine of ten within the limit. The radio loses 1 % each way: some two of a hundred are repeated, and now and then
    six."""
    return sorted(acks_s)[int(0.9 * len(acks_s))] <= limit_s


class Field:
    """Ten vehicles in service, and what becomes of them while others send."""

    def __init__(self, air: OnAir) -> None:
        self.air = air
        self.ages_s: list[float] = []
        self.acks_s: list[float] = []
        self.listing_ages_s: list[float] = []
        self.listing_acks_s: list[float] = []
        """The same of a vehicle while its parameter list comes."""
        self.unanswered = 0
        self.ack_limit_s = 2 * air.air()["up"]["round_s"] + 0.5

    async def watched(self, for_s: float) -> None:
        """Look at every position five times a second and order something every half second."""
        orders: list[asyncio.Task[None]] = []
        for step in range(int(for_s * 5)):
            for sim in self.air.link.vehicles:
                slot = self.air.daemon.fleet.vehicles[sim.sysid << 8 | 1].vehicle.slot("GLOBAL_POSITION_INT")
                assert slot is not None and slot.frame is not None
                ages = self.listing_ages_s if sim.sysid == self.listed else self.ages_s
                ages.append((sim.boot_ms - slot.frame.fields()["time_boot_ms"]) / 1000)
            if step % 3 == 0:
                orders.append(asyncio.create_task(self._order(step % 10 + 1)))
            await asyncio.sleep(0.2)
        await asyncio.gather(*orders)

    async def _order(self, sysid: int) -> None:
        listed = self.listed == sysid
        outcome = await self.air.daemon.fleet.find(str(sysid)).command(ASK_INTERVAL, (33.0,))
        if outcome.ok:
            (self.listing_acks_s if listed else self.acks_s).append(outcome.elapsed_s)
        else:
            self.unanswered += 1

    @property
    def third_party(self) -> dict[str, Any]:
        """What link.status tells of others' traffic."""
        return dict(self.air.air()["up"]["third_party"])

    @property
    def listed(self) -> int | None:
        """The vehicle whose list comes, if it is one at a time."""
        running = self.third_party["param_lists"]["running"]
        return None if running is None else int(running["sysid"])


@contextlib.asynccontextmanager
async def field(
    tmp_path: Path, *, stations: int = 1, parameters: int = 0, third_party: Mapping[str, Any] | None = None
) -> AsyncIterator[Field]:
    """When the plan is followed. ``parameters``: what each vehicle has of them at least."""
    link = {"stream_profile": "nav", "third_party": dict(third_party or {})}
    async with on_air(
        tmp_path, px4=5, ardupilot=5, radio={"air_kbps": 64, "loss": 0.01}, link=link, stations=stations
    ) as air:
        for sim in air.link.vehicles:
            sim.params.take_in({f"X{n:04d}": Param(f"X{n:04d}", 1.0) for n in range(parameters - len(sim.params))})
        await air.settled(10)
        await asyncio.sleep(25)
        yield Field(air)


def stations_of(field: Field, number: int = 1) -> list[GroundStation]:
    """The first is a QGroundControl, the others are programs of other systems."""
    return [GroundStation(field.air.daemon, f"gcs{n}", 255 - n, 191 if n else 190) for n in range(number)]


@pytest.mark.deep
async def test_a_station_that_asks_ten_vehicles_for_everything_disturbs_nobody(tmp_path: Path) -> None:
    async with field(tmp_path, parameters=900) as flown:
        (station,) = stations_of(flown)
        station.connect(VEHICLES)
        await flown.watched(60)
        station.disconnect()
    assert p95(flown.ages_s) <= 1.5
    assert p95(flown.listing_ages_s) <= 1.5 + RADIO_FULL_S, "of the one whose list comes"
    assert in_time(flown.acks_s, flown.ack_limit_s)
    assert median(flown.listing_acks_s) <= flown.ack_limit_s + RADIO_FULL_S
    assert max(flown.listing_acks_s) <= flown.ack_limit_s + RADIO_FULL_S + REPEAT_S
    assert not flown.unanswered


@pytest.mark.deep
async def test_without_the_gate_it_disturbs_all(tmp_path: Path) -> None:
    """What the rules are for: the same flood, let through."""
    async with field(tmp_path, parameters=900, third_party={"param_lists": "allow"}) as flown:
        (station,) = stations_of(flown)
        station.connect(VEHICLES)
        await flown.watched(60)
        station.disconnect()
    assert p95(flown.ages_s) > AGE_S
    assert not in_time(flown.acks_s, flown.ack_limit_s)


@pytest.mark.deep
async def test_all_ten_lists_come_one_after_the_other_and_the_station_is_told_that_they_wait(tmp_path: Path) -> None:
    async with field(tmp_path, parameters=100) as flown:
        (station,) = stations_of(flown)
        station.connect(VEHICLES)
        await flown.air.until(lambda: all(station.has_list(v) for v in VEHICLES), 900)
        station.disconnect()
        reported = flown.third_party
    assert reported["param_lists"]["waiting"] == []
    ended = [station.listed_at[v] for v in VEHICLES]
    assert ended == sorted(ended), "in the order in which they were asked for"
    assert "parameters of 2 wait: one list at a time" in station.texts
    (held,) = [text for text in flown.air.events("third_party") if "parameters of vehicle 2" in text]
    assert "255/190 (memory)" in held
    assert 'links.air.third_party.param_lists = "allow"' in held


@pytest.mark.deep
async def test_eight_programs_that_flood_disturb_nobody_and_a_ninth_is_served(tmp_path: Path) -> None:
    async with field(tmp_path, stations=9, parameters=100) as flown:
        *flooding, quiet = stations_of(flown, 9)
        for station in flooding:
            station.connect(VEHICLES)
        answered: list[float] = []
        quiet.on_frame = lambda frame: answered.append(frame.sysid) if frame.name == "PARAM_VALUE" else None
        await asyncio.sleep(5)
        await flown.watched(90)
        answered.clear()
        asked = flown.air.daemon.now()
        quiet.again(3.0, 10, "PARAM_REQUEST_READ", {"target_system": 9, "target_component": 1, "param_index": 7})
        await flown.air.until(lambda: 9 in answered, 20)
        assert flown.air.daemon.now() - asked < 20
        for station in (*flooding, quiet):
            station.disconnect()
        assert flown.third_party["waiting"] <= 512
        classes = flown.air.air()["up"]["classes"]
    assert p95(flown.ages_s) <= AGE_S
    assert in_time(flown.acks_s, flown.ack_limit_s)
    assert not flown.unanswered
    assert classes["command"]["dropped"] == classes["command"]["refused"] == 0


async def test_a_stop_that_somebody_else_gives_goes_before_the_flood_of_others(tmp_path: Path) -> None:
    async with field(tmp_path, stations=3) as flown:
        *flooding, pilot = stations_of(flown, 3)
        for station in flooding:
            station.connect(VEHICLES)
        await asyncio.sleep(10)
        heard = first_heard(flown.air.link.vehicles, 400)
        stopped = flown.air.daemon.now()
        for vehicle in VEHICLES:
            target = {"target_system": vehicle, "target_component": 1}
            pilot.again(0.5, 5, "COMMAND_LONG", {**target, "command": 400, "param2": 21196.0})
        await flown.air.until(lambda: len(heard) == 10, 10)
        for station in (*flooding, pilot):
            station.disconnect()
        round_s = flown.air.air()["up"]["round_s"]
    assert max(heard.values()) - stopped <= 2 * round_s + 0.5


async def send_corrections(base: GroundStation) -> None:
    """One message of 700 bytes each second, numbered."""
    for second in range(1000):
        for values in fragments_of(rtcm_frame(1077, epoch=second, body_bytes=694), second):
            base.send("GPS_RTCM_DATA", **values)
        await asyncio.sleep(1.0)


@pytest.mark.deep
async def test_corrections_arrive_whole_and_new_and_leave_commands_alone(tmp_path: Path) -> None:
    """756 bytes a second, of which the radio's share carries a quarter."""
    async with field(tmp_path) as flown:
        (base,) = stations_of(flown)
        got: list[tuple[float, int]] = []
        deframer = RtcmDeframer()

        def hear(frame: Frame, now: float) -> None:
            fields = frame.fields()
            for message in deframer.feed(bytes(fields["data"][: fields["len"]])):
                got.append((now, content_of(message).epoch or 0))

        listening(flown.air.sim(4), hear, "GPS_RTCM_DATA")
        began = flown.air.daemon.now()
        sending = asyncio.create_task(send_corrections(base))
        await flown.watched(60)
        sending.cancel()
        reported = flown.air.air()["up"]["corrections"]
        sent_bytes = flown.air.air()["up"]["classes"]["correction"]["sent_bytes"]
    assert len(got) >= 0.8 * 60 * 0.4 * 497 / 756
    ages_s = [at - began - epoch for at, epoch in got]
    assert median(ages_s) <= 5, "new when it is begun, and four seconds on its way"
    assert max(ages_s) <= 8, "of fourteen one may have waited for two rounds more"
    assert [epoch for _, epoch in got] == sorted({epoch for _, epoch in got}), "no older one after a newer"
    assert reported["messages"] >= len(got)
    assert sent_bytes <= 0.4 * 553 * 62 + 756
    assert in_time(flown.acks_s, flown.ack_limit_s)
    assert p95(flown.ages_s) <= AGE_S
