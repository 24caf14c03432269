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
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from bench.control.figures import Section
from bench.control.measures import Usage, usage_of
from bench.results import percentile
from skygcs.rpc.client import Client, connect
from support.process import free_port

ROOT = Path(__file__).parents[3]
TIMEOUT_S = 60.0
ATTEMPTS = 3
WARM_UP_S = 3.0
"""After control has begun: the position rates have changed, the delay's window is full."""

WINDOW_S = 4.0
"""The median over windows of so long is what this program does; the whole run also has what its neighbours do."""

LATENESS_P99_MS = 5.0
GROWTH_MB = 3.0
"""In the second half of a run: 10 s. The recorder's buffers and the allocator's own steps are less."""

BUSY_PERCENT = 5.0
"""Of the time waited for a CPU: above this lateness is the machine's as much as the daemon's, and is not judged."""

MOST_CPU_PERCENT = {10: 60.0, 100: 100.0}
"""By the number of vehicles, at 50 Hz each: the loads that have targets, of lateness as well."""

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

States = list[dict[str, Any]]


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


class _Sample(NamedTuple):
    at: float
    daemon: Usage
    simulator: Usage


def carry(load: Load, folder: Path, profile: Path | None = None) -> Section:
    """Fly the load and measure. The folder is to be empty."""
    lateness = folder / "lateness"
    port = free_port()
    (folder / "fleet.toml").write_text(
        FLEET_FILE.format(folder=folder, port=port, rate_hz=load.rate_hz, attitude_delay_s=load.attitude_delay_s)
    )
    words = ["bench.control.daemon_process", str(folder / "fleet.toml"), str(lateness)]
    words += [str(profile)] if profile else []
    sim_words = ["skygcs", "sim", "--px4", str(load.vehicles), "--ardupilot", "0"]
    sim_words += ["--udp", f"127.0.0.1:{port}", "--separate-ports", "--gps-noise", "0.05"]
    if load.stand_ins:
        sim_words = ["bench.control.stand_ins", str(load.vehicles), str(port)]
    with _process(words, load.realtime) as daemon:
        _wait(lambda: (folder / "s").exists(), "the daemon did not come up")
        with _process(sim_words, load.realtime) as simulator:
            samples, before, after = asyncio.run(_fly(load, folder / "s", daemon.pid, simulator.pid))
    return _section(load, samples, before, after, array("d", lateness.read_bytes()))


async def _fly(load: Load, address: Path, daemon: int, simulator: int) -> tuple[list[_Sample], States, States]:
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
        return samples, before, await gcs.call("control.status", targets="all")


async def _take_over(gcs: Client) -> None:
    """All by attitude, in a few attempts: on a busy machine the guard may find one or the other too late."""
    left: list[str] | str = "all"
    for _ in range(ATTEMPTS):
        outcomes = (await gcs.call("control.set", targets=left, mode="attitude"))["outcomes"]
        left = [name for name, reported in outcomes.items() if "flown by attitude" not in reported["message"]]
        if not left:
            return


def _section(load: Load, samples: list[_Sample], before: States, after: States, noted: array[float]) -> Section:
    """The table, and what missed its target though the machine was quiet. ``noted``: of each tick when it was due, when
    it truly began and when it ended."""
    ticks = list(zip(noted[::3], noted[1::3], noted[2::3], strict=True))
    first, last = samples[0], samples[-1]
    windows = [
        [1e3 * max(0.0, begun - due) for due, begun, _ in ticks if a.at <= begun < b.at] for a, b in pairwise(samples)
    ]
    windows = [window for window in windows if window] or [[0.0]]  # none: nobody flew, as the ticks tell
    every = [late for window in windows for late in window]
    took_us = [1e6 * (ended - begun) for _, begun, ended in ticks if first.at <= begun < last.at] or [0.0]
    seconds = last.at - first.at
    by_attitude = sum(state["control_mode"] == "attitude" for state in after)
    p99_ms = median(percentile(window, 0.99) for window in windows)
    memory_mb = [sample.daemon.rss_mb for sample in (first, samples[len(samples) // 2], last)]

    def counted(key: str) -> int:
        return int(sum(state[key] for state in after) - sum(state[key] for state in before))

    def percent(of: Callable[[_Sample], float]) -> float:
        return 100 * (of(last) - of(first)) / seconds

    def most_ms(key: str) -> float:
        return 1e3 * max(state[key] or 0.0 for state in after)

    cpu, waited = percent(lambda s: s.daemon.cpu_s), percent(lambda s: s.daemon.waited_s)
    name = f"{load.vehicles} vehicles at {load.rate_hz:g} Hz"
    section = Section(
        f"fleet_{load.vehicles}_at_{load.rate_hz:g}_hz",
        f"{name} of attitude each, UDP, real time (attitude_delay_s {load.attitude_delay_s:g})",
    )
    priority = "real-time" if load.realtime else "usual"
    section.rows = [
        ("flown by attitude at the end", f"{by_attitude} of {load.vehicles}"),
        ("ticks per second", f"{counted('ticks') / seconds:.1f} of {load.vehicles * load.rate_hz:g}"),
        ("skipped, late ticks", f"{counted('skipped')}, {counted('late')}"),
        ("lateness p50 / p99 / max, ms", _figures(percentile(every, 0.5), percentile(every, 0.99), max(every))),
        ("p99, median of 4 s windows, ms", _figures(p99_ms)),
        ("a tick takes p50 / p99, µs", _figures(percentile(took_us, 0.5), percentile(took_us, 0.99))),
        ("p99 by the loop's clock, ms", _figures(most_ms("lateness_p99_s"))),
        ("delay p95, ms", _figures(most_ms("delay_p95_s"))),
        ("daemon's CPU, % of one core", _figures(cpu)),
        ("simulator's CPU", _figures(percent(lambda s: s.simulator.cpu_s))),
        ("daemon waited for a CPU, % of time", f"{waited:.1f} (load {os.getloadavg()[0]:.1f}, {priority} priority)"),
        ("memory at first, middle, last, MB", _figures(*memory_mb)),
    ]
    if waited > BUSY_PERCENT:
        section.remarks.append("The machine is busy with other things: lateness is shown, not judged.")
    elif by_attitude < load.vehicles:
        why = sorted({"; ".join(s["reasons"]) for s in after if s["control_mode"] != "attitude"})
        section.missed.append(f"{name}: only {by_attitude} flown by attitude at the end: {why}")
    if load.vehicles in MOST_CPU_PERCENT:
        section.judge("lateness p99, ms", p99_ms if waited <= BUSY_PERCENT else 0.0, LATENESS_P99_MS)
        section.judge("% of a core", cpu, MOST_CPU_PERCENT[load.vehicles])
    section.judge("growth of memory, MB", memory_mb[2] - memory_mb[1], GROWTH_MB)
    return section


def _figures(*values: float) -> str:
    return " / ".join(f"{value:.2f}" for value in values)


def _sample(daemon: int, simulator: int) -> _Sample:
    return _Sample(time.monotonic(), usage_of(daemon), usage_of(simulator))


def _knows_where(state: dict[str, Any]) -> bool:
    return state["position"] is not None and state["position"]["enu_m"] is not None


def _hovers(state: dict[str, Any]) -> bool:
    """It has come up and PX4 has ended its take-off, which while it flies to its height is a change of mode to come."""
    return bool(state["position"]["enu_m"][2] > 5.0 and state["mode"] == "AUTO.LOITER")


async def _until(gcs: Client, good: Callable[[States], bool], what: str) -> None:
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
