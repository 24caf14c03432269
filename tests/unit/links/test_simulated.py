"""Simulated vehicles as a link of the daemon, in virtual time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.config import models
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.transmit_queue import OwnMessage
from skygcs.errors import LinkError
from skygcs.links.base import Channel
from skygcs.links.simulated import SimulatedVehiclesLink
from skygcs.runtime.linktable import make_link
from skygcs.sim.kinematics import Motion
from skygcs.sim.quad import Quad
from support.hosts import RecordingHost
from support.sim_pilot import sim_dialect

pytestmark = pytest.mark.looptime
ARM, TAKEOFF, LAND, REQUEST_MESSAGE = 400, 22, 21, 512
GUIDED = 4


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The link loads its dialect; not from or into the user's cache."""
    monkeypatch.setattr("skygcs.links.simulated.load_dialect", lambda name: sim_dialect())
    monkeypatch.setenv("XDG_CACHE_HOME", str(Path(tmp_path_factory.getbasetemp()) / "cache"))
    yield


class Host(RecordingHost):
    """Parses with the vehicles' dialect."""

    def __init__(self) -> None:
        super().__init__()
        self.dialect = sim_dialect()

    def new_parser(self, config: models.LinkConfig) -> FrameParser:
        return FrameParser(self.dialect)

    def names(self, sysid: int | None = None) -> list[str]:
        return [f.name for _, f in self.heard if sysid in (None, f.sysid)]

    def last(self, name: str, sysid: int) -> dict[str, Any]:
        return [f.fields() for _, f in self.heard if f.name == name and f.sysid == sysid][-1]


def make(host: Host, **keys: Any) -> SimulatedVehiclesLink:
    link = make_link(models.SimulatedLinkConfig(name="sim", **keys), host, asyncio.get_running_loop())
    assert isinstance(link, SimulatedVehiclesLink)
    return link


def own(name: str, **values: Any) -> OwnMessage:
    info = sim_dialect().find(name)
    return OwnMessage(info, info.pack(values), 255, 25)


def command(channel: Channel, to: int, number: int, **params: float) -> None:
    values = {"target_system": to, "target_component": 1, "command": number, **params}
    assert channel.send(own("COMMAND_LONG", **values))


@pytest.fixture
async def host() -> Host:
    return Host()


async def test_all_vehicles_are_behind_one_channel_px4s_first(host: Host) -> None:
    link = make(host, px4=2, ardupilot=1, first_sysid=21)
    assert link.channels == []
    await link.open()
    assert host.channels == link.channels and len(link.channels) == 1
    await asyncio.sleep(3)
    heartbeats = {f.sysid: f.fields()["autopilot"] for _, f in host.heard if f.name == "HEARTBEAT"}
    assert heartbeats == {21: 12, 22: 12, 23: 3}
    assert {channel for channel, _ in host.heard} == set(link.channels)
    await link.close()


async def test_heartbeats_keep_their_rate_on_the_loops_clock(host: Host) -> None:
    link = make(host, px4=1, ardupilot=1)
    await link.open()
    await asyncio.sleep(60)
    assert host.names(1).count("HEARTBEAT") in (60, 61)
    assert host.names(2).count("HEARTBEAT") in (60, 61)
    stats = link.channels[0].parser.stats
    assert stats.good == len(host.heard) and stats.skipped_bytes == stats.bad_crc == 0
    await link.close()


async def test_an_order_is_carried_out_and_answered_but_not_from_within_the_send(host: Host) -> None:
    link = make(host, px4=1)
    await link.open()
    await asyncio.sleep(10)
    channel = link.channels[0]
    host.heard.clear()
    command(channel, 1, REQUEST_MESSAGE, param1=148)
    assert host.heard == []
    await asyncio.sleep(0)
    assert sorted(host.names()) == ["AUTOPILOT_VERSION", "COMMAND_ACK"]
    ack = host.last("COMMAND_ACK", 1)
    assert (ack["result"], ack["target_system"], ack["target_component"]) == (0, 255, 25)
    assert [m.info.name for _, m, _ in host.sent] == ["COMMAND_LONG"]
    await link.close()


async def test_one_of_several_flies_and_lands_in_virtual_time(host: Host) -> None:
    link = make(host, px4=1, ardupilot=2)
    await link.open()
    await asyncio.sleep(12)
    channel = link.channels[0]
    command(channel, 3, 176, param1=1, param2=GUIDED)
    command(channel, 3, ARM, param1=1)
    command(channel, 3, TAKEOFF, param7=10)
    await asyncio.sleep(20)
    assert host.last("GLOBAL_POSITION_INT", 3)["relative_alt"] == pytest.approx(10_000, abs=300)
    assert host.last("GLOBAL_POSITION_INT", 2)["relative_alt"] == 0
    command(channel, 0, LAND)
    await asyncio.sleep(30)
    assert not host.last("HEARTBEAT", 3)["base_mode"] & 128
    assert link.vehicles[2].motion.on_ground
    await link.close()


async def test_forwarded_bytes_reach_the_vehicles_too(host: Host) -> None:
    link = make(host, ardupilot=1)
    await link.open()
    await asyncio.sleep(10)
    raw = own("COMMAND_LONG", target_system=1, target_component=1, command=ARM, param1=1).encode(5, 2)
    channel = link.channels[0]
    assert channel.send(raw)
    await asyncio.sleep(1)
    assert link.vehicles[0].armed
    assert (channel.tx_frames, channel.tx_bytes) == (1, len(raw))
    assert channel.send(b"\xfd\x09garbage") and channel.send(b"")
    host.heard.clear()
    await asyncio.sleep(2)
    assert "HEARTBEAT" in host.names()
    await link.close()


async def test_after_close_nothing_comes_and_nothing_is_taken(host: Host) -> None:
    link = make(host, px4=1)
    await link.open()
    await asyncio.sleep(5)
    channel = link.channels[0]
    await link.close()
    await link.close()
    assert host.channels == [] and len(host.detached) == 1
    host.heard.clear()
    await asyncio.sleep(5)
    assert host.heard == []
    assert not channel.send(own("HEARTBEAT")) and channel.tx_dropped == 1


async def test_the_vehicles_live_on_while_the_link_is_closed(host: Host) -> None:
    link = make(host, px4=1)
    await link.open()
    await asyncio.sleep(5)
    vehicles = link.vehicles
    boot_ms = host.last("GLOBAL_POSITION_INT", 1)["time_boot_ms"]
    await link.close()
    await asyncio.sleep(20)
    await link.open()
    await asyncio.sleep(1)
    assert link.vehicles == vehicles
    assert host.last("GLOBAL_POSITION_INT", 1)["time_boot_ms"] > boot_ms + 20_000
    await link.close()


async def test_a_loop_that_stood_still_lives_through_half_a_second_at_most_and_the_vehicles_leave_out_the_rest() -> (
    None
):
    host = Host()
    link = make(host, px4=1)
    await link.open()
    await asyncio.sleep(5)
    boot_ms = host.last("GLOBAL_POSITION_INT", 1)["time_boot_ms"]
    assert link._timer is not None
    link._timer.cancel()  # as if nothing on the loop ran
    await asyncio.sleep(40)
    host.heard.clear()
    link._tick()
    assert 0 < len(host.heard) < 60, "of 40 s there would be some thousand frames"
    await asyncio.sleep(1)
    assert host.last("GLOBAL_POSITION_INT", 1)["time_boot_ms"] > boot_ms + 40_000, "its clock did not stand still"
    await link.close()


async def test_closing_from_within_a_frame_is_safe(host: Host) -> None:
    link = make(host, px4=3)
    closed: list[asyncio.Task[None]] = []

    def close_at_once(channel: Channel, frame: Frame) -> None:
        if not closed:
            closed.append(asyncio.ensure_future(link.close()))

    host.on_frame = close_at_once
    await link.open()
    await asyncio.sleep(5)
    assert closed and closed[0].done() and link.channels == []


async def test_the_wall_clock_of_the_vehicles_is_ours(host: Host) -> None:
    before = time.time()
    link = make(host, px4=1)
    await link.open()
    await asyncio.sleep(10)
    clock = host.last("SYSTEM_TIME", 1)
    assert clock["time_unix_usec"] / 1e6 - clock["time_boot_ms"] / 1e3 == pytest.approx(before, abs=30)
    await link.close()


async def test_ids_beyond_255_are_a_link_error() -> None:
    link = make(Host(), px4=10, first_sysid=250)
    with pytest.raises(LinkError, match=r"sim.*1\.\.255"):
        await link.open()
    await link.close()


async def test_twenty_vehicles_for_a_minute_lose_no_frame(host: Host) -> None:
    link = make(host, px4=10, ardupilot=10)
    await link.open()
    await asyncio.sleep(60)
    assert {f.sysid for _, f in host.heard} == set(range(1, 21))
    for sysid in range(1, 21):
        seqs = [f.seq for _, f in host.heard if f.sysid == sysid]
        assert seqs == [i & 0xFF for i in range(len(seqs))]
    await link.close()


async def test_the_conditions_of_the_file_are_those_the_vehicles_fly_in(host: Host) -> None:
    link = make(
        host, px4=1, ardupilot=1, airframe="ideal", attitude_lag_s=0.1, wind_mps=4.0, wind_from_deg=0.0, gps_noise_m=0.5
    )
    await link.open()
    for vehicle in link.vehicles:
        assert isinstance(vehicle.motion, Quad)
        assert vehicle.motion.airframe.attitude_lag_s == 0.1 and vehicle.motion.airframe.thrust_lag_s == 0.0
        assert vehicle.motion.wind.mean_enu_mps == pytest.approx((0.0, -4.0, 0.0))
        assert vehicle.estimated is not vehicle.motion
    await link.close()
    exact = make(host, px4=1, dynamics="kinematic")
    await exact.open()
    assert type(exact.vehicles[0].motion) is Motion
    await exact.close()
