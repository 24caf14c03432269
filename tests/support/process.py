"""A real `skygcs run` process for system tests: free ports, a temporary directory, ended by pid."""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from support.hanging import HANG_S

ROOT = Path(__file__).parents[2]


FIELD_TOML = """
[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0
"""
"""Where simulated vehicles stand, as the origin of a fleet file."""

PORTS = range(20_000, 30_000)
"""Below the kernel's range for sockets that ask for no port (32768 and up): nobody is given one of them by chance
between `free_port` and the program that binds it. Known services have theirs elsewhere."""

_claims: list[socket.socket] = []
"""Names of the kernel that hold this process's ports against other processes of the tests, until it ends."""


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    """A port of this machine that nobody has, and that nobody else is given by this function."""
    for port in random.SystemRandom().sample(PORTS, len(PORTS)):
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0skygcs-tests-port-{port}")
            with socket.socket(socket.AF_INET, kind) as probe:
                probe.bind(("", port))
        except OSError:
            claim.close()
            continue
        _claims.append(claim)
        return port
    raise RuntimeError(f"no free port in {PORTS}")


def wait_until(condition: Callable[[], Any], what: str) -> Any:
    """The condition's first true value; fails the test with ``what`` if there is none."""
    deadline = time.monotonic() + HANG_S
    while time.monotonic() < deadline:
        value = condition()
        if value:
            return value
        time.sleep(0.02)
    raise AssertionError(f"never happened: {what}")


def call_socket(path: Path, method: str, **params: Any) -> Any:
    """One JSON-RPC call over a plain socket, independent of the client library."""
    with socket.socket(socket.AF_UNIX) as link:
        # Not settimeout: connect would then fail with EAGAIN at once while the listen queue is full
        link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", int(HANG_S), 0))
        link.connect(str(path))
        link.settimeout(HANG_S)
        link.sendall(json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode() + b"\n")
        with link.makefile("rb") as lines:
            answer = json.loads(lines.readline())
    if "error" in answer:
        raise AssertionError(answer["error"])
    return answer["result"]


def cli_at(socket: Path, *words: str | Path, code: int = 0) -> str:
    """Run `skygcs-cli` with this socket and return its output; the exit code must be ``code``."""
    done = subprocess.run(
        [Path(sys.executable).with_name("skygcs-cli"), *map(str, words)],
        env={**os.environ, "SKYGCS_SOCKET": str(socket)},
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=False,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


class DaemonProcess:
    """`skygcs run` with this fleet file; use as a context manager. ``stderr`` is kept for looking at."""

    def __init__(self, folder: Path, toml: str, *, name: str = "fleet") -> None:
        self.folder = folder
        self.socket = folder / f"{name}.sock"
        self.logs = folder / "logs"
        self.file = folder / f"{name}.toml"
        self.file.write_text(f'[daemon]\nsocket = "{self.socket}"\nlog_dir = "{self.logs}"\n{toml}')
        self.stderr_path = folder / f"{name}.stderr"
        self.process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> DaemonProcess:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        with self.stderr_path.open("ab") as stderr:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "skygcs", "run", "-v", str(self.file)], stderr=stderr, stdout=stderr, cwd=ROOT
            )
        try:
            wait_until(self._answers, f"the daemon answers; it said: {self.stderr_path}")
        except BaseException:  # __exit__ is not called when __enter__ raises
            self.kill()
            raise

    def _answers(self) -> bool:
        assert self.process is not None
        assert self.process.poll() is None, self.stderr
        try:
            return bool(self.call("daemon.info"))
        except OSError:
            return False

    @property
    def stderr(self) -> str:
        return self.stderr_path.read_text()

    def call(self, method: str, **params: Any) -> Any:
        """See `call_socket`."""
        return call_socket(self.socket, method, **params)

    def vehicles(self) -> dict[str, dict[str, Any]]:
        return {v["name"]: v for v in self.call("vehicles.list", targets="all")} if self.known() else {}

    def known(self) -> int:
        return int(self.call("daemon.info")["vehicles"])

    def cli(self, *words: str, timeout_s: float = HANG_S) -> subprocess.CompletedProcess[str]:
        """`skygcs-cli` against this daemon."""
        return subprocess.run(self.command(*words), capture_output=True, text=True, timeout=timeout_s, check=False)

    def command(self, *words: str) -> list[str]:
        """`skygcs-cli` against this daemon, to be started."""
        return [str(Path(sys.executable).with_name("skygcs-cli")), "--socket", str(self.socket), *words]

    def kill(self) -> None:
        """kill -9."""
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(HANG_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
                raise AssertionError(f"the daemon did not stop on SIGTERM: {self.stderr}") from None
