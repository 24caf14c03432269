"""Who becomes a peer of a server: allow_from, and a place among the others, over real sockets."""

from __future__ import annotations

import asyncio
import socket
from contextlib import ExitStack
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from skygcs.config import models
from skygcs.core.mavlink.frame import encode
from skygcs.core.routing.peer_places import PEER_SILENT_S
from skygcs.links.peers import MAX_REMEMBERED, MAX_REPORTED, AllowedNetworks
from skygcs.links.tcp import TcpServerLink
from skygcs.links.udp import UdpServerLink
from support.hosts import RecordingHost, common_dialect, heartbeat, until
from support.loops import on_every_loop
from support.table import each


def gcs_heartbeat(sysid: int = 250) -> bytes:
    values = {"type": 6, "autopilot": 8, "mavlink_version": 3}
    return encode(common_dialect().find("HEARTBEAT"), values, sysid=sysid, compid=190, seq=0)


async def udp_server(hub: RecordingHost, **keys: Any) -> UdpServerLink:
    config = models.UdpServerLinkConfig.model_validate({"name": "net", "host": "127.0.0.1", "port": 0, **keys})
    link = UdpServerLink(config, hub, asyncio.get_running_loop())
    await link.open()
    return link


async def tcp_server(hub: RecordingHost, **keys: Any) -> TcpServerLink:
    config = models.TcpServerLinkConfig.model_validate({"name": "net", "host": "127.0.0.1", "port": 0, **keys})
    link = TcpServerLink(config, hub, asyncio.get_running_loop())
    await link.open()
    return link


def udp_from(stack: ExitStack, ip: str) -> socket.socket:
    sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    sock.bind((ip, 0))
    return sock


def tcp_from(stack: ExitStack, ip: str, link: TcpServerLink) -> socket.socket:
    sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
    sock.bind((ip, 0))
    sock.connect(("127.0.0.1", link.bound_port))
    sock.setblocking(False)
    return sock


def is_closed(sock: socket.socket) -> bool:
    try:
        return sock.recv(100) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


@on_every_loop
async def test_datagrams_from_elsewhere_are_dropped_unread_counted_and_reported_once_per_address() -> None:
    host = RecordingHost()
    link = await udp_server(host, allow_from=["127.0.0.2/32", "127.0.1.0/24"])
    to = ("127.0.0.1", link.bound_port)
    with ExitStack() as stack:
        stranger, another, friend, other_friend = (
            udp_from(stack, ip) for ip in ("127.0.0.3", "127.0.0.4", "127.0.0.2", "127.0.1.77")
        )
        for _ in range(5):
            stranger.sendto(heartbeat(1), to)
            another.sendto(heartbeat(2), to)
        friend.sendto(heartbeat(3), to)
        other_friend.sendto(heartbeat(4), to)
        await until(lambda: len(host.heard) == 2)
    assert [frame.sysid for _, frame in host.heard] == [3, 4]
    assert link.counters()["not_allowed"] == 10
    assert link.counters()["ignored_datagrams"] == 0
    assert link._probe.stats.good == 2, "nothing else was parsed"
    assert [event.data["address"] for event in host.events] == ["127.0.0.3", "127.0.0.4"]
    assert "links.net: 127.0.0.3:" in host.events[0].text
    await link.close()


@on_every_loop
async def test_addresses_that_are_not_allowed_are_reported_a_few_times_at_most() -> None:
    host = RecordingHost()
    link = await udp_server(host, allow_from=["10.0.0.0/8"])
    with ExitStack() as stack:
        for number in range(1, 41):
            udp_from(stack, f"127.0.0.{number}").sendto(heartbeat(1), ("127.0.0.1", link.bound_port))
        await until(lambda: link.counters()["not_allowed"] == 40)
    assert len(host.events) == MAX_REPORTED
    assert host.channels == []
    await link.close()


@on_every_loop
async def test_connections_from_elsewhere_are_closed_at_once() -> None:
    host = RecordingHost()
    link = await tcp_server(host, allow_from=["127.0.0.2"])
    with ExitStack() as stack:
        stranger = tcp_from(stack, "127.0.0.3", link)
        friend = tcp_from(stack, "127.0.0.2", link)
        friend.send(heartbeat(3))
        await until(lambda: host.heard)
        await until(lambda: is_closed(stranger))
        assert [channel.peer for channel in link.channels] == [f"127.0.0.2:{friend.getsockname()[1]}"]
        assert link.counters()["not_allowed"] == 1
    await link.close()


@on_every_loop
async def test_300_peers_without_an_autopilot_leave_room_for_a_vehicle() -> None:
    host = RecordingHost()
    link = await udp_server(host, max_peers=256)
    to = ("127.0.0.1", link.bound_port)
    with ExitStack() as stack:
        flood = [udp_from(stack, "127.0.0.3") for _ in range(300)]
        for sock in flood:
            sock.sendto(gcs_heartbeat(), to)
            await asyncio.sleep(0)
        await until(lambda: link.counters()["peers_refused"] == 300 - 256)
        assert len(link.channels) == 256
        assert [event.data["change"] for event in host.events] == ["full"]
        assert host.events[0].data["address"] == "127.0.0.3"
        vehicle = udp_from(stack, "127.0.0.3")
        vehicle.sendto(heartbeat(77), to)
        await until(lambda: any(frame.sysid == 77 for _, frame in host.heard))
        assert len(link.channels) == 256
        assert link.counters()["peers_put_out"] == 1
        for sock in flood:
            sock.sendto(gcs_heartbeat(), to)
        await until(lambda: len(host.heard) >= 256 + 1 + 255)
        assert f"127.0.0.3:{vehicle.getsockname()[1]}" in [channel.peer for channel in link.channels]
        assert [event.data["change"] for event in host.events] == ["full"]
    await link.close()


@on_every_loop
async def test_peers_that_all_claim_to_be_autopilots_are_bounded_and_the_first_stay() -> None:
    host = RecordingHost()
    link = await udp_server(host, max_peers=32)
    to = ("127.0.0.1", link.bound_port)
    with ExitStack() as stack:
        first = udp_from(stack, "127.0.0.2")
        first.sendto(heartbeat(1), to)
        await until(lambda: host.heard)
        for number in range(60):
            udp_from(stack, "127.0.0.3").sendto(heartbeat(2 + number), to)
        await until(lambda: link.counters()["peers_refused"] == 60 - 31)
        assert link.channels[0].peer == f"127.0.0.2:{first.getsockname()[1]}"
        udp_from(stack, "127.0.0.4").sendto(heartbeat(100), to)
        await until(lambda: any(frame.sysid == 100 for _, frame in host.heard))
        assert len(link.channels) == 33, "a place beyond, for an address that had none"
    await link.close()


@on_every_loop
async def test_a_server_that_was_full_and_has_emptied_says_so() -> None:
    host = RecordingHost()
    link = await udp_server(host, max_peers=2, peer_timeout_s=0.2)
    with ExitStack() as stack:
        for _ in range(3):
            udp_from(stack, "127.0.0.3").sendto(gcs_heartbeat(), ("127.0.0.1", link.bound_port))
        await until(lambda: not link.channels and link.counters()["peers_expired"] == 2)
    assert [event.data["change"] for event in host.events] == ["full", "not_full"]
    await link.close()


@on_every_loop
async def test_tcp_clients_that_say_nothing_give_way_to_one_that_comes() -> None:
    host = RecordingHost()
    link = await tcp_server(host, max_clients=3)
    with ExitStack() as stack:
        vehicle = tcp_from(stack, "127.0.0.2", link)
        vehicle.send(heartbeat(1))
        idle = [tcp_from(stack, "127.0.0.3", link) for _ in range(2)]
        await until(lambda: len(link.channels) == 3 and host.heard)
        newcomer = tcp_from(stack, "127.0.0.3", link)
        await until(lambda: is_closed(newcomer))
        for channel in link.channels:
            channel.last_rx_at -= PEER_SILENT_S
        link._admission.places.changed()
        newcomer = tcp_from(stack, "127.0.0.3", link)
        newcomer.send(heartbeat(5))
        await until(lambda: any(frame.sysid == 5 for _, frame in host.heard))
        await until(lambda: is_closed(idle[0]))
        assert not is_closed(vehicle)
        assert link.counters() == {"clients_refused": 1, "clients_put_out": 1, "not_allowed": 0}
    await link.close()


@each(
    ("host", "networks", "allowed"),
    [
        ("10.0.0.7", ["10.0.0.0/24"], True),
        ("10.0.1.7", ["10.0.0.0/24"], False),
        ("10.0.1.7", ["10.0.0.0/24", "10.0.1.7"], True),
        ("fd00::1", ["fd00::/8"], True),
        ("fe80::1%eth0", ["fe80::/10"], True),
        ("10.0.0.7", ["fd00::/8"], False),
        ("fd00::1", ["0.0.0.0/0"], False),
        ("not an address", ["0.0.0.0/0", "::/0"], False),
        ("anything", None, True),
    ],
)
def test_networks(host: str, networks: list[str] | None, allowed: bool) -> None:
    assert (host in AllowedNetworks(networks)) is allowed
    once = AllowedNetworks(networks)
    assert (host in once, host in once) == (allowed, allowed)


@given(st.lists(st.ip_addresses(), max_size=50))
def test_any_address_is_judged_as_the_standard_library_does(addresses: list[Any]) -> None:
    allowed = AllowedNetworks(["10.0.0.0/8", "2000::/3"])
    for address in addresses:
        inside = address.packed[0] == 10 if address.version == 4 else 0x20 <= address.packed[0] <= 0x3F
        assert (str(address) in allowed) is inside


def test_remembered_addresses_are_bounded() -> None:
    allowed = AllowedNetworks(["10.0.0.0/8"])
    for number in range(3 * MAX_REMEMBERED):
        assert f"10.{number >> 8}.{number & 255}.1" in allowed
    assert len(allowed._remembered) <= MAX_REMEMBERED


@on_every_loop
async def test_an_ipv4_peer_of_an_ipv6_socket_is_judged_by_its_ipv4_address() -> None:
    host = RecordingHost()
    link = await udp_server(host, host="::", allow_from=["127.0.0.2"])
    with ExitStack() as stack:
        for ip in ("127.0.0.3", "127.0.0.2"):
            udp_from(stack, ip).sendto(heartbeat(1), ("127.0.0.1", link.bound_port))
        await until(lambda: host.heard)
        assert [channel.peer.partition(":")[0] for channel in link.channels] == ["127.0.0.2"]
    await link.close()
