"""A daemon in one process, simulated vehicles in another, UDP between them, in real time."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

from bench.control.measures import Usage, percentile, usage_of
from skygcs.rpc.client import Client, connect
from support.process import free_port

ROOT = Path(__file__).parents[3]
TIMEOUT_S = 60.0
ATTEMPTS = 3
WARM_UP_S = 3.0
"""After control has begun: the position rates have changed, the delay's window is full."""
WINDOW_S = 4.0
"""The median over windows of so long is what this program does; the whole run also has what its neighbours do."""

FLEET_FILE = """
[daemon]
socket = "{folder}/s"
log_dir = "{folder}/logs"
[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0
[links.air]
type = "udp_server"
host = "127.0.0.1"
port = {port}
role = "vehicle"
max_peers = 128
[defaults]
takeoff_height_m = 6.0
[defaults.control]
rate_hz = {rate_hz}
rate_min_hz = 10
attitude_delay_s = {attitude_delay_s}
return_after_s = 1
[defaults.control.fence]
x_m = [-100, 100]
y_m = [-100, 100]
up_m = [0, 40]
"""


@dataclass(frozen=True, slots=True)
class Load:
    """What is to be carried."""

    vehicles: int
    rate_hz: float
    attitude_delay_s: float
    seconds: float = 20.0
    realtime: bool = False
    """Both processes before all others (SCHED_FIFO, root only): on a loaded machine what a quiet one would show."""
    stand_ins: bool = False
    """Vehicles of `stand_ins`, which hover where they are, instead of simulated ones, which fly to and fro."""


@dataclass(frozen=True, slots=True)
class Carried:
    """What came of it. Lateness in ms: from when a tick was due until it truly began."""

    vehicles: int
    rate_hz: float
    attitude_delay_s: float
    flown_by_attitude: int
    """At the end."""
    otherwise: list[str]
    """Why the others are not: their guards' reasons."""
    delay_p95_ms: float
    """The largest that any vehicle's guard saw at the end."""
    ticks: int
    ticks_per_s: float
    late: int
    skipped: int
    lateness_p50_ms: float
    lateness_p99_ms: float
    lateness_p99_median_ms: float
    """Median over windows of WINDOW_S."""
    lateness_max_ms: float
    tick_us: float
    """Median of what a tick took, from when it began to when the next one's timer was set, by the machine's clock: in
    it are the setpoint's system call and whatever the CPU's caches had lost since the last tick."""
    tick_p99_us: float
    loop_lateness_p99_ms: float
    """As the daemon says itself in control.status: the largest of the vehicles'."""
    cpu_percent: float
    """Of one core, the daemon's."""
    cpu_percent_median: float
    waited_percent: float
    """Of the time: the daemon was ready to run and had no CPU, which is in the lateness and not its own."""
    simulator_cpu_percent: float
    rss_begin_mb: float
    rss_middle_mb: float
    """By then what is kept of the last seconds is full; after it nothing should grow."""
    rss_end_mb: float
    load_average: float
    realtime: bool

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def carry(load: Load, folder: Path, profile: Path | None = None) -> Carried:
    """Fly the load and measure. The folder is to be empty."""
    lateness = folder / "lateness"
    port = free_port()
    (folder / "fleet.toml").write_text(
        FLEET_FILE.format(folder=folder, port=port, rate_hz=load.rate_hz, attitude_delay_s=load.attitude_delay_s)
    )
    words = [
        "bench.control.daemon_process",
        str(folder / "fleet.toml"),
        str(lateness),
        *([str(profile)] if profile else []),
    ]
    sim_words = ["skygcs", "sim", "--px4", str(load.vehicles), "--ardupilot", "0"]
    sim_words += ["--udp", f"127.0.0.1:{port}", "--separate-ports", "--gps-noise", "0.05"]
    if load.stand_ins:
        sim_words = ["bench.control.stand_ins", str(load.vehicles), str(port)]
    with _process(words, load.realtime) as daemon:
        _wait(lambda: (folder / "s").exists(), "the daemon did not come up")
        with _process(sim_words, load.realtime) as simulator:
            samples, states = asyncio.run(_fly(load, folder / "s", daemon.pid, simulator.pid))
    return _summary(load, samples, states, lateness.read_bytes())


@dataclass(frozen=True, slots=True)
class _Sample:
    at: float
    daemon: Usage
    simulator: Usage


async def _fly(
    load: Load, address: Path, daemon: int, simulator: int
) -> tuple[list[_Sample], tuple[list[dict[str, Any]], list[dict[str, Any]]]]:
    """Samples at the borders of the windows, and the control states at begin and end."""
    async with connect(address) as gcs:
        await _until(gcs, lambda states: sum(map(_knows_where, states)) == load.vehicles, "not all know where they are")
        if not load.stand_ins:
            outcomes = await gcs.takeoff("all", wait_s=30.0)
            assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
            await _until(gcs, lambda states: all(map(_hovers, states)), "not all vehicles came up")
        await _take_over(gcs)
        await asyncio.sleep(WARM_UP_S)
        before = await gcs.call("control.status", targets="all")
        samples = [_sample(daemon, simulator)]
        for n in range(round(load.seconds / WINDOW_S)):
            east_m = 2.0 if n % 2 == 0 else 0.0
            if not load.stand_ins:
                await gcs.goto("all", enu_m=[east_m, -20.0, 8.0])  # the formation, and all of it moves
            await asyncio.sleep(max(0.0, samples[-1].at + WINDOW_S - time.monotonic()))
            samples.append(_sample(daemon, simulator))
        return samples, (before, await gcs.call("control.status", targets="all"))


async def _take_over(gcs: Client) -> None:
    """All by attitude, in a few attempts: on a busy machine the guard may find one or the other too late."""
    left: list[str] | str = "all"
    for _ in range(ATTEMPTS):
        outcomes = (await gcs.call("control.set", targets=left, mode="attitude"))["outcomes"]
        left = [name for name, reported in outcomes.items() if "flown by attitude" not in reported["message"]]
        if not left:
            return


def _summary(
    load: Load, samples: list[_Sample], states: tuple[list[dict[str, Any]], list[dict[str, Any]]], noted: bytes
) -> Carried:
    times = array("d", noted)
    ticks = [(begun, 1e3 * max(0.0, begun - due)) for due, begun in zip(times[::3], times[1::3], strict=True)]
    windows = [[late for begun, late in ticks if first.at <= begun < last.at] for first, last in pairwise(samples)]
    windows = [window for window in windows if window] or [[0.0]]  # none: nobody flew, as ``ticks`` tells
    every = [late for window in windows for late in window]
    first, last = samples[0], samples[-1]
    seconds = last.at - first.at
    took_us = [
        1e6 * (ended - begun)
        for begun, ended in zip(times[1::3], times[2::3], strict=True)
        if first.at <= begun < last.at
    ] or [0.0]
    before, after = states

    def counted(key: str) -> int:
        return int(sum(state[key] for state in after) - sum(state[key] for state in before))

    def percent(of: Callable[[_Sample], float]) -> float:
        return round(100 * (of(last) - of(first)) / seconds, 1)

    cpu = [100 * (b.daemon.cpu_s - a.daemon.cpu_s) / (b.at - a.at) for a, b in pairwise(samples)]
    return Carried(
        vehicles=load.vehicles,
        rate_hz=load.rate_hz,
        attitude_delay_s=load.attitude_delay_s,
        flown_by_attitude=sum(state["control_mode"] == "attitude" for state in after),
        otherwise=sorted({"; ".join(s["reasons"]) for s in after if s["control_mode"] != "attitude"}),
        delay_p95_ms=round(1e3 * max(state["delay_p95_s"] or 0.0 for state in after), 1),
        ticks=counted("ticks"),
        ticks_per_s=round(counted("ticks") / seconds, 1),
        late=counted("late"),
        skipped=counted("skipped"),
        lateness_p50_ms=round(percentile(every, 0.5), 2),
        lateness_p99_ms=round(percentile(every, 0.99), 2),
        lateness_p99_median_ms=round(median(percentile(window, 0.99) for window in windows), 2),
        lateness_max_ms=round(max(every), 2),
        tick_us=round(percentile(took_us, 0.5), 1),
        tick_p99_us=round(percentile(took_us, 0.99), 1),
        loop_lateness_p99_ms=round(1e3 * max(state["lateness_p99_s"] or 0.0 for state in after), 2),
        cpu_percent=percent(lambda sample: sample.daemon.cpu_s),
        cpu_percent_median=round(median(cpu), 1),
        waited_percent=percent(lambda sample: sample.daemon.waited_s),
        simulator_cpu_percent=percent(lambda sample: sample.simulator.cpu_s),
        rss_begin_mb=round(first.daemon.rss_mb, 1),
        rss_middle_mb=round(samples[len(samples) // 2].daemon.rss_mb, 1),
        rss_end_mb=round(last.daemon.rss_mb, 1),
        load_average=round(os.getloadavg()[0], 2),
        realtime=load.realtime,
    )


def _sample(daemon: int, simulator: int) -> _Sample:
    return _Sample(time.monotonic(), usage_of(daemon), usage_of(simulator))


def _knows_where(state: dict[str, Any]) -> bool:
    return state["position"] is not None and state["position"]["enu_m"] is not None


def _hovers(state: dict[str, Any]) -> bool:
    """It has come up and PX4 has ended its take-off, which while it flies to its height is a change of mode to come."""
    return bool(state["position"]["enu_m"][2] > 5.0 and state["mode"] == "AUTO.LOITER")


async def _until(gcs: Client, good: Callable[[list[dict[str, Any]]], bool], what: str) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not good(await gcs.vehicles()):
        assert time.monotonic() < deadline, what
        await asyncio.sleep(0.5)


def _wait(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)


@contextmanager
def _process(words: list[str], realtime: bool) -> Iterator[subprocess.Popen[bytes]]:
    """A module of Python's; told to end at the end."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "tests")}
    command = ["chrt", "--fifo", "10"] if realtime else []
    command += [sys.executable, "-m", *words]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
