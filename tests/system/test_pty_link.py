"""A supervised serial link on a pty that is pulled out and plugged in again, beside a link that must not notice."""

from __future__ import annotations

import asyncio
import os
import random
import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from skygcs.config import models
from skygcs.events import Event
from skygcs.links.base import Link, LinkSupervisor
from skygcs.links.serial import SerialLink
from skygcs.links.udp import UdpServerLink
from support.hosts import RecordingHost, frames_in, heartbeat, open_descriptors, text, until
from support.loops import on_every_loop
from support.pseudo_tty import PtyRadio

pytestmark = pytest.mark.system


@pytest.fixture
def radio(tmp_path: Path) -> Iterator[PtyRadio]:
    radio = PtyRadio(tmp_path / "ttyRADIO")
    yield radio
    radio.pull_out()


@asynccontextmanager
async def supervised(link: Link, events: list[Event]) -> AsyncIterator[LinkSupervisor]:
    supervisor = LinkSupervisor(link, events.append)
    task = asyncio.ensure_future(supervisor.run())
    yield supervisor
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


def serial_link(hub: RecordingHost, radio: PtyRadio) -> SerialLink:
    config = models.SerialLinkConfig(name="radio", device=str(radio.path))
    return SerialLink(config, hub, asyncio.get_running_loop())


@on_every_loop
async def test_a_radio_pulled_out_and_plugged_in_again_is_back_and_nobody_else_noticed(radio: PtyRadio) -> None:
    hub = RecordingHost()
    events: list[Event] = []
    net = UdpServerLink(
        models.UdpServerLinkConfig(name="net", host="127.0.0.1", port=0), hub, asyncio.get_running_loop()
    )
    link = serial_link(hub, radio)
    async with supervised(net, []) as beside, supervised(link, events) as supervisor:
        await until(lambda: beside.state == "up" and supervisor.state == "down")
        assert "no such device" in events[0].text
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            for life in range(3):
                radio.plug_in()
                await until(lambda: supervisor.state == "up")
                radio.write(heartbeat(1, life))
                await until(lambda life=life: hub.raws.count(heartbeat(1, life)) == 1)
                assert link.channels[0].send(text(255, life, "hello"))
                hello = text(255, life, "hello")
                assert await radio.read_exactly(len(hello)) == hello
                radio.pull_out()
                sock.sendto(heartbeat(2, life), ("127.0.0.1", net.bound_port))
                await until(lambda: supervisor.state == "down")
                assert "unplugged" in (supervisor.last_error or "")
                await until(lambda life=life: hub.raws.count(heartbeat(2, life)) == 1)
        assert (beside.state, beside.opened, beside.failures) == ("up", 1, 0)
        assert supervisor.opened == 3
    assert [event.kind for event in events] == ["link_down"] + ["link_up", "link_down"] * 3
    assert hub.channels == []


@on_every_loop
async def test_a_noisy_radio_that_splits_repeats_and_loses_gives_exactly_what_came_whole(radio: PtyRadio) -> None:
    hub = RecordingHost()
    rng = random.Random(3)
    radio.plug_in()
    async with supervised(serial_link(hub, radio), []) as supervisor:
        await until(lambda: supervisor.state == "up")
        whole: list[bytes] = []
        stream = b""
        for n in range(800):
            frame = text(n % 5 + 1, n % 256, f"number {n}")
            if rng.random() < 0.3:
                stream += rng.randbytes(rng.randint(1, 40))
            if rng.random() < 0.1:
                stream += frame[: rng.randint(1, len(frame) - 1)]  # the rest was lost on the air
                continue
            copies = 2 if rng.random() < 0.1 else 1
            stream += copies * frame
            whole += [frame] * copies
        while stream:
            size = rng.choice((1, 1, 2, 7, 300))
            stream = stream[radio.write(stream[:size]) :]
            if rng.random() < 0.1:
                await asyncio.sleep(0)
        await until(lambda: len(hub.heard) >= len(whole))
        assert hub.raws == whole


@on_every_loop
async def test_a_radio_that_stalls_gets_only_whole_frames_when_it_reads_again(radio: PtyRadio) -> None:
    hub = RecordingHost()
    radio.plug_in()
    async with supervised(serial_link(hub, radio), []) as supervisor:
        await until(lambda: supervisor.state == "up")
        channel = hub.channels[0]
        got = b""
        for n in range(5000):
            channel.send(text(n % 250 + 1, n % 256, f"number {n}"))
            if n % 1000 == 999:  # it takes a little, then stalls again
                got += os.read(radio.fd, 1500)
                await asyncio.sleep(0.01)
        while channel.tx_frames + channel.tx_dropped < 5000:
            got += radio.read()
            await asyncio.sleep(0.001)
        got += await radio.read_exactly(channel.tx_bytes - len(got))
        assert channel.tx_dropped > 1000
        assert sum(len(frame.raw) for frame in frames_in(got)) == len(got) == channel.tx_bytes


@on_every_loop
async def test_a_supervisor_cancelled_at_any_moment_leaves_nothing_open(radio: PtyRadio) -> None:
    await asyncio.sleep(0)
    before = open_descriptors()
    for plugged in (False, True):
        if plugged:
            radio.plug_in()
            before = open_descriptors()
        for turns in range(4):
            async with supervised(serial_link(RecordingHost(), radio), []):
                for _ in range(turns):
                    await asyncio.sleep(0)
            assert open_descriptors() == before
