"""UDP links over loopback sockets."""

from __future__ import annotations

import asyncio
import errno
import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest

from skygcs.config import models
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.errors import LinkError
from skygcs.links.reading import LARGEST_DATAGRAM_BYTES, TURN_BYTES
from skygcs.links.udp import UdpBroadcastLink, UdpClientLink, UdpServerLink
from support.hosts import RecordingHost, drained, heartbeat, open_descriptors, own, text, until
from support.loops import on_every_loop
from support.process import free_port


@contextmanager
def peer(address: tuple[str, int] = ("127.0.0.1", 0), family: int = socket.AF_INET) -> Iterator[socket.socket]:
    with socket.socket(family, socket.SOCK_DGRAM) as sock:
        sock.bind(address)
        sock.setblocking(False)
        yield sock


async def server(hub: RecordingHost, **keys: Any) -> UdpServerLink:
    config = models.UdpServerLinkConfig(name="net", **{"host": "127.0.0.1", "port": 0, **keys})
    link = UdpServerLink(config, hub, asyncio.get_running_loop())
    await link.open()
    return link


@on_every_loop
async def test_twenty_peers_on_one_port_each_get_only_their_own() -> None:
    host = RecordingHost()
    link = await server(host)
    socks = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(20)]
    try:
        for number, sock in enumerate(socks):
            sock.setblocking(False)
            sock.sendto(heartbeat(number + 1), ("127.0.0.1", link.bound_port))
        await until(lambda: len(host.heard) == 20)
        assert len(link.channels) == 20
        for channel, frame in host.heard:
            assert channel.send(text(255, 0, f"for {frame.sysid}"))
        await until(lambda: all(c.tx_frames == 1 for c in link.channels))
        for number, sock in enumerate(socks):
            assert drained(sock) == [text(255, 0, f"for {number + 1}")]
    finally:
        for sock in socks:
            sock.close()
        await link.close()
    assert len(host.detached) == 20
    assert link.channels == []


@on_every_loop
async def test_a_truncated_datagram_does_not_eat_the_next_one_of_anybody() -> None:
    host = RecordingHost()
    link = await server(host)
    to = ("127.0.0.1", link.bound_port)
    with peer() as one, peer() as two:
        one.sendto(heartbeat(1), to)
        two.sendto(heartbeat(2), to)
        one.sendto(text(1, 1, "cut off in the middle of it")[:-9], to)
        one.sendto(heartbeat(1, 2), to)
        two.sendto(heartbeat(2, 1), to)
        await until(lambda: len(host.heard) == 4)
    assert host.raws == [heartbeat(1), heartbeat(2), heartbeat(1, 2), heartbeat(2, 1)]
    await link.close()


@on_every_loop
async def test_all_frames_of_the_largest_datagram_come_in_order_and_a_larger_one_is_dropped() -> None:
    host = RecordingHost()
    link = await server(host)
    frames = [heartbeat(1, n % 256) for n in range(LARGEST_DATAGRAM_BYTES // len(heartbeat(1)))]
    with peer() as one:
        to = ("127.0.0.1", link.bound_port)
        for size in (LARGEST_DATAGRAM_BYTES + 1, 65_507):
            one.sendto((heartbeat(2) * 4000)[:size], to)
        one.sendto(b"".join(frames), to)
        await until(lambda: len(host.heard) >= len(frames))
    assert host.raws == frames
    assert link.counters()["too_large_datagrams"] == 2
    await link.close()


@on_every_loop
async def test_a_storm_of_garbage_takes_a_bounded_part_of_each_wake_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a peer, of strangers, in datagrams of any size; frames between it are heard all the same."""
    host = RecordingHost()
    link = await server(host)
    to = ("127.0.0.1", link.bound_port)
    searched: list[list[int]] = []
    feed = FrameParser.feed_datagram

    def counted(parser: FrameParser, data: bytes, *, search: bool = True) -> list[Frame]:
        if search:
            searched[-1].append(len(data))
        return feed(parser, data, search=search)

    monkeypatch.setattr(FrameParser, "feed_datagram", counted)
    with peer() as known, peer() as other:
        searched.append([])
        known.sendto(heartbeat(1), to)
        await asyncio.sleep(0)
        link._on_readable()
        for number in range(60):
            for sender in (known, other):
                sender.sendto(bytes((0xFD,)) * (65_000, 12_000, 1_000)[number % 3], to)
            known.sendto(heartbeat(1, number + 1), to)
            if number % 10 == 9:
                searched.append([])
                link._on_readable()
        await until(lambda: len(host.heard) == 61)
    assert max(sum(sizes) for sizes in searched) <= TURN_BYTES + LARGEST_DATAGRAM_BYTES
    assert sum(sum(sizes) for sizes in searched) < 100_000  # of 1,560,000 that are not too large
    assert link.counters()["parked_datagrams"] > 30
    assert [event.kind for event in host.events] == ["warning"]
    await link.close()


@on_every_loop
async def test_noise_makes_no_peer_and_a_good_frame_among_it_does() -> None:
    host = RecordingHost()
    link = await server(host)
    noise = random.Random(7)
    to = ("127.0.0.1", link.bound_port)
    with peer() as one:
        for _ in range(30):
            one.sendto(noise.randbytes(400), to)
        unknown = bytes((0xFD, 1, 0, 0, 0, 1, 1, 0xFF, 0xFF, 0xEE, 5, 1, 2))  # no CRC can vouch for an unknown id
        one.sendto(unknown, to)
        await until(lambda: link.counters()["ignored_datagrams"] == 31)
        assert host.channels == []
        assert host.heard == []
        one.sendto(noise.randbytes(50) + heartbeat(3) + b"\xfd", to)
        await until(lambda: host.heard)
    assert host.raws == [heartbeat(3)]
    assert len(link.channels) == 1
    await link.close()


@on_every_loop
async def test_a_good_frame_of_one_address_does_not_vouch_for_another_address() -> None:
    host = RecordingHost()
    link = await server(host)
    to = ("127.0.0.1", link.bound_port)
    unknown = bytes((0xFD, 1, 0, 0, 0, 7, 1, 0xFF, 0xFF, 0xEE, 5, 1, 2))
    with peer() as one, peer() as two:
        one.sendto(heartbeat(7), to)
        two.sendto(unknown, to)
        one.sendto(unknown, to)
        await until(lambda: len(host.heard) == 2)
        assert host.raws == [heartbeat(7), unknown]
        assert len(link.channels) == 1
    await link.close()


@on_every_loop
async def test_a_silent_peer_expires_and_one_that_talks_stays() -> None:
    host = RecordingHost()
    link = await server(host, peer_timeout_s=0.3)
    to = ("127.0.0.1", link.bound_port)
    with peer() as silent, peer() as talking:
        silent.sendto(heartbeat(1), to)
        talking.sendto(heartbeat(2), to)
        await until(lambda: len(host.channels) == 2)
        while len(host.channels) == 2:
            talking.sendto(heartbeat(2), to)
            silent.sendto(b"noise is no sign of life", to)
            await asyncio.sleep(0.02)
        assert [channel.peer for channel, _ in host.detached] == [f"127.0.0.1:{silent.getsockname()[1]}"]
        assert [channel.peer for channel in link.channels] == [f"127.0.0.1:{talking.getsockname()[1]}"]
        silent.sendto(heartbeat(1), to)
        await until(lambda: len(host.channels) == 2)
    await until(lambda: not host.channels)
    assert link.counters()["peers_expired"] == 3
    await link.close()


@on_every_loop
async def test_the_last_way_to_a_vehicle_in_the_air_stays_although_it_is_silent() -> None:
    host = RecordingHost()
    link = await server(host, peer_timeout_s=0.1)
    to = ("127.0.0.1", link.bound_port)
    with peer() as flying, peer() as other:
        flying.sendto(heartbeat(1), to)
        await until(lambda: len(host.channels) == 1)
        host.flying = {host.channels[0]}
        other.sendto(heartbeat(2), to)
        await until(lambda: len(host.detached) == 1)
        assert host.detached[0][0].peer == f"127.0.0.1:{other.getsockname()[1]}"
        host.channels[0].send(heartbeat(255))
        await until(lambda: drained(flying))
        host.flying = set()
        await until(lambda: not host.channels)
    await link.close()


@on_every_loop
async def test_a_full_table_refuses_and_takes_the_place_of_an_expired_peer() -> None:
    host = RecordingHost()
    link = await server(host, max_peers=2, peer_timeout_s=1000.0)
    to = ("127.0.0.1", link.bound_port)
    with peer() as one, peer() as two, peer() as three:
        one.sendto(heartbeat(1), to)
        two.sendto(heartbeat(2), to)
        three.sendto(heartbeat(3), to)
        await until(lambda: link.counters()["peers_refused"] == 1)
        assert [frame.sysid for _, frame in host.heard] == [1, 2]
        host.channels[0].last_rx_at -= 2000.0  # as if it had been silent for that long
        link._none_expires_before = 0.0
        three.sendto(heartbeat(3), to)
        await until(lambda: len(host.heard) == 3)
        assert [channel.id for channel in link.channels] == [2, 3]
        assert [channel.id for channel, _ in host.detached] == [1]
    await link.close()


@on_every_loop
async def test_a_failed_send_is_counted_and_breaks_nothing() -> None:
    host = RecordingHost()
    link = await server(host)
    with peer() as one:
        one.sendto(heartbeat(1), ("127.0.0.1", link.bound_port))
        await until(lambda: host.heard)
        channel = host.channels[0]

        def full(raw: bytes, address: object) -> int:
            raise OSError(errno.ENOBUFS, "No buffer space available")

        really, channel._sendto = channel._sendto, full
        assert channel.send(heartbeat(255)) is False
        channel._sendto = really
        assert channel.send(heartbeat(255, 1)) is True
        await until(lambda: drained(one) == [heartbeat(255, 1)])
        assert (channel.tx_dropped, channel.tx_frames) == (1, 1)
        assert not link.failed.done()
    await link.close()
    assert channel.send(heartbeat(255)) is False


@on_every_loop
async def test_own_messages_count_their_sequence_per_channel_and_are_recorded() -> None:
    host = RecordingHost()
    link = await server(host)
    with peer() as one, peer() as two:
        for sock in (one, two):
            sock.sendto(heartbeat(1), ("127.0.0.1", link.bound_port))
        await until(lambda: len(link.channels) == 2)
        message = own()
        first, second = link.channels
        assert first.send(message) and first.send(message) and second.send(message)
        got: list[bytes] = []
        await until(lambda: got.extend(drained(one)) or len(got) == 2)
        assert [raw[4] for raw in got] == [0, 1]
        await until(lambda: [raw[4] for raw in drained(two)] == [0])
        assert [(channel.id, raw[4]) for channel, _, raw in host.sent] == [(1, 0), (1, 1), (2, 0)]
    await link.close()


@on_every_loop
async def test_a_port_in_use_is_an_error_that_says_so_and_leaves_nothing_open() -> None:
    host = RecordingHost()
    with peer() as other:
        await asyncio.sleep(0)
        before = open_descriptors()
        with pytest.raises(LinkError, match=r"udp_server 127.0.0.1:\d+: port \d+ is in use by another program"):
            await server(host, port=other.getsockname()[1])
        assert open_descriptors() == before


@on_every_loop
async def test_a_host_name_and_ipv6_are_listened_on() -> None:
    host = RecordingHost()
    named = await server(host, host="localhost")
    sixth = await server(host, host="::1")
    with peer() as four, peer(("::1", 0), socket.AF_INET6) as six:
        four.sendto(heartbeat(4), ("127.0.0.1", named.bound_port))
        six.sendto(heartbeat(6), ("::1", sixth.bound_port))
        await until(lambda: len(host.heard) == 2)
        assert sixth.channels[0].peer == f"[::1]:{six.getsockname()[1]}"
        assert sixth.channels[0].send(heartbeat(255))
        await until(lambda: drained(six) == [heartbeat(255)])
    await named.close()
    await sixth.close()


@on_every_loop
async def test_an_address_this_machine_does_not_have_is_explained() -> None:
    with pytest.raises(LinkError, match=r"this machine has no address 192\.0\.2\.1"):
        await server(RecordingHost(), host="192.0.2.1")


@on_every_loop
async def test_a_name_that_does_not_resolve_is_a_link_error() -> None:
    for name in ("no-such-host.invalid", "a" * 70 + ".invalid", "two..dots"):
        with pytest.raises(LinkError, match=r"udp_client .*the name has no address"):
            await client(RecordingHost(), 14550, host=name)


async def client(hub: RecordingHost, port: int, **keys: Any) -> UdpClientLink:
    config = models.UdpClientLinkConfig(name="gcs", port=port, **{"host": "127.0.0.1", **keys})
    link = UdpClientLink(config, hub, asyncio.get_running_loop())
    await link.open()
    return link


@on_every_loop
async def test_a_client_outlives_a_peer_that_is_not_there_yet() -> None:
    host = RecordingHost()
    port = free_port()
    link = await client(host, port)
    channel = host.channels[0]
    assert channel.peer == f"127.0.0.1:{port}"
    for _ in range(5):
        channel.send(heartbeat(255))
        await asyncio.sleep(0.01)  # the kernel tells the sender that nobody was there
    with peer(("127.0.0.1", port)) as there:
        assert channel.send(heartbeat(255, 9))
        await until(lambda: drained(there) == [heartbeat(255, 9)])
        there.sendto(heartbeat(1), ("127.0.0.1", link.bound_port))
        await until(lambda: host.raws == [heartbeat(1)])
    assert not link.failed.done()
    await link.close()


@on_every_loop
async def test_a_client_hears_its_peer_only() -> None:
    host = RecordingHost()
    with peer() as right, peer() as wrong:
        link = await client(host, right.getsockname()[1], host="localhost")
        wrong.sendto(heartbeat(2), ("127.0.0.1", link.bound_port))
        right.sendto(heartbeat(1), ("127.0.0.1", link.bound_port))
        await until(lambda: host.heard)
        assert host.raws == [heartbeat(1)]
        assert link.counters()["ignored_datagrams"] == 1
    await link.close()


@on_every_loop
async def test_closing_while_the_name_is_looked_up_leaves_nothing_open() -> None:
    loop = asyncio.get_running_loop()
    host = RecordingHost()
    config = models.UdpClientLinkConfig(name="gcs", host="gcs.invalid", port=14550)
    link = UdpClientLink(config, host, loop)
    answer = loop.create_future()

    class SlowNames:
        def __getattr__(self, name: str) -> Any:
            return getattr(loop, name)

        async def getaddrinfo(self, *_: Any, **__: Any) -> Any:
            return await answer

    link.loop = SlowNames()  # type: ignore[assignment]  # a loop but for the look-up
    before = open_descriptors()
    opening = asyncio.ensure_future(link.open())
    await asyncio.sleep(0)
    await link.close()
    answer.set_result([(socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("127.0.0.1", 14550))])
    with pytest.raises(LinkError, match="closed while"):
        await opening
    assert open_descriptors() == before
    assert host.channels == []
    await link.close()


@on_every_loop
async def test_a_broadcaster_locks_onto_who_answers_and_lets_go_after_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skygcs.links.udp.BROADCAST_AGAIN_S", 0.2)
    host = RecordingHost()
    with peer(("127.255.255.255", 0)) as ear, peer() as vehicle, peer() as other:
        config = models.UdpBroadcastLinkConfig(name="all", host="127.255.255.255", port=ear.getsockname()[1])
        link = UdpBroadcastLink(config, host, asyncio.get_running_loop())
        await link.open()
        channel = host.channels[0]
        assert channel.send(heartbeat(255))
        await until(lambda: drained(ear) == [heartbeat(255)])
        other.sendto(b"no frame, no lock", ("127.0.0.1", link.bound_port))
        vehicle.sendto(heartbeat(1), ("127.0.0.1", link.bound_port))
        await until(lambda: host.heard)
        assert channel.peer == f"127.0.0.1:{vehicle.getsockname()[1]}"
        assert channel.send(heartbeat(255, 1))
        await until(lambda: drained(vehicle) == [heartbeat(255, 1)])
        other.sendto(heartbeat(2), ("127.0.0.1", link.bound_port))
        await until(lambda: link.counters()["ignored_datagrams"] == 2)
        assert drained(ear) == [] and host.raws == [heartbeat(1)]
        await until(lambda: channel.peer.startswith("127.255.255.255"))
        assert channel.send(heartbeat(255, 2))
        await until(lambda: drained(ear) == [heartbeat(255, 2)])
        assert link.channels == [channel]
        await link.close()
        assert link.channels == [] and len(host.detached) == 1


@on_every_loop
async def test_a_broadcaster_does_not_lock_onto_itself() -> None:
    host = RecordingHost()
    port = free_port()
    config = models.UdpBroadcastLinkConfig(name="all", host="127.255.255.255", port=port, local_port=port)
    link = UdpBroadcastLink(config, host, asyncio.get_running_loop())
    await link.open()
    host.channels[0].send(heartbeat(255))
    await until(lambda: link.counters()["ignored_datagrams"] == 1)
    assert host.heard == []
    assert host.channels[0].peer == f"127.255.255.255:{port}"
    await link.close()


@on_every_loop
async def test_close_is_idempotent_and_a_link_opens_again() -> None:
    host = RecordingHost()
    link = await server(host)
    await link.close()
    before = open_descriptors()
    await link.close()
    await link.open()
    with peer() as one:
        one.sendto(heartbeat(1), ("127.0.0.1", link.bound_port))
        await until(lambda: host.heard)
    await link.close()
    assert open_descriptors() == before


@on_every_loop
async def test_a_link_closed_from_within_a_frame_stops_reading_at_once() -> None:
    host = RecordingHost()
    link = await server(host)

    def close_now(*_: object) -> None:
        with suppress(StopIteration):
            link.close().send(None)

    host.on_frame = close_now
    with peer() as one:
        for seq in range(3):
            one.sendto(heartbeat(1, seq), ("127.0.0.1", link.bound_port))
        await until(lambda: host.detached)
    assert host.raws == [heartbeat(1)]
    assert not link.failed.done()
