"""Measure MAVLink routers beside each other: any command line, one load, interleaved rounds, CPU from /proc.

The load generator and the bare forwarder are C, built on the spot.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from support.process import free_port

ROOT = Path(__file__).parents[2]
NATIVE = ROOT / "tests" / "bench" / "native"
START_S = 40.0
"""How long a router may take until it forwards."""

RUN_TIMEOUT_S = 60.0

_CPUS = sorted(os.sched_getaffinity(0))
LOAD_CPU, ROUTER_CPU = _CPUS[0], _CPUS[-1]
"""The router alone on one CPU, the generator on another; on one CPU they share it, and ratios still hold."""


def build(folder: Path, name: str) -> str:
    """A helper of tests/bench/native, compiled into ``folder`` by the C compiler that a development set-up has."""
    compiler = next((c for c in ("cc", "gcc", "clang") if shutil.which(c)), "cc")
    out = folder / name
    subprocess.run([compiler, "-O2", "-pthread", "-o", out, NATIVE / f"{name}.c"], check=True)
    return str(out)


def generator(folder: Path) -> list[str]:
    """Command line of the load generator."""
    return [build(folder, "router_load")]


def cpu_s(pid: int) -> float:
    """CPU time of a process and its children so far, all threads, to the nanosecond (schedstat)."""
    total = 0
    for one in (pid, *_children(pid)):
        for task in Path(f"/proc/{one}/task").iterdir():
            total += int((task / "schedstat").read_text().split()[0])
    return total / 1e9


def _children(pid: int) -> list[int]:
    try:
        found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return [int(c) for c in found] + [grand for c in found for grand in _children(int(c))]


def rss_mb(pid: int) -> float:
    """Resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1e6


@dataclass
class Router:
    """A router to measure. ``command``: arguments, with {vehicles} (port it listens on), {gcs} (port of the ground
    station it sends to) and {folder}; ``fleet`` is written to
    {folder}/fleet.toml first."""

    name: str
    command: list[str]
    fleet: str = ""
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass
class Running:
    """A router that is up."""

    router: Router
    process: subprocess.Popen[bytes]
    output: Path
    vehicles_port: int
    gcs_ports: list[int]


def skygcs(name: str, *, keep_vehicles: bool, record: bool, pure: bool = False, gcs: int = 1) -> Router:
    """skygcs as a router between one port of vehicles and ``gcs`` ground stations."""
    fleet = f"""
[daemon]
socket = "{{folder}}/s"
log_dir = "{{folder}}/logs"
record = {str(record).lower()}
keep_vehicles = {str(keep_vehicles).lower()}
[links.vehicles]
type = "udp_server"
host = "127.0.0.1"
port = {{vehicles}}
role = "radio"
"""
    for n in range(gcs):
        fleet += f'[links.gcs{n}]\ntype = "udp_client"\nhost = "127.0.0.1"\nport = {{gcs{n}}}\nrole = "gcs"\n'
    command = [sys.executable, "-m", "skygcs", "run", "-q", "{folder}/fleet.toml"]
    return Router(name, command, fleet, {"SKYGCS_PURE": "1"} if pure else {})


def forwarder(folder: Path) -> Router:
    """The bare forwarder."""
    return Router("bare C forwarder", [build(folder, "forwarder"), "{vehicles}", "{gcs}"])


def mavproxy(executable: str, folder: Path) -> Router:
    """MAVProxy with its output module only, as cheap as it gets."""
    command = [executable, "--master=udpin:127.0.0.1:{vehicles}", "--out=udpout:127.0.0.1:{gcs0}"]
    command += ["--default-modules=output", "--no-state", "--daemon", "--nowait"]
    return Router("MAVProxy, output module only", command, environment={"HOME": str(folder)})


@contextmanager
def running(router: Router, folder: Path, *, gcs: int = 1) -> Iterator[Running]:
    """Start a router, pinned; stop it at the end."""
    home = folder / "".join(c if c.isalnum() else "-" for c in router.name)
    home.mkdir(parents=True, exist_ok=True)
    ports = {"vehicles": free_port(), **{f"gcs{n}": free_port() for n in range(gcs)}}
    words = {**ports, "gcs": ports["gcs0"], "folder": home}
    if router.fleet:
        (home / "fleet.toml").write_text(router.fleet.format(**words))
    with (home / "out").open("wb") as out:
        process = subprocess.Popen(
            [word.format(**words) for word in router.command],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            cwd=home,
            env={**os.environ, **router.environment},
            preexec_fn=lambda: os.sched_setaffinity(0, {ROUTER_CPU}),
        )
    try:
        yield Running(router, process, home / "out", ports["vehicles"], [ports[f"gcs{n}"] for n in range(gcs)])
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(10)


def wait_forwarding(target: Running, load: list[str], **options: Any) -> None:
    """Until the router passes everything of a small load. Raises RuntimeError with what it said."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and target.process.poll() is None:
        got = run_load(target, load, rate=200, seconds=0.1, **options)["telemetry"]
        if got["received"] >= got["expected"]:
            return
    raise RuntimeError(f"{target.router.name} does not forward; it said: {target.output.read_text()[-2000:]}")


def run_load(target: Running, load: list[str], **options: Any) -> dict[str, Any]:
    """One run of the generator; its report, with the router's ``cpu_us`` per received frame and ``rss_mb`` added."""
    words = [f"{k}={v}" for k, v in options.items()]
    words += [f"to={target.vehicles_port}", "gcs=" + ",".join(map(str, target.gcs_ports))]
    pid = target.process.pid
    with subprocess.Popen(
        [*load, *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, {LOAD_CPU}),
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            if process.stdout.readline() != "ready\n":
                raise RuntimeError(f"the load generator did not start: {words}")
            before = cpu_s(pid)
            process.stdin.write("\n")
            process.stdin.flush()
            line = process.stdout.readline()
            used = cpu_s(pid) - before
            process.wait(RUN_TIMEOUT_S)
        except BaseException:
            process.kill()
            raise
    report: dict[str, Any] = json.loads(line)
    received = report["telemetry"]["received"] + report["commands"]["received"]
    report["cpu_us"] = used / max(received, 1) * 1e6
    report["rss_mb"] = rss_mb(pid)
    return report


def lossless_per_s(target: Running, load: list[str], start: float) -> float:
    """Highest step of a ladder with at most 0.1 % loss, each tried twice; 0 if not even the first."""
    best, rate = 0.0, start
    while rate < 420_000:
        for _ in range(2):
            got = run_load(target, load, rate=rate, seconds=0.4)["telemetry"]
            if got["lost"] <= 0.001 * got["expected"]:
                best = got["received"] / got["elapsed_s"] if got["elapsed_s"] else 0.0
                break
        else:
            break
        rate *= 1.15
    return best


def spread(values: list[float]) -> dict[str, float]:
    """Median, least and greatest; not a number if there are none."""
    values = values or [float("nan")]
    return {"median": round(statistics.median(values), 3), "min": round(min(values), 3), "max": round(max(values), 3)}


def interleaved(rounds: int, cases: Mapping[str, Callable[[], dict[str, float]]]) -> dict[str, dict[str, list[float]]]:
    """Run every case once per round, in turn; all figures of each by name, in the order of the rounds.

    Each round begins with another one: of two equal routers the one that always came first cost 3 % more (40 rounds).
    """
    rows: dict[str, dict[str, list[float]]] = {name: {} for name in cases}
    names = list(cases)
    for n in range(rounds):
        for name in names[n % len(names) :] + names[: n % len(names)]:
            for key, value in cases[name]().items():
                rows[name].setdefault(key, []).append(value)
    return rows


def ratios(rows: Mapping[str, Mapping[str, list[float]]], key: str, base: str) -> dict[str, dict[str, float]]:
    """Each row's figure over the base's of the same round: noise that lasts longer than a round cancels out."""
    return {
        name: spread([a / b for a, b in zip(row[key], rows[base][key], strict=True) if b])
        for name, row in rows.items()
        if key in row
    }
