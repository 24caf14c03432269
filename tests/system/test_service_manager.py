"""A real `skygcs run` under a played service manager: sd_notify, the watchdog, reload on SIGHUP."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.process import free_port, wait_until
from support.routed import heartbeat

FLEET = """
[daemon]
socket = "s"
record = false
[links.a]
type = "udp_server"
host = "127.0.0.1"
port = {a}
[links.b]
type = "udp_server"
host = "127.0.0.1"
port = {b}
[links.gcs]
type = "udp_client"
host = "127.0.0.1"
port = {gcs}
role = "gcs"
"""


class Manager:
    """Receives what the daemon reports to its service manager."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.notify.bind(str(folder / "notify"))
        self.notify.setblocking(False)
        self.states: list[str] = []
        self.gcs = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.gcs.bind(("127.0.0.1", 0))
        self.gcs.setblocking(False)
        self.ports = free_port(), free_port()
        self.write(*self.ports)
        environment = os.environ | {"NOTIFY_SOCKET": str(folder / "notify"), "WATCHDOG_USEC": "200000"}
        words = [sys.executable, "-m", "skygcs", "run", str(folder / "fleet.toml")]
        with (folder / "log").open("wb") as log:
            self.process = subprocess.Popen(words, stdout=log, stderr=log, env=environment, cwd=folder)

    def write(self, a: int, b: int) -> None:
        (self.folder / "fleet.toml").write_text(FLEET.format(a=a, b=b, gcs=self.gcs.getsockname()[1]))

    def log(self) -> str:
        return (self.folder / "log").read_text()

    def heard(self, state: str, times: int = 1) -> bool:
        while True:
            try:
                self.states += self.notify.recv(4096).decode().splitlines()
            except BlockingIOError:
                break
        return self.states.count(state) >= times

    def forwarded(self, sysid: int) -> list[int]:
        """The sequence numbers that came out at the ground station since the last call, of that sender."""
        numbers: list[int] = []
        while True:
            try:
                raw = self.gcs.recv(2048)
            except BlockingIOError:
                return numbers
            if raw[5] == sysid:
                numbers.append(raw[4])

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait(30)
        self.notify.close()
        self.gcs.close()


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    manager = Manager(tmp_path)
    try:
        yield manager
    finally:
        manager.close()


@pytest.mark.system
def test_it_reports_ready_alive_reloading_and_stopping(manager: Manager) -> None:
    wait_until(lambda: manager.heard("READY=1"), "ready")
    assert manager.states[0] in ("READY=1", "WATCHDOG=1") and "STOPPING=1" not in manager.states
    wait_until(lambda: manager.heard("WATCHDOG=1", 3), "the watchdog is fed")
    # one link changes
    manager.write(manager.ports[0], free_port())
    manager.process.send_signal(signal.SIGHUP)
    wait_until(lambda: manager.heard("READY=1", 2), "reloaded")
    reloading = manager.states.index("RELOADING=1")
    assert manager.states[reloading + 1].startswith("MONOTONIC_USEC=")
    wait_until(lambda: "link b changed" in manager.log(), "the log, which a thread writes into a file, has it")
    assert "link a changed" not in manager.log()
    # a file with a mistake changes nothing, and ends nothing
    (manager.folder / "fleet.toml").write_text("[links.a]\ntype = 'telepathy'\n")
    manager.process.send_signal(signal.SIGHUP)
    wait_until(lambda: manager.heard("READY=1", 3), "the mistake is reported")
    wait_until(lambda: "is not applied" in manager.log() and "telepathy" in manager.log(), "the log has the mistake")
    time.sleep(0.1)
    assert manager.process.poll() is None
    manager.process.send_signal(signal.SIGTERM)
    assert manager.process.wait(30) == 0
    assert manager.heard("STOPPING=1")


@pytest.mark.system
def test_a_reload_of_one_link_loses_no_frame_of_the_others(manager: Manager) -> None:
    wait_until(lambda: manager.heard("READY=1"), "ready")
    to_a = ("127.0.0.1", manager.ports[0])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:

        def first_came_out() -> bool:
            vehicle.sendto(heartbeat(8), to_a)
            return manager.forwarded(8) != []

        wait_until(first_came_out, "links are up")
        numbers: list[int] = []
        sent = 0
        reloads = 0
        while not manager.heard("READY=1", 3):  # link b changes twice while frames come in at a
            if sent >= 50 and reloads < 2 and manager.heard("READY=1", reloads + 1):
                reloads += 1
                manager.write(manager.ports[0], free_port())
                manager.process.send_signal(signal.SIGHUP)
            vehicle.sendto(heartbeat(7, seq=sent & 0xFF), to_a)
            sent += 1
            numbers += manager.forwarded(7)
            time.sleep(0.002)

        def all_came_out() -> bool:
            numbers.extend(manager.forwarded(7))
            return len(numbers) >= sent

        wait_until(all_came_out, "all frames of the vehicle")
    assert numbers == [n & 0xFF for n in range(sent)]
    wait_until(lambda: manager.log().count("link b changed") == 2, "the log, which a thread writes")
