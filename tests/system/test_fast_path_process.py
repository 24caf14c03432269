"""Traffic that once hung a whole daemon in its compiled fast path: it goes on routing, and SIGTERM ends it."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

import pytest

from skygcs.core.mavlink.frame import frame_size
from support.frames import frame, heartbeat
from support.process import DaemonProcess, free_port, wait_until

pytestmark = pytest.mark.system

AUTOPILOT, COMPANION = 1, 191


def telemetry(count: int, per_datagram: int, compids: tuple[int, ...], first: int) -> list[bytes]:
    """So many frames, numbered from ``first`` in time_boot_ms, of these components in turn."""
    frames = [
        frame("ATTITUDE", {"time_boot_ms": first + n}, compid=compids[n % len(compids)], seq=n // len(compids))
        for n in range(count)
    ]
    return [b"".join(frames[at : at + per_datagram]) for at in range(0, count, per_datagram)]


def numbers(datagrams: list[bytes]) -> list[int]:
    """The numbers of the telemetry frames in what a ground station got."""
    found = []
    for data in datagrams:
        at = 0
        while size := frame_size(data, at):
            raw = data[at : at + size]
            if raw[7] == 30:
                found.append(int.from_bytes(raw[10 : 10 + min(raw[1], 4)], "little"))
            at += size
    return found


class GroundStation:
    """A socket that keeps what it gets."""

    def __init__(self) -> None:
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.sock.bind(("127.0.0.1", 0))
        self.sock.setblocking(False)
        self.port = self.sock.getsockname()[1]
        self.got: list[bytes] = []

    def __enter__(self) -> GroundStation:
        return self

    def __exit__(self, *_: object) -> None:
        self.sock.close()

    def numbers(self) -> list[int]:
        while True:
            try:
                self.got.append(self.sock.recv(65536))
            except BlockingIOError:
                return numbers(self.got)


CASES = {
    "66 frames in a datagram": ("", "", 66, 66, (AUTOPILOT,)),
    "256 frames in a datagram": ("", "", 256, 256, (AUTOPILOT,)),
    "10 frames a datagram, sent singly": ("", "whole_datagrams = false", 200, 10, (AUTOPILOT,)),
    "autopilot and companion beside a vehicle": (
        '[links.other]\ntype = "udp_client"\nhost = "127.0.0.1"\nport = {other}\nrole = "vehicle"\n',
        "",
        120,
        6,
        (AUTOPILOT, COMPANION),
    ),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_a_burst_of_frames_does_not_stop_the_daemon(
    tmp_path: Path, case: tuple[str, str, int, int, tuple[int, ...]]
) -> None:
    with GroundStation() as station, GroundStation() as other:
        _burst(tmp_path, case, station, other)


def _burst(
    folder: Path, case: tuple[str, str, int, int, tuple[int, ...]], station: GroundStation, other: GroundStation
) -> None:
    more, setting, count, per_datagram, compids = case
    port = free_port()
    toml = f"""
[links.air]
type = "udp_server"
host = "127.0.0.1"
port = {port}
{setting}
[links.gcs]
type = "udp_client"
host = "127.0.0.1"
port = {station.port}
{setting}
{more.format(other=other.port)}
"""
    to = ("127.0.0.1", port)
    with DaemonProcess(folder, toml) as daemon, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        assert daemon.process is not None
        pid = daemon.process.pid
        wait_until(lambda: all(r["state"] == "up" for r in daemon.call("links.list")), "all links are up")
        # what the fast path learns from, until nothing changes any more
        vehicle.sendto(heartbeat(), to)
        vehicle.sendto(heartbeat(compid=COMPANION, type=18, autopilot=8), to)
        wait_until(daemon.known, "the vehicle is known")
        for number in range(3):
            for data in telemetry(len(compids), 1, compids, number * 10):
                vehicle.sendto(data, to)
            wait_until(lambda n=number: station.numbers()[-1:] == [n * 10 + len(compids) - 1], "frames are forwarded")
        # all of it at once
        os.kill(pid, signal.SIGSTOP)
        for data in telemetry(count, per_datagram, compids, 1_000):
            vehicle.sendto(data, to)
        os.kill(pid, signal.SIGCONT)
        wait_until(lambda: len([n for n in station.numbers() if n >= 1_000]) == count, "all frames of the burst came")
        assert [n for n in station.numbers() if n >= 1_000] == list(range(1_000, 1_000 + count))
        # and further ones
        vehicle.sendto(frame("ATTITUDE", {"time_boot_ms": 5_000}, seq=200), to)
        wait_until(lambda: station.numbers()[-1] == 5_000, "it goes on routing")
        assert daemon.call("daemon.info")["vehicles"] == 1
        daemon.stop()  # fails if SIGTERM does not end it
        assert daemon.process.returncode == 0, daemon.stderr
