"""A real daemon on uvloop and a simulated vehicle in a process of its own: SIGTERM and SIGKILL in a fence test."""

from __future__ import annotations

import contextlib
import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.hanging import HANG_S
from support.process import ROOT, DaemonProcess, free_port, wait_until

pytestmark = pytest.mark.system

NAMES = {
    "v1": ("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST"),
    "v2": ("FENCE_ENABLE", "FENCE_ACTION", "FENCE_RADIUS", "FENCE_TYPE", "FENCE_ALT_MAX"),
}
"""v1 is a PX4, v2 an ArduCopter."""


@pytest.fixture
def vehicles() -> Iterator[int]:
    """The TCP port of two simulated vehicles that outlive daemons."""
    port = free_port(socket.SOCK_STREAM)
    words = [sys.executable, "-m", "skygcs", "sim", "--tcp", f"127.0.0.1:{port}"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert process.stdout is not None
        process.stdout.readline()
        yield port
    finally:
        process.kill()
        process.communicate()


def daemon_for(folder: Path, port: int) -> DaemonProcess:
    return DaemonProcess(folder, f'[links.air]\ntype = "tcp_client"\nhost = "127.0.0.1"\nport = {port}\n')


def held(daemon: DaemonProcess, name: str) -> dict[str, float]:
    wait_until(lambda: daemon.known() == 2, "both vehicles are known")
    answer = daemon.call("params.get", targets=name, names=list(NAMES[name]))
    values = {n: o["value"] for n, o in answer["outcomes"][name].items()}
    assert None not in values.values(), answer
    return values


def begin_test(daemon: DaemonProcess, name: str) -> threading.Thread:
    """Somebody waits for a fence test, who is of no use when the daemon is gone."""

    def ask() -> None:
        with contextlib.suppress(AssertionError, OSError, ValueError):
            daemon.call("fence.test", targets=name, radius_m=5.0)

    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    return asking


def walk(daemon: DaemonProcess, name: str) -> None:
    def walks() -> bool:
        events = daemon.call("events.recent", limit=200)
        return any(e["kind"] == "fence" and "carry it" in e["text"] for e in events)

    # an ArduCopter's estimator needs a while until it has a home
    while True:
        asking = begin_test(daemon, name)
        wait_until(lambda a=asking: walks() or not a.is_alive(), "the test begins or is refused")
        if walks():
            return


@pytest.mark.parametrize("name", ["v1", "v2"])
def test_sigterm_in_a_fence_test_leaves_the_fence_as_it_was(tmp_path: Path, vehicles: int, name: str) -> None:
    daemon = daemon_for(tmp_path, vehicles)
    with daemon:
        before = held(daemon, name)
        walk(daemon, name)
        assert held(daemon, name) != before
        assert len(list((daemon.logs / "undo").glob("*.json"))) == 1
    assert daemon.process is not None and daemon.process.returncode == 0
    assert list((daemon.logs / "undo").iterdir()) == []
    with daemon:
        assert held(daemon, name) == before
        assert daemon.call("daemon.info")["to_undo"] == 0


@pytest.mark.parametrize("name", ["v1", "v2"])
def test_after_sigkill_it_is_told_and_undone_when_somebody_asks(tmp_path: Path, vehicles: int, name: str) -> None:
    daemon = daemon_for(tmp_path, vehicles)
    with daemon:
        before = held(daemon, name)
        walk(daemon, name)
        changed = held(daemon, name)
        daemon.kill()
    with daemon:
        assert held(daemon, name) == changed != before
        assert "skygcs-cli undo run" in daemon.stderr
        reported = daemon.cli("status")
        assert reported.returncode == 0 and "1 change in vehicles not undone" in reported.stderr
        (change,) = json.loads(daemon.cli("undo", "list", "--json").stdout)["changes"]
        assert change["before"].items() <= {**change["before"], **before}.items()
        undone = daemon.cli("undo", "run", "all")
        assert undone.returncode == 0 and "as before" in undone.stdout, undone
        assert held(daemon, name) == before
        assert "nothing to undo" in daemon.cli("undo", "list").stdout
        assert "not undone" not in daemon.cli("status").stderr


def test_sigterm_with_a_vehicle_that_is_gone_ends_it_all_the_same(tmp_path: Path, vehicles: int) -> None:
    """The link is open, nobody answers: 5 s for undos and holds, and then it ends."""
    relay = socket.create_server(("127.0.0.1", 0))
    daemon = daemon_for(tmp_path, relay.getsockname()[1])
    daemon.start()
    try:
        near, _ = relay.accept()
        far = socket.create_connection(("127.0.0.1", vehicles))
        open_ = threading.Event()
        open_.set()

        def pump(source: socket.socket, sink: socket.socket) -> None:
            with contextlib.suppress(OSError):
                while data := source.recv(65536):
                    if open_.is_set():
                        sink.sendall(data)

        for pair in ((near, far), (far, near)):
            threading.Thread(target=pump, args=pair, daemon=True).start()
        held(daemon, "v1")
        walk(daemon, "v1")
        open_.clear()
        assert daemon.process is not None
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(HANG_S) == 0
        assert "NOT AS BEFORE" in daemon.stderr
        assert len(list((daemon.logs / "undo").glob("*.json"))) == 1
    finally:
        daemon.stop()
        for end in (near, far, relay):
            end.close()
