"""A real `skygcs` process and a peer that floods it: what a vehicle on another link, or on the same one, still gets."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.routing.routing_table import CROWDED_QUIET_S, ROUTE_NOTES, ROUTE_NOTES_PER_S
from support.process import DaemonProcess, free_port, wait_until
from support.pymav import PymavPeer, UdpPeer

pytestmark = pytest.mark.system

COMMANDS = ("COMMAND_LONG", "COMMAND_INT", "SET_MODE")


class Vehicle(UdpPeer):
    """An ArduCopter that says its heartbeat and does nothing else; what it is sent is in ``seen``."""

    @contextmanager
    def flying(self) -> Iterator[None]:
        over = threading.Event()

        def beat() -> None:
            while not over.wait(0.1):
                self.send(self.heartbeat())
                self.poll()

        thread = threading.Thread(target=beat)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def orders(self) -> list[str]:
        return [m.get_type() for m in self.seen if m.get_type() in COMMANDS]


def daemon_with(folder: Path, net: str = "") -> tuple[DaemonProcess, int, int]:
    net_port, field_port = free_port(), free_port()
    text = f"""
[links.net]
type = "udp_server"
host = "127.0.0.1"
port = {net_port}
{net}
[links.field]
type = "udp_server"
host = "127.0.0.1"
port = {field_port}
role = "vehicle"
"""
    return DaemonProcess(folder, text), net_port, field_port


def link(daemon: DaemonProcess, name: str) -> dict[str, Any]:
    return next(row for row in daemon.call("links.list") if row["name"] == name)


def events(daemon: DaemonProcess, kind: str) -> list[dict[str, Any]]:
    return [e for e in daemon.call("events.recent", limit=1000) if e["kind"] == kind]


def stop_reaches(daemon: DaemonProcess, vehicle: Vehicle) -> None:
    wait_until(lambda: any(v["connected"] for v in daemon.vehicles().values() if v["sysid"] == 77), "77 is heard")
    vehicle.seen.clear()
    daemon.call("vehicles.stop", targets="77", action="hold")
    wait_until(vehicle.orders, "the vehicle gets its stop")


@pytest.mark.parametrize("autopilots", [False, True], ids=["stations", "autopilots"])
def test_8160_sources_of_one_peer_keep_no_order_from_a_vehicle(tmp_path: Path, autopilots: bool) -> None:
    daemon, net_port, field_port = daemon_with(tmp_path)
    with daemon, ExitStack() as stack:
        hostile = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        sent, begun = 0, time.monotonic()
        for sysid in range(100, 132):
            for first in range(1, 256, 15):
                frames = [PymavPeer(sysid, c).heartbeat(vehicle=autopilots) for c in range(first, first + 15)]
                hostile.sendto(b"".join(frames), ("127.0.0.1", net_port))
                sent += len(frames)
            wait_until(
                lambda sent=sent: sum(c["rx_frames"] for c in link(daemon, "net")["channels"]) == sent, "all came"
            )
        assert sent == 8160
        counters = daemon.call("router.stats")
        held, refused = len(counters["routes"]), counters["refused_routes"]
        assert held <= 1024
        # no more exactly: on a loaded machine the flood outlasts its first routes, which then make room for later ones
        assert 0 < refused <= 8160 - 1024
        (channel,) = link(daemon, "net")["channels"]
        assert channel["routes_refused"] == refused
        event, *later = [e for e in events(daemon, "warning") if e["data"].get("change") == "crowded"]
        assert len(later) < (time.monotonic() - begun) / CROWDED_QUIET_S
        assert f"127.0.0.1:{hostile.getsockname()[1]}" in event["text"]
        vehicle = Vehicle(77, 1, field_port)
        stack.callback(vehicle.close)
        with vehicle.flying():
            stop_reaches(daemon, vehicle)
        bound = 2 * (ROUTE_NOTES + (time.monotonic() - begun) * ROUTE_NOTES_PER_S)  # of its link and the vehicle's
        assert len(events(daemon, "route")) <= bound, "a flood leaves room for other events"


def test_300_peers_of_a_server_keep_no_vehicle_from_it(tmp_path: Path) -> None:
    daemon, net_port, _ = daemon_with(tmp_path)
    with daemon, ExitStack() as stack:
        flood = [UdpPeer(250, 190, net_port) for _ in range(300)]
        for peer in flood:
            stack.callback(peer.close)
            peer.send(peer.heartbeat(vehicle=False))
        wait_until(lambda: link(daemon, "net")["peers_refused"] == 300 - 256, "the flood fills the server")
        vehicle = Vehicle(77, 1, net_port)
        stack.callback(vehicle.close)
        with vehicle.flying():
            stop_reaches(daemon, vehicle)
            for peer in flood:
                peer.send(peer.heartbeat(vehicle=False))
            stop_reaches(daemon, vehicle)
        assert len(link(daemon, "net")["channels"]) == 256
        full = [e for e in events(daemon, "warning") if e["data"].get("change") == "full"]
        assert len(full) == 1
        assert "127.0.0.1:" in full[0]["text"]


def test_what_comes_from_elsewhere_is_not_heard(tmp_path: Path) -> None:
    daemon, net_port, _ = daemon_with(tmp_path, 'allow_from = ["127.0.0.2"]')
    with daemon, ExitStack() as stack:
        voices = []
        for ip in ("127.0.0.1", "127.0.0.2"):
            sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            sock.bind((ip, 0))
            voices.append(sock)
        for sysid, sock in enumerate(voices, 1):
            sock.sendto(PymavPeer(sysid, 1).heartbeat(), ("127.0.0.1", net_port))
        wait_until(lambda: daemon.known() == 1, "the one is heard")
        assert [v["sysid"] for v in daemon.vehicles().values()] == [2]
        assert link(daemon, "net")["not_allowed"] == 1
        (event,) = events(daemon, "warning")
        assert event["data"] == {"link": "net", "change": "not_allowed", "address": "127.0.0.1"}
