"""A real `skygcs` process between a pty radio, a UDP and a TCP server; pymavlink clients see what the rules say."""

from __future__ import annotations

import json
import random
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from skygcs.config.dialects import offline_dialect
from skygcs.tlog.reading import LogReader
from support.process import DaemonProcess, free_port, wait_until
from support.pseudo_tty import PtyRadio
from support.pymav import PymavPeer, TcpPeer, UdpPeer

pytestmark = pytest.mark.system


class Field:
    """The whole set-up: a radio with vehicles 1 and 2 behind it, vehicle 3 on UDP, stations on UDP and TCP."""

    def __init__(self, folder: Path) -> None:
        self.udp_port = free_port()
        self.tcp_port = free_port(socket.SOCK_STREAM)
        self.radio = PtyRadio(folder / "radio")
        self.radio.plug_in()
        self.daemon = DaemonProcess(
            folder,
            f"""
[links.radio]
type = "serial"
device = "{folder}/radio"
role = "radio"
[links.udp]
type = "udp_server"
host = "127.0.0.1"
port = {self.udp_port}
[links.tcp]
type = "tcp_server"
port = {self.tcp_port}
role = "gcs"
[vehicles.alpha]
sysid = 1
[vehicles.bravo]
sysid = 2
""",
        )
        self.v1, self.v2 = PymavPeer(1, 1), PymavPeer(2, 1)
        self.heard_on_radio = PymavPeer(0, 0)
        self.peers: list[UdpPeer | TcpPeer] = []

    def open(self) -> None:
        self.daemon.start()
        self.wait_for_links()
        self.v3 = UdpPeer(3, 1, self.udp_port)
        self.qgc = UdpPeer(255, 190, self.udp_port)
        self.script = TcpPeer(250, 1, self.tcp_port)
        self.peers = [self.v3, self.qgc, self.script]
        self.beat()
        wait_until(lambda: self.daemon.known() == 3, "three vehicles are known")
        wait_until(lambda: len(self.daemon.call("router.stats")["routes"]) >= 5, "five routes are known")
        time.sleep(0.2)
        self.poll()
        self.clear()

    def wait_for_links(self) -> None:
        """What is said into a port before the daemon has opened it is nobody's to hear."""
        wait_until(lambda: all(r["state"] == "up" for r in self.daemon.call("links.list")), "all links are up")

    def beat(self) -> None:
        self.radio.send(self.v1.heartbeat() + self.v2.heartbeat())
        self.v3.send(self.v3.heartbeat())
        self.qgc.send(self.qgc.heartbeat(vehicle=False))
        self.script.send(self.script.heartbeat(vehicle=False))

    def poll(self) -> None:
        self.heard_on_radio.parse(self.radio.read())
        for peer in self.peers:
            peer.poll()

    def clear(self) -> None:
        for peer in (self.heard_on_radio, *self.peers):
            peer.seen.clear()

    def saw(self, peer: PymavPeer) -> list[tuple[str, int, int]]:
        """All but the daemon's own heartbeats."""
        self.poll()
        return [n for n in peer.names() if n != ("HEARTBEAT", 255, 25)]

    def close(self) -> None:
        for peer in self.peers:
            peer.close()
        self.daemon.stop()
        self.radio.pull_out()


@pytest.fixture
def field(tmp_path: Path) -> Iterator[Field]:
    field = Field(tmp_path)
    try:
        field.open()
        yield field
    finally:
        field.close()


def test_telemetry_from_the_radio_reaches_both_stations_and_no_vehicle(field: Field) -> None:
    field.radio.send(field.v1.pack(field.v1.mav.attitude_encode(1, 0.1, 0, 0, 0, 0, 0)))
    wait_until(lambda: field.saw(field.qgc) and field.saw(field.script), "the stations hear vehicle 1")
    assert field.saw(field.qgc) == field.saw(field.script) == [("ATTITUDE", 1, 1)]
    assert field.saw(field.heard_on_radio) == []


def test_a_command_reaches_only_its_target_and_the_ack_only_its_sender(field: Field) -> None:
    field.qgc.send(field.qgc.command(2, 1))
    wait_until(lambda: field.saw(field.heard_on_radio), "the radio hears the command")
    assert field.saw(field.heard_on_radio) == [("COMMAND_LONG", 255, 190)]
    assert field.saw(field.v3) == field.saw(field.script) == []
    ack = field.v2.mav.command_ack_encode(400, 0, target_system=255, target_component=190)
    field.radio.send(field.v2.pack(ack))
    wait_until(lambda: field.saw(field.qgc), "QGC hears the ack")
    assert field.saw(field.qgc) == [("COMMAND_ACK", 2, 1)]
    assert field.saw(field.script) == []


def test_two_peers_on_one_udp_port_do_not_get_each_others_commands(field: Field) -> None:
    field.script.send(field.script.command(3, 1))
    wait_until(lambda: field.saw(field.v3), "vehicle 3 hears the command")
    assert field.saw(field.v3) == [("COMMAND_LONG", 250, 1)]
    assert field.saw(field.qgc) == field.saw(field.heard_on_radio) == []


def test_a_broadcast_command_of_a_station_reaches_everybody_else(field: Field) -> None:
    field.qgc.send(field.qgc.command(0, 0))
    wait_until(lambda: field.saw(field.heard_on_radio) and field.saw(field.v3), "the vehicles hear it")
    assert field.saw(field.heard_on_radio) == [("COMMAND_LONG", 255, 190)]
    assert field.saw(field.v3) == [("COMMAND_LONG", 255, 190)]
    assert field.saw(field.script) == [("COMMAND_LONG", 255, 190)]
    assert field.saw(field.qgc) == []


def test_an_unknown_target_goes_nowhere_and_is_counted(field: Field) -> None:
    field.qgc.send(field.qgc.command(99, 1))
    wait_until(
        lambda: field.daemon.call("router.stats")["counters"]["unknown_target"] == 1, "the unknown target is counted"
    )
    for peer in (field.heard_on_radio, field.v3, field.script):
        assert [seen for seen in field.saw(peer) if seen != ("TIMESYNC", 255, 25)] == []  # but for our own probes


def test_mavlink_1_and_2_mix_on_one_link(field: Field) -> None:
    field.radio.send(field.v1.heartbeat(version=1) + field.v1.heartbeat(version=2))
    wait_until(lambda: len(field.saw(field.script)) == 2, "both heartbeats arrive")
    assert [m.get_msgbuf()[0] for m in field.script.seen if m.get_srcSystem() == 1] == [0xFE, 0xFD]


def test_an_unplugged_radio_comes_back_and_nothing_else_notices(field: Field) -> None:
    field.radio.pull_out()
    wait_until(lambda: _link(field, "radio")["state"] != "up", "the daemon sees the unplugged radio")
    field.v3.send(field.v3.heartbeat())
    wait_until(lambda: ("HEARTBEAT", 3, 1) in field.saw(field.script), "others are still routed")
    field.radio.plug_in()
    wait_until(lambda: _link(field, "radio")["state"] == "up", "the radio is back")
    field.clear()
    field.radio.send(field.v1.heartbeat())
    wait_until(lambda: ("HEARTBEAT", 1, 1) in field.saw(field.script), "vehicle 1 is heard again")
    kinds = [e["kind"] for e in field.daemon.call("events.recent", limit=100)]
    assert kinds.count("link_down") == 1
    assert field.daemon.process is not None and field.daemon.process.poll() is None
    assert "Traceback" not in field.daemon.stderr


def _link(field: Field, name: str) -> dict:  # type: ignore[type-arg]
    return next(link for link in field.daemon.call("links.list") if link["name"] == name)


def test_kill_9_and_restart_vehicles_are_back_and_the_tlog_is_whole(field: Field) -> None:
    for n in range(20):
        field.radio.send(field.v1.pack(field.v1.mav.attitude_encode(n, 0.1, 0, 0, 0, 0, 0)))
        time.sleep(0.02)
    wait_until(lambda: len(field.saw(field.script)) >= 20, "all were routed")
    (tlog,) = field.daemon.logs.glob("*.tlog")
    dialect = offline_dialect()

    def on_disk() -> int:
        frames = [r.frame for r in LogReader(tlog.read_bytes(), dialect)]
        return sum(frame is not None and frame.name == "ATTITUDE" for frame in frames)

    wait_until(lambda: on_disk() == 20, "they are on disk, and nobody closed the file")
    field.daemon.kill()
    reader = LogReader(tlog.read_bytes(), dialect)
    assert sum(r.frame is not None and r.frame.name == "ATTITUDE" for r in reader) == 20
    assert reader.faults.skipped_bytes == 0
    field.daemon.start()
    field.wait_for_links()
    field.radio.send(field.v1.heartbeat() + field.v2.heartbeat())
    wait_until(lambda: field.daemon.known() == 2, "both vehicles are back")


def test_noise_on_every_side_makes_no_vehicle_no_route_and_no_traceback(field: Field) -> None:
    noise = random.Random(7)
    routes = len(field.daemon.call("router.stats")["routes"])
    for _ in range(50):
        field.radio.send(noise.randbytes(4096))
        field.qgc.socket.send(noise.randbytes(900))
        field.script.send(noise.randbytes(4096))
    for _ in range(20):
        with socket.socket(socket.AF_UNIX) as garbage:
            garbage.connect(str(field.daemon.socket))
            garbage.sendall(noise.randbytes(2000) + b"\n{]\n[]\n\n" + b'{"jsonrpc":"2.0","method":7}\n')
    time.sleep(0.5)
    field.poll()
    field.clear()
    field.beat()
    wait_until(lambda: ("HEARTBEAT", 1, 1) in field.saw(field.qgc), "good frames still pass")
    assert field.daemon.known() == 3
    assert len(field.daemon.call("router.stats")["routes"]) == routes
    assert "Traceback" not in field.daemon.stderr


def test_the_cli_shows_the_fleet(field: Field) -> None:
    shown = field.daemon.cli("status", "--json")
    assert shown.returncode == 0, shown.stderr
    names = sorted(v["name"] for v in json.loads(shown.stdout))
    assert names == ["alpha", "bravo", "v3"]
    assert field.daemon.cli("status").returncode == 0
    refused = field.daemon.cli("arm", "nobody")
    assert refused.returncode == 1
    assert "nobody" in refused.stderr + refused.stdout


def test_without_a_daemon_the_cli_says_so(tmp_path: Path) -> None:
    daemon = DaemonProcess(tmp_path, "")
    answer = daemon.cli("status")
    assert answer.returncode == 3
    assert "skygcs run" in answer.stderr
    assert "Traceback" not in answer.stderr
