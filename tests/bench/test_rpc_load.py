"""What the RPC server costs: CPU of the daemon, beside what was delivered. Times are shown, not asserted.

Run by `make bench`; results also in build/bench/rpc.json. Targets: 5,000 small calls a second from one client; 20
subscribers at 10 Hz to 50 vehicles in a quarter of a core.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from bench.results import keep
from support import router_bench as bench
from support.process import wait_until

VEHICLES, RATE_HZ, SECONDS = 50, 10.0, 5.0


async def calls(socket: Path, count: int, window: int) -> float:
    """Small calls, ``window`` of them under way at a time; seconds."""
    reader, writer = await asyncio.open_unix_connection(str(socket))
    line = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "daemon.info"}).encode() + b"\n"
    began = time.perf_counter()
    for _ in range(count // window):
        writer.write(line * window)
        for _ in range(window):
            assert b'"result"' in await reader.readline()
    took = time.perf_counter() - began
    writer.close()
    return took


@contextmanager
def daemon_of(folder: Path, vehicles: int) -> Iterator[tuple[bench.Running, Path, list[str]]]:
    """A daemon that hears ``vehicles``, its socket and the load generator. It forwards before it listens to clients."""
    load, socket = bench.generator(folder), folder / "rpc" / "s"
    with bench.running(bench.skygcs("rpc", keep_vehicles=True, record=False), folder) as daemon:
        bench.wait_forwarding(daemon, load, vehicles=vehicles)
        wait_until(socket.exists, "the daemon listens to clients")
        yield daemon, socket, load


def test_small_calls_from_one_client(tmp_path: Path) -> None:
    with daemon_of(tmp_path, 3) as (daemon, socket, _):
        for window in (1, 32):
            before, count = bench.cpu_s(daemon.process.pid), 20_000 // window * window
            took = asyncio.run(calls(socket, count, window))
            cpu = bench.cpu_s(daemon.process.pid) - before
            print(f"\n{window:>3} at a time: {count / took:,.0f} calls/s, daemon {cpu / count * 1e6:.1f} us CPU a call")
            note(f"calls, {window} at a time", {"per_s": count / took, "daemon_us": cpu / count * 1e6})


async def subscribers(socket: Path, count: int, rate_hz: float, seconds: float) -> int:
    """Notifications that ``count`` clients got together; they only count lines."""
    told = 0

    async def one() -> None:
        nonlocal told
        reader, writer = await asyncio.open_unix_connection(str(socket))
        params = {"topic": "telemetry", "rate_hz": rate_hz}
        writer.write(json.dumps({"jsonrpc": "2.0", "id": 1, "method": "subscribe", "params": params}).encode() + b"\n")
        try:
            while True:
                lines = (await reader.read(1 << 20)).count(b"\n")
                told += lines
        finally:
            writer.close()

    tasks = [asyncio.create_task(one()) for _ in range(count)]
    await asyncio.sleep(seconds)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    return told


@pytest.mark.parametrize("frames_per_s", [0, 1500])
def test_twenty_subscribers_at_ten_hertz_to_fifty_vehicles(tmp_path: Path, frames_per_s: int) -> None:
    """With telemetry: what every subscriber is told has changed since the last time, and is unpacked anew."""
    with daemon_of(tmp_path, VEHICLES) as (daemon, socket, load):
        shares = {}
        for count in (0, 1, 20):
            began, before = time.perf_counter(), bench.cpu_s(daemon.process.pid)
            with ThreadPoolExecutor() as pool:
                if frames_per_s:
                    options = {"vehicles": VEHICLES, "rate": frames_per_s, "seconds": SECONDS}
                    pool.submit(bench.run_load, daemon, load, **options)
                told = asyncio.run(subscribers(socket, count, RATE_HZ, SECONDS))
                shares[count] = (bench.cpu_s(daemon.process.pid) - before) / (time.perf_counter() - began)
            share = f"daemon {100 * shares[count]:.1f} % of a core"
            print(f"\n{count:>3} subscribers, {frames_per_s} frames/s: {told / SECONDS:,.0f} updates/s, {share}")
            assert told >= 0.8 * count * VEHICLES * RATE_HZ * SECONDS
    note(f"subscribers, {frames_per_s} frames/s", {f"{count} subscribers": share for count, share in shares.items()})


def note(name: str, figures: dict[str, float]) -> None:
    keep("rpc", {name: {k: round(v, 3) for k, v in figures.items()}}, beside=True)
