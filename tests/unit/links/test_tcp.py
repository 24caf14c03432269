"""TCP links over loopback."""

from __future__ import annotations

import asyncio
import os
import resource
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from skygcs.config import models
from skygcs.core.radio_link.transmit_queue import BOUND, Priority
from skygcs.errors import LinkError
from skygcs.events import Event
from skygcs.links.base import LinkSupervisor
from skygcs.links.stream import OLD, READ_BYTES
from skygcs.links.tcp import TcpClientLink, TcpServerLink
from support.hosts import RecordingHost, frames_in, heartbeat, open_descriptors, own, text, until
from support.loops import on_every_loop
from support.process import free_port


@asynccontextmanager
async def serving(hub: RecordingHost, **keys: Any) -> AsyncIterator[TcpServerLink]:
    config = models.TcpServerLinkConfig(name="gcs", **{"host": "127.0.0.1", "port": 0, **keys})
    link = TcpServerLink(config, hub, asyncio.get_running_loop())
    await link.open()
    try:
        yield link
    finally:
        await link.close()


def connect(link: TcpServerLink) -> socket.socket:
    """A client; loopback connects at once, accepted or not."""
    sock = socket.create_connection(("127.0.0.1", link.bound_port))
    sock.setblocking(False)
    return sock


def drain(sock: socket.socket) -> bytes:
    got = b""
    try:
        while data := sock.recv(65536):
            got += data
    except BlockingIOError:
        pass
    return got


def at_end(sock: socket.socket) -> bool:
    try:
        return sock.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionResetError:
        return True


def reset(sock: socket.socket) -> None:
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    sock.close()


@on_every_loop
async def test_each_client_is_a_channel_of_its_own() -> None:
    host = RecordingHost()
    async with serving(host) as link:
        clients = [connect(link) for _ in range(5)]
        for number, sock in enumerate(clients):
            sock.send(heartbeat(number + 1))
        await until(lambda: len(host.heard) == 5)
        for channel, frame in host.heard:
            assert channel.send(text(255, 0, f"for {frame.sysid}"))
        for number, sock in enumerate(clients):
            assert drain(sock) == text(255, 0, f"for {number + 1}")
            assert any(c.peer == f"127.0.0.1:{sock.getsockname()[1]}" for c in link.channels)
            sock.close()
        await until(lambda: len(host.detached) == 5)
        assert all(reason == "the other end closed it" for _, reason in host.detached)
        assert link.channels == [] and not link.failed.done()


@on_every_loop
async def test_a_frame_arriving_byte_by_byte_is_one_frame() -> None:
    host = RecordingHost()
    async with serving(host) as link:
        with connect(link) as sock:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for byte in heartbeat(1) + text(1, 1, "slow"):
                sock.send(bytes((byte,)))
                await asyncio.sleep(0)
            await until(lambda: len(host.heard) == 2)
    assert host.raws == [heartbeat(1), text(1, 1, "slow")]


@on_every_loop
async def test_a_reset_behind_more_data_than_one_read_takes_is_noticed() -> None:
    """uvloop would stop watching at the first EPOLLERR and never tell of the rest."""
    host = RecordingHost()
    async with serving(host) as link:
        sock = connect(link)
        await until(lambda: link.channels)
        data = heartbeat(1) * (3 * READ_BYTES // len(heartbeat(1)))
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * len(data))
        sock.send(data)
        reset(sock)
        await until(lambda: host.detached)
        assert link.channels == [] and not link.failed.done()
        with connect(link) as another:
            another.send(heartbeat(2))
            await until(lambda: host.raws[-1:] == [heartbeat(2)])


@on_every_loop
async def test_a_client_that_does_not_read_loses_whole_frames_and_disturbs_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # On a loaded machine it takes nothing for longer than a client may.
    monkeypatch.setattr("skygcs.links.tcp.STUCK_AFTER_S", 3600.0)
    host = RecordingHost()
    async with serving(host) as link:
        slow = connect(link)
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
        await until(lambda: len(link.channels) == 1)
        fast = connect(link)
        await until(lambda: len(link.channels) == 2)
        to_slow, to_fast = host.channels
        frames = [text(n % 250 + 1, n % 256, f"number {n} " + "y" * 30) for n in range(64 * 600)]
        got_fast = bytearray()
        size = 0
        for n, frame in enumerate(frames):
            to_slow.send(frame)
            assert to_fast.send(frame)
            size += len(frame)
            while n % 64 == 63 and len(got_fast) < size:
                await asyncio.sleep(0)
                got_fast += drain(fast)
        waiting = to_slow.counters()["tx_waiting"]
        assert to_slow.tx_dropped > 0 and 0 < waiting <= BOUND[Priority.FORWARDED]
        assert to_slow.send(own(), Priority.EMERGENCY)
        got_slow = bytearray()
        while to_slow.tx_frames + to_slow.tx_dropped < len(frames) + 1 or len(got_slow) < to_slow.tx_bytes:
            await asyncio.sleep(0)
            got_slow += drain(slow)
        slow.close()
        fast.close()
    assert got_fast == b"".join(frames)
    received = frames_in(bytes(got_slow))
    assert sum(len(frame.raw) for frame in received) == len(got_slow), "only whole frames came"
    assert len(received) == len(frames) + 1 - to_slow.tx_dropped
    assert [frame.sysid for frame in received].index(255) == len(received) - waiting - 1


@on_every_loop
async def test_a_client_that_takes_nothing_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skygcs.links.tcp.STUCK_AFTER_S", 0.3)
    host = RecordingHost()
    async with serving(host) as link:
        stuck = connect(link)
        await until(lambda: link.channels)
        reading = connect(link)
        await until(lambda: len(link.channels) == 2)
        while len(host.channels) == 2:
            for channel in host.channels:
                channel.send(text(1, 0, "z" * 50))
            drain(reading)
            await asyncio.sleep(0)
        assert [reason for _, reason in host.detached] == ["the other end took nothing for 0.3 s"]
        assert host.channels[0].send(heartbeat(1))
        await until(lambda: drain(reading).endswith(heartbeat(1)))
        assert not link.failed.done()
        stuck.close()
        reading.close()


@on_every_loop
async def test_connections_of_before_a_standstill_end_with_the_last_of_what_had_waited() -> None:
    host = RecordingHost()
    seen = list[bool]()
    async with serving(host) as link:
        silent, talks = connect(link), connect(link)
        await until(lambda: len(link.channels) == 2)
        host.on_frame = lambda channel, _: seen.append(channel in host.reading.stale)
        talks.sendall(heartbeat(1) * 1000)
        early = connect(link)
        early.sendall(heartbeat(2))
        host.reading.woke()
        for channel in link.channels:
            channel.drop_waiting()
        await until(lambda: not link.channels)
        await until(lambda: all(at_end(sock) for sock in (silent, talks, early)))
        assert seen == [True] * 1000 and {why for _, why in host.detached} == {OLD}
        anew = connect(link)
        anew.sendall(heartbeat(3))
        await until(lambda: len(host.heard) == 1001)
        assert seen[-1] is False and not host.reading.stale
        for sock in (silent, talks, early, anew):
            sock.close()


@on_every_loop
async def test_one_client_too_many_is_turned_away() -> None:
    host = RecordingHost()
    async with serving(host, max_clients=2) as link:
        first, second = connect(link), connect(link)
        await until(lambda: len(link.channels) == 2)
        third = connect(link)
        await until(lambda: at_end(third))
        assert link.counters() == {"clients_refused": 1, "clients_put_out": 0, "not_allowed": 0}
        first.close()
        await until(lambda: len(link.channels) == 1)
        with connect(link) as fourth:
            fourth.send(heartbeat(4))
            await until(lambda: host.raws == [heartbeat(4)])
        second.close()
        third.close()


@on_every_loop
async def test_running_out_of_descriptors_pauses_accepting_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skygcs.links.tcp.ACCEPT_AGAIN_S", 0.05)
    host = RecordingHost()
    async with serving(host) as link:
        early = connect(link)
        await until(lambda: len(link.channels) == 1)
        late = connect(link)
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        free = os.dup(0)
        os.close(free)
        resource.setrlimit(resource.RLIMIT_NOFILE, (free, hard))
        try:
            await until(lambda: link._again is not None)
            early.send(heartbeat(1))
            await until(lambda: host.raws == [heartbeat(1)])
            assert len(link.channels) == 1
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        late.send(heartbeat(2))
        await until(lambda: host.raws == [heartbeat(1), heartbeat(2)])
        assert not link.failed.done()
        early.close()
        late.close()


@on_every_loop
async def test_a_server_on_a_name_takes_clients_on_every_address_of_it() -> None:
    port = free_port(socket.SOCK_STREAM)
    host = RecordingHost()
    async with serving(host, host="localhost", port=port):
        socket.create_connection(("127.0.0.1", port)).close()
        await until(lambda: len(host.detached) == 1)
    async with serving(host, host="::", port=port):
        socket.create_connection(("127.0.0.1", port)).close()
        await until(lambda: len(host.detached) == 2)
        socket.create_connection(("::1", port)).close()
        await until(lambda: len(host.detached) == 3)
    peers = [channel.peer for channel, _ in host.detached]
    assert peers[1].startswith("127.0.0.1:") and peers[2].startswith("[::1]:")


@on_every_loop
async def test_a_port_in_use_is_an_error_that_says_so_and_leaves_nothing_open() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        before = open_descriptors()
        with pytest.raises(LinkError, match=r"tcp_server 127.0.0.1:\d+: port \d+ is in use by another program"):
            async with serving(RecordingHost(), port=other.getsockname()[1]):
                pass
        assert open_descriptors() == before


@on_every_loop
async def test_closing_the_server_ends_its_clients_and_frees_everything() -> None:
    host = RecordingHost()
    before = open_descriptors()
    async with serving(host) as link:
        sock = connect(link)
        await until(lambda: link.channels)
        await link.close()
        await until(lambda: at_end(sock))
        assert host.detached[0][1] == "closed"
        sock.close()
        await link.close()
        await link.open()
        connect(link).close()
        await until(lambda: len(host.detached) == 2)
    assert open_descriptors() == before


def client(hub: RecordingHost, port: int, host: str = "127.0.0.1") -> TcpClientLink:
    config = models.TcpClientLinkConfig(name="sim", host=host, port=port)
    return TcpClientLink(config, hub, asyncio.get_running_loop())


@on_every_loop
async def test_a_client_connects_talks_and_fails_when_the_server_goes() -> None:
    host = RecordingHost()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        link = client(host, listener.getsockname()[1], "localhost")
        await link.open()
        sock, _ = listener.accept()
        sock.send(heartbeat(1))
        await until(lambda: host.raws == [heartbeat(1)])
        assert link.channels[0].send(heartbeat(255))
        assert sock.recv(100) == heartbeat(255)
        reset(sock)
        reason = await asyncio.wait_for(link.failed, 10)
        assert reason.startswith("tcp_client localhost:")
        await link.close()
        assert host.detached[0][1] == reason


@on_every_loop
async def test_a_refused_connection_says_that_nobody_listens_and_leaves_nothing_open() -> None:
    port = free_port(socket.SOCK_STREAM)
    link = client(RecordingHost(), port)
    before = open_descriptors()
    with pytest.raises(LinkError, match=rf"tcp_client 127.0.0.1:{port}: connection refused: no program listens there"):
        await link.open()
    assert open_descriptors() == before


@asynccontextmanager
async def silent_server() -> AsyncIterator[int]:
    """A port that neither takes nor refuses: its backlog is full, so that the kernel lets further calls wait."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        callers = []
        for _ in range(3):
            caller = socket.socket()
            caller.setblocking(False)
            caller.connect_ex(listener.getsockname())
            callers.append(caller)
        await asyncio.sleep(0.01)
        yield listener.getsockname()[1]
        for caller in callers:
            caller.close()


@on_every_loop
async def test_a_connection_that_is_not_answered_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skygcs.links.tcp.CONNECT_TIMEOUT_S", 0.1)
    async with silent_server() as port:
        before = open_descriptors()
        with pytest.raises(LinkError, match=r"no answer within 0\.1 s"):
            await client(RecordingHost(), port).open()
        assert open_descriptors() == before


@on_every_loop
async def test_cancelling_or_closing_while_connecting_leaves_nothing_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skygcs.links.tcp.CONNECT_TIMEOUT_S", 0.2)
    async with silent_server() as port:
        before = open_descriptors()
        link = client(RecordingHost(), port)
        opening = asyncio.ensure_future(link.open())
        await asyncio.sleep(0.02)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        assert open_descriptors() == before
        opening = asyncio.ensure_future(link.open())
        await asyncio.sleep(0.02)
        await link.close()
        with pytest.raises(LinkError):
            await opening
        assert open_descriptors() == before


@on_every_loop
async def test_a_connection_made_just_after_close_is_dropped() -> None:
    loop = asyncio.get_running_loop()
    late = loop.create_future()

    class LateConnect:
        def __getattr__(self, name: str) -> Any:
            return getattr(loop, name)

        async def sock_connect(self, sock: socket.socket, address: Any) -> None:
            await loop.sock_connect(sock, address)
            await late

    with socket.create_server(("127.0.0.1", 0)) as listener:
        host = RecordingHost()
        link = client(host, listener.getsockname()[1])
        link.loop = LateConnect()  # type: ignore[assignment]  # a loop but for the connecting
        before = open_descriptors()
        opening = asyncio.ensure_future(link.open())
        await asyncio.sleep(0.02)
        await link.close()
        late.set_result(None)
        with pytest.raises(LinkError, match="closed while it was being opened"):
            await opening
        assert open_descriptors() == before and host.channels == []


@on_every_loop
async def test_the_supervisor_connects_again_when_the_server_is_back() -> None:
    host = RecordingHost()
    events: list[Event] = []
    port = free_port(socket.SOCK_STREAM)
    with socket.create_server(("127.0.0.1", port)) as listener:
        link = client(host, port)
        task = asyncio.ensure_future(LinkSupervisor(link, events.append).run())
        await until(lambda: link.channels)
        sock, _ = listener.accept()
        reset(sock)
        await until(lambda: events[-1].kind == "link_down")
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", port))
        listener.listen()
        await until(lambda: link.channels)
        sock, _ = listener.accept()
        sock.send(heartbeat(1))
        await until(lambda: host.raws == [heartbeat(1)])
        sock.close()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert [event.kind for event in events[:3]] == ["link_up", "link_down", "link_up"]
    assert host.channels == []
