"""A real `skygcs` process with more clients than it has places for: the emergency stop still works."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from support.process import DaemonProcess, wait_until

pytestmark = pytest.mark.system

FLEET = """
[links.sim]
type = "simulated"
px4 = 1
ardupilot = 1
"""
LINE = b'{"jsonrpc":"2.0","id":1,"method":"vehicles.list","params":{"targets":"all"}}\n'


def connected(daemon: DaemonProcess, stack: ExitStack) -> socket.socket:
    sock = stack.enter_context(socket.socket(socket.AF_UNIX))
    sock.connect(str(daemon.socket))
    return sock


@contextmanager
def in_the_background(*works: object) -> Iterator[None]:
    """Each ``work()`` again and again in a thread of its own."""
    over = threading.Event()

    def again(work: object) -> None:
        while not over.is_set():
            with contextlib.suppress(OSError):
                work()  # type: ignore[operator]

    threads = [threading.Thread(target=again, args=(work,)) for work in works]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        over.set()
        for thread in threads:
            thread.join()


def test_stop_works_with_64_idle_clients(tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, FLEET) as daemon, ExitStack() as stack:
        wait_until(lambda: daemon.known() == 2, "both vehicles are known")
        for _ in range(64):
            connected(daemon, stack)
        told = daemon.cli("stop", "all")
        assert told.returncode == 0, told.stderr
        assert "all 64 places are taken, 64 by process" in daemon.stderr
        refused = daemon.cli("arm", "all")
        assert refused.returncode == 1
        assert "too many clients" in refused.stderr


def test_stop_works_with_64_flooding_clients_and_1000_connections(tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, FLEET) as daemon, ExitStack() as stack:
        wait_until(lambda: daemon.known() == 2, "both vehicles are known")
        flooding = [connected(daemon, stack) for _ in range(64)]
        attempts = 0

        def flood() -> None:
            for sock in flooding:
                sock.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    sock.send(LINE * 20)
                with contextlib.suppress(BlockingIOError):
                    sock.recv(1 << 20)

        def knock() -> None:
            nonlocal attempts
            with ExitStack() as some:
                for _ in range(50):
                    attempts += 1
                    sock = some.enter_context(socket.socket(socket.AF_UNIX))
                    sock.setblocking(False)
                    sock.connect(str(daemon.socket))

        with in_the_background(flood, knock):
            for targets in ("all", "1", "2"):
                told = daemon.cli("stop", targets)
                assert told.returncode == 0, told.stderr
            wait_until(lambda: attempts > 1000, "1000 connections were tried")
            assert daemon.cli("land", "all").returncode == 0
        wait_until(lambda: daemon.known() == 2, "it still answers")
