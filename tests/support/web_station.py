"""A real daemon with simulated vehicles and a real `skygcs web`, as processes, for browser tests and benchmarks."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from skygcs.web.control_socket import ask_for_link, find_control
from skygcs.web.sign_in import Role
from support.hanging import HANG_S
from support.process import free_port
from support.system_programs import PROGRAMS, path_of

READY_S = 60.0

FLEET = """
[daemon]
socket = "gcs.sock"
log_dir = "logs"
{daemon}
[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0

{links}
{more}
"""

LINK = """[links.{name}]
type = "simulated"
role = "{role}"
px4 = {px4}
ardupilot = {ardupilot}
first_sysid = {first_sysid}
dynamics = "kinematic"
"""


def command(*arguments: str) -> list[str]:
    """`skygcs ARGUMENTS` of this checkout."""
    return [sys.executable, "-m", "skygcs", *arguments]


class WebStation:
    """`start`, use, `close`. Everything is in ``folder``; the processes' logs are daemon.log and web.log there.

    ``daemon`` is TOML for [daemon], ``more`` for the end of the fleet file, ``web`` further options of `skygcs web`.
    Without ``vehicles`` (px4, ardupilot) there is no daemon: a replay, or one that comes later by `start_daemon`.
    """

    def __init__(
        self,
        folder: Path,
        vehicles: tuple[int, int] | None = (2, 1),
        *,
        daemon: str = "",
        links: str | None = None,
        more: str = "",
        web: tuple[str, ...] = (),
        role: str = "vehicle",
    ) -> None:
        self.folder = folder
        self.socket_path = folder / "gcs.sock"
        self.port = 0
        self.vehicles_port = 0
        """Where vehicles that come over UDP send to, if there is such a link."""
        self.daemon_process: subprocess.Popen[bytes] | None = None
        self.web_process: subprocess.Popen[bytes] | None = None
        self._vehicles = vehicles
        self._web = web
        px4, ardupilot = vehicles or (1, 0)
        own = (
            LINK.format(name="sim", role=role, px4=px4, ardupilot=ardupilot, first_sysid=1) if links is None else links
        )
        self.fleet_file = folder / "fleet.toml"
        self.fleet_file.write_text(FLEET.format(daemon=daemon, links=own, more=more))
        self._environment = os.environ | {
            "XDG_CACHE_HOME": str(folder / "cache"),
            "XDG_STATE_HOME": str(folder / "state"),
        }

    def start(self) -> WebStation:
        """Start both and wait until the vehicles are there."""
        try:
            if self._vehicles is not None:
                self.start_daemon()
            self.start_web()
        except BaseException:
            self.close()
            raise
        return self

    def start_daemon(self) -> None:
        """Start the daemon, and wait for its vehicles."""
        self.daemon_process = self._start("daemon.log", command("run", str(self.fleet_file)), session=True)
        wanted = sum(self._vehicles or (1, 0))
        self._wait("vehicles", lambda: len(self.call("vehicles.list")) >= wanted)

    def start_web(self) -> None:
        """Start the web process on the port it had, or a free one."""
        arguments = [
            "web",
            "--no-open",
            "--port",
            str(self.port or free_port(socket.SOCK_STREAM)),
            "--socket",
            str(self.socket_path),
        ]
        self.port = int(arguments[3])
        self.web_process = self._start("web.log", command(*arguments, *self._web))
        self._wait("web page", lambda: find_control(str(self.socket_path), self.port) is not None)

    def _start(self, log: str, line: list[str], *, session: bool = False) -> subprocess.Popen[bytes]:
        with open(self.folder / log, "ab") as file:
            return subprocess.Popen(
                line, stdout=file, stderr=file, cwd=self.folder, env=self._environment, start_new_session=session
            )

    def _wait(self, what: str, condition: Any) -> None:
        deadline = time.monotonic() + READY_S
        while True:
            try:
                if condition():
                    return
            except Exception as error:
                problem: object = error
            else:
                problem = "not yet"
            processes = [p for p in (self.daemon_process, self.web_process) if p is not None]
            if time.monotonic() > deadline or any(p.poll() is not None for p in processes):
                raise AssertionError(f"no {what}: {problem}\n{self.logs()}")
            time.sleep(0.05)

    # -- use

    @property
    def base(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def address(self, role: Role = "command") -> str:
        """A fresh address with its token."""
        return ask_for_link(find_control(str(self.socket_path), self.port), role)

    def call(self, method: str, /, **params: Any) -> Any:
        """One request to the daemon itself, blocking; asserts that it is answered without an error."""
        with socket.socket(socket.AF_UNIX) as sock:
            sock.settimeout(HANG_S)
            sock.connect(str(self.socket_path))
            sock.sendall(json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode() + b"\n")
            answer = json.loads(sock.makefile("rb").readline())
        assert "error" not in answer, answer
        return answer["result"]

    def logs(self) -> str:
        """The end of both logs."""
        texts = [(self.folder / name) for name in ("daemon.log", "web.log")]
        return "\n".join(f"{path.name}:\n{path.read_text()[-3000:]}" for path in texts if path.exists())

    # -- the end

    def stop_daemon(self, number: int = signal.SIGTERM) -> None:
        _end(self.daemon_process, number)
        self.daemon_process = None

    def stop_web(self, number: int = signal.SIGTERM) -> None:
        _end(self.web_process, number)
        self.web_process = None

    def close(self) -> None:
        self.stop_web()
        self.stop_daemon()


def _end(process: subprocess.Popen[bytes] | None, number: int) -> None:
    if process is None:
        return
    process.send_signal(number)
    try:
        process.wait(timeout=HANG_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def chromium() -> str | None:
    """The system's Chromium; None: it is not installed."""
    return path_of(next(iter(PROGRAMS["test-web"])))


def chromium_options() -> list[str]:
    """Without its sandbox only as root, which Chromium's sandbox refuses."""
    options = ["--disable-dev-shm-usage", "--mute-audio"]
    return [*options, "--no-sandbox"] if os.geteuid() == 0 else options
