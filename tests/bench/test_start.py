"""From exec to the first forwarded frame, and to the answer of `skygcs-cli status`.

Run by `make bench`; results also in build/bench/start.json. A frame is sent to the daemon every 5 ms until it comes
out at the ground station's. CPU is the daemon's until then, which tells more than seconds on a busy machine. All
modules are compiled already, as after any first start; "ours not compiled" is a checkout that is run with
PYTHONDONTWRITEBYTECODE, or belongs to somebody else: skygcs from its source, everything below from bytecode.
Targets: 0.6 s to the first frame, 0.35 s for a status; asserted with SKYGCS_BENCH_TARGETS=1, on a machine of one's own.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from bench.results import keep
from support import router_bench as bench
from support.process import free_port
from support.routed import heartbeat, message

ROUNDS = int(os.environ.get("SKYGCS_BENCH_STARTS", "15"))
PERIOD_S = 0.005
TIMEOUT_S = 20.0
ATTITUDES = [message("ATTITUDE", 1, seq=n & 0xFF, time_boot_ms=5 * n) for n in range(int(TIMEOUT_S / PERIOD_S))]
"""Each another one: a frame that came before the ground station's link was up is a duplicate when it comes again."""

Environment = Mapping[str, str]
FIRST_FRAME_S, STATUS_S = 0.6, 0.35
CASES: dict[str, tuple[bool, Environment]] = {
    "recording": (True, {}),
    "not recording": (False, {}),
    "recording, pure Python": (True, {"SKYGCS_PURE": "1"}),
    "recording, ours not compiled": (True, {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONPYCACHEPREFIX": ""}),
}


def environment(folder: Path, changes: Environment) -> dict[str, str]:
    """Ours, with bytecode and dialects cached below ``folder``."""
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return {**kept, "PYTHONPYCACHEPREFIX": str(folder / "bytecode"), "XDG_CACHE_HOME": str(folder / "cache"), **changes}


class Start:
    """A fleet file between two UDP ports, to be started again and again."""

    def __init__(self, folder: Path, record: bool, changes: Environment) -> None:
        self.folder = folder
        self.environment = environment(folder, changes)
        self.port, self.gcs = free_port(), free_port()
        self.file = folder / "fleet.toml"
        self.socket = folder / "s"
        self.file.write_text(f"""
[daemon]
socket = "{self.socket}"
log_dir = "{folder}/logs"
record = {str(record).lower()}
[links.vehicles]
type = "udp_server"
host = "127.0.0.1"
port = {self.port}
role = "vehicle"
[links.gcs]
type = "udp_client"
host = "127.0.0.1"
port = {self.gcs}
role = "gcs"
""")

    @contextmanager
    def daemon(self) -> Iterator[tuple[float, float]]:
        """(seconds, CPU seconds) until the first frame came out; the daemon runs until the end of the body."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gcs, socket.socket(type=socket.SOCK_DGRAM) as vehicle:
            gcs.bind(("127.0.0.1", self.gcs))
            gcs.settimeout(PERIOD_S)
            began = time.perf_counter()
            command = [sys.executable, "-m", "skygcs", "run", "-q", str(self.file)]
            process = subprocess.Popen(command, env=self.environment)
            try:
                frames = iter(ATTITUDES)
                while not self._came_out(next(frames), vehicle, gcs):
                    assert process.poll() is None
                took = time.perf_counter() - began
                yield took, bench.cpu_s(process.pid)
            finally:
                process.send_signal(signal.SIGTERM)
                process.wait(10)

    def _came_out(self, frame: bytes, vehicle: socket.socket, gcs: socket.socket) -> bool:
        vehicle.sendto(frame, ("127.0.0.1", self.port))
        try:
            return gcs.recv(2048) in ATTITUDES
        except TimeoutError:
            return False


@pytest.mark.parametrize("name", CASES)
def test_the_first_frame(name: str, tmp_path: Path) -> None:
    start = Start(tmp_path, *CASES[name])
    with start.daemon():
        pass  # makes the caches
    took, cpu = [], []
    for _ in range(ROUNDS):
        with start.daemon() as (seconds, cpu_seconds):
            took.append(seconds)
            cpu.append(cpu_seconds)
    tell(f"first frame, {name}", took, cpu)
    if os.environ.get("SKYGCS_BENCH_TARGETS") and "compiled" not in name:
        assert min(took) < FIRST_FRAME_S


@pytest.mark.parametrize("arguments", [["status"], ["status", "--json"]], ids=" ".join)
@pytest.mark.parametrize("name", ["compiled", "ours not compiled"])
def test_a_status(name: str, arguments: list[str], tmp_path: Path) -> None:
    start = Start(tmp_path, False, {})
    changes = CASES["recording, ours not compiled"][1] if name == "ours not compiled" else {}
    command = [str(Path(sys.executable).with_name("skygcs-cli")), "--socket", str(start.socket), *arguments]
    took, cpu = [], []
    with start.daemon(), socket.socket(type=socket.SOCK_DGRAM) as fleet:
        deadline = time.monotonic() + TIMEOUT_S
        while not start.socket.exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        for sysid in range(1, 11):
            fleet.sendto(heartbeat(sysid), ("127.0.0.1", start.port))
        for n in range(ROUNDS + 1):
            seconds, cpu_seconds = answered(command, environment(tmp_path, changes))
            if n:
                took.append(seconds)
                cpu.append(cpu_seconds)
    tell(f"skygcs-cli {' '.join(arguments)}, {name}", took, cpu)
    if os.environ.get("SKYGCS_BENCH_TARGETS") and name == "compiled":
        assert min(took) < STATUS_S


def answered(command: list[str], env: Environment) -> tuple[float, float]:
    """(seconds, CPU seconds) of one call."""
    with Path(os.devnull).open("wb") as quiet:
        began = time.perf_counter()
        process = subprocess.Popen(command, env=dict(env), stdout=quiet)
        _, status, usage = os.wait4(process.pid, 0)
        took = time.perf_counter() - began
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    return took, usage.ru_utime + usage.ru_stime


def tell(name: str, took: list[float], cpu: list[float]) -> None:
    figures = {"seconds": bench.spread(took), "cpu_s": bench.spread(cpu), "starts": ROUNDS}
    wall = figures["seconds"]
    print(f"\n{name}: {wall['median']:.3f} s (least {wall['min']:.3f}), CPU {figures['cpu_s']['min']:.3f} s")
    keep("start", {name: figures}, beside=True)
