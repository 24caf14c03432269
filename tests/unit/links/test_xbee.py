"""The XBee link at a pty with an emulated module behind it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from skygcs.config import models
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.xbee.api_frames import encode
from skygcs.errors import LinkError
from skygcs.links.xbee import MAX_UNWRITTEN_BYTES, XBeeChannel, XBeeLink, format_xbee_address
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle_group import make_vehicles
from skygcs.sim.xbee_mesh import MeshConfig, XBeeMesh
from support.hosts import RecordingHost, frames_in, open_descriptors, own, text, until
from support.loops import on_every_loop
from support.pseudo_tty import PtyRadio
from support.table import each
from support.vehicles import flight_dialect


@pytest.fixture
def radio(tmp_path: Path) -> Iterator[PtyRadio]:
    radio = PtyRadio(tmp_path / "ttyXBEE")
    radio.plug_in()
    yield radio
    radio.pull_out()


class Air:
    """Moves bytes between the pty and the emulated network; ``heard`` are frames that each vehicle got."""

    def __init__(self, radio: PtyRadio, mesh: XBeeMesh) -> None:
        self.radio = radio
        self.mesh = mesh
        self.heard: list[tuple[int, bytes]] = []
        for number, vehicle in enumerate(mesh.fleet.vehicles):
            vehicle.on_frame = lambda frame, now, n=number: self.heard.append((n, frame.raw))  # type: ignore[method-assign]

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        began = loop.time()
        while True:
            self.mesh.hear(self.radio.read())
            out = self.mesh.step(loop.time() - began)
            while out:
                out = out[self.radio.write(out) :]
                await asyncio.sleep(0.001)
            await asyncio.sleep(0.005)


@asynccontextmanager
async def opened(
    radio: PtyRadio, host: RecordingHost, count: int = 2, keys: dict[str, Any] | None = None, **network: Any
) -> AsyncIterator[tuple[XBeeLink, Air]]:
    vehicles = make_vehicles(
        flight_dialect(), px4=count, ardupilot=0, first_sysid=1, home=LocalFrame(43.78, -79.46, 180.0), seed=1
    )
    air = Air(radio, XBeeMesh(vehicles, flight_dialect(), MeshConfig(**network), Rng(1), 0.0))
    task = asyncio.ensure_future(air.run())
    config = models.XBeeLinkConfig(name="mesh", device=str(radio.path), rtscts=False, **(keys or {}))
    link = XBeeLink(config, host, asyncio.get_running_loop())
    try:
        await link.open()
        yield link, air
    finally:
        await link.close()
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def channel_of(link: XBeeLink, air: Air, vehicle: int) -> XBeeChannel:
    (channel,) = [c for c in link.channels if isinstance(c, XBeeChannel) and c.address == air.mesh.address(vehicle)]
    return channel


@each("api_mode", [1, 2])
@on_every_loop
async def test_every_node_is_a_channel_and_gets_only_its_own(radio: PtyRadio, api_mode: int) -> None:
    host = RecordingHost()
    async with opened(radio, host, keys={"api_mode": api_mode}, api_mode=api_mode, loss=0.2) as (link, air):
        await until(lambda: len(link.channels) == 2 and link.modem.state == "open")
        for channel in link.channels:
            await until(lambda c=channel: c.parser.stats.good > 5)
        by_channel = {c.peer: {f.sysid for h, f in host.heard if h is c} for c in link.channels}
        assert sorted(len(ids) for ids in by_channel.values()) == [1, 1]
        sent = [text(255, n, f"hello {n}") for n in range(40)]
        for n, raw in enumerate(sent):
            assert channel_of(link, air, n % 2).send(raw, Priority.COMMAND)
        await until(lambda: len(air.heard) == 40)
        for vehicle in (0, 1):
            assert [raw for n, raw in air.heard if n == vehicle] == sent[vehicle::2], "in order, none lost or doubled"
        assert all(c.parser.stats.skipped_bytes == 0 for c in link.channels)
    assert host.channels == []


@on_every_loop
async def test_small_frames_share_a_payload_and_a_long_one_is_split(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host, 1, payload_bytes=72) as (link, air):
        await until(lambda: link.channels and link.modem.state == "open")
        channel = channel_of(link, air, 0)
        before = air.mesh.stats.up
        sent = [own_bytes(n) for n in range(12)] + [text(255, 99, "x" * 50)] + [long_frame()]
        assert len(sent[0]) < 36 and len(sent[-1]) > 2 * 72
        for raw in sent:
            channel.send(raw, Priority.COMMAND)
        await until(lambda: len(air.heard) == len(sent))
        assert [raw for _, raw in air.heard] == sent
        assert air.mesh.stats.up - before < len(sent), "several frames went in one payload"


@on_every_loop
async def test_an_emergency_overtakes_what_waits_for_all_nodes(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host, 2, rf_kbps=10.0) as (link, air):
        await until(lambda: len(link.channels) == 2 and link.modem.state == "open")
        for n in range(30):
            channel_of(link, air, 0).send(text(255, n, "x" * 40), Priority.FORWARDED)
        urgent = text(255, 200, "stop")
        channel_of(link, air, 1).send(urgent, Priority.EMERGENCY)
        await until(lambda: (1, urgent) in air.heard)
        assert sum(n == 0 for n, _ in air.heard) <= 15, "at most the window went before it"


@on_every_loop
async def test_after_a_standstill_nothing_that_the_module_has_not_taken_is_sent(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host, 2, keys={"broadcast": True}, rf_kbps=10.0) as (link, air):
        await until(lambda: len(link.channels) == 2 and link.modem.state == "open")
        channel = channel_of(link, air, 0)
        while link.modem.has_room():  # so that nothing more can go, whole or in part
            channel.send(text(255, 1, "x" * 40), Priority.FORWARDED)
        last = [text(255, n, f"of before {n}") for n in range(3)]
        for raw in last:
            channel.send(raw, Priority.COMMAND)
        assert channel.send(own("HEARTBEAT"), Priority.HEARTBEAT)
        channel._unsent = long_frame()  # the rest of a payload that was too short for it
        for each_of in link.channels:
            each_of.drop_waiting()
        assert channel.urgency is None and not link._to_all
        now = text(255, 200, "of now")
        channel.send(now, Priority.COMMAND)
        await until(lambda: (0, now) in air.heard)
        heard = [raw for _, raw in air.heard]
        assert not set(heard) & {*last, long_frame()}
        assert not any(raw[7:10] == b"\0\0\0" for raw in heard)  # no heartbeat


@on_every_loop
async def test_heartbeats_to_all_go_once_if_asked_for(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host, 3, keys={"broadcast": True}) as (link, air):
        await until(lambda: len(link.channels) == 3 and link.modem.state == "open")
        beat, order = own(), own("COMMAND_LONG", target_system=1, command=400)
        for channel in link.channels:
            assert channel.send(beat, Priority.HEARTBEAT)
        await until(lambda: len(air.heard) == 3)
        assert air.mesh.stats.broadcasts == 1 and len({raw for _, raw in air.heard}) == 1
        assert channel_of(link, air, 0).send(order, Priority.COMMAND)
        await until(lambda: len(air.heard) == 4)
        assert air.mesh.stats.broadcasts == 1 and air.heard[-1][0] == 0


@on_every_loop
async def test_only_listed_nodes_count_and_no_more_than_allowed(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host, 3, keys={"nodes": ("0013a20041000002",)}) as (link, _):
        await until(lambda: link.counters()["refused_packets"] > 5)
        assert [c.peer for c in link.channels] == ["0013A20041000002"]
    async with opened(radio, host, 3, keys={"max_nodes": 2}) as (link, _):
        await until(lambda: link.counters()["refused_packets"] > 5)
        assert len(link.channels) == 2
        assert [e.text for e in host.events].count(
            "link mesh: 2 nodes are heard, further ones are refused (max_nodes)"
        ) == 1


@on_every_loop
async def test_neither_strangers_nor_a_module_that_restarts_on_and_on_take_what_a_vehicle_needs(
    radio: PtyRadio,
) -> None:
    def frames(*contents: bytes) -> bytes:
        return b"".join(encode(content, escaped=True) for content in contents)

    def packet(address: int) -> bytes:
        return b"\x90" + address.to_bytes(8, "big") + b"\xff\xfe\x01" + text(1, 1, "here")

    vehicle = 0x0013A20041000002
    keys = {"device": str(radio.path), "rtscts": False, "nodes": (format_xbee_address(vehicle),)}
    link = XBeeLink(models.XBeeLinkConfig(name="mesh", **keys), RecordingHost(), asyncio.get_running_loop())
    await link.open()
    try:
        sent = frames(*map(packet, range(1, 200)), *[b"\x8a\x00"] * 5000, packet(vehicle))
        while sent:  # nothing that the link writes is read: the port is full soon
            sent = sent[radio.write(sent[:200]) :]
            await asyncio.sleep(0)
        await until(lambda: link.channels)
        assert len(link._unwritten) <= MAX_UNWRITTEN_BYTES
        assert list(link.modem.nodes) == [vehicle] and link.modem.nodes[vehicle].rx_packets == 1
    finally:
        await link.close()


@on_every_loop
async def test_a_silent_node_stops_being_a_channel_and_comes_back(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host, 2, keys={"node_timeout_s": 1.0}) as (link, air):
        await until(lambda: len(link.channels) == 2)
        air.mesh.unplugged.add(0)
        await until(lambda: len(link.channels) == 1)
        assert "nothing heard" in host.detached[-1][1]
        air.mesh.unplugged.clear()
        await until(lambda: len(link.channels) == 2)


@on_every_loop
async def test_the_last_way_to_a_vehicle_in_the_air_stays_although_it_is_silent(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host, 2, keys={"node_timeout_s": 1.0}) as (link, air):
        await until(lambda: len(link.channels) == 2 and link.modem.state == "open")
        flying = channel_of(link, air, 0)
        host.flying = {flying}
        for channel in link.channels:
            channel.last_rx_at -= 2.0  # as if it had been silent for that long
        link._look_for_silent()
        assert link.channels == [flying] and len(host.detached) == 1
        stop = text(255, 1, "stop")
        assert flying.send(stop, Priority.EMERGENCY)
        await until(lambda: (0, stop) in air.heard)
        air.mesh.unplugged.add(0)
        host.flying = set()
        await until(lambda: flying not in link.channels)


@on_every_loop
async def test_a_module_that_restarts_is_asked_again(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host, 1) as (link, air):
        await until(lambda: link.channels and link.modem.state == "open")
        air.mesh.restart()
        await until(lambda: link.modem.counters.restarts == 1 and link.modem.state == "open")
        raw = text(255, 1, "after")
        channel_of(link, air, 0).send(raw, Priority.COMMAND)
        await until(lambda: (0, raw) in air.heard)


@on_every_loop
async def test_a_silent_module_is_reported_once_and_a_pulled_one_fails_the_link(radio: PtyRadio) -> None:
    host = RecordingHost()
    before = open_descriptors()
    link = XBeeLink(models.XBeeLinkConfig(name="mesh", device=str(radio.path)), host, asyncio.get_running_loop())
    await link.open()
    await until(lambda: host.events)
    assert "no module answers in API mode (AP=2)" in host.events[0].text
    radio.pull_out()
    assert "unplugged" in await link.failed
    await link.close()
    assert open_descriptors() - before == set()
    with pytest.raises(LinkError, match="no such device"):
        await link.open()


@on_every_loop
async def test_noise_makes_no_channel_and_hides_nothing(radio: PtyRadio) -> None:
    host = RecordingHost()
    async with opened(radio, host, 1) as (link, air):
        radio.write(bytes(range(256)) * 8)
        await until(lambda: link.channels and link.channels[0].parser.stats.good > 3)
        assert [c.peer for c in link.channels] == [f"{air.mesh.address(0):016X}"]


def own_bytes(seq: int) -> bytes:
    return own().encode(seq, 2)


def long_frame() -> bytes:
    (frame,) = frames_in(own("GPS_RTCM_DATA", len=180, data=[1 + n % 255 for n in range(180)]).encode(5, 2))
    return frame.raw
