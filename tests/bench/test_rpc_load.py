"""What the RPC server costs: CPU of its process, beside what was delivered. Times are shown, not asserted."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]


class ServerProcess:
    def __init__(self, socket: Path, process: subprocess.Popen[str]) -> None:
        self.socket, self.process = socket, process

    def cpu_s(self) -> float:
        """User and system time so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def server(folder: Path, vehicles: int) -> Iterator[ServerProcess]:
    socket = folder / "s.sock"
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'tests'}:{ROOT / 'tests' / 'bench'}"}
    command = [sys.executable, "-m", "rpc_server_process", str(socket), str(vehicles)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdin and process.stdout
    try:
        while process.stdout.readline().strip() != "ready":
            assert process.poll() is None
        yield ServerProcess(socket, process)
    finally:
        process.stdin.close()
        process.wait(10)
        process.stdout.close()


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


def test_small_calls_from_one_client(tmp_path: Path) -> None:
    with server(tmp_path, 3) as process:
        for window in (1, 32):
            before, count = process.cpu_s(), 20_000 // window * window
            took = asyncio.run(calls(process.socket, count, window))
            cpu = process.cpu_s() - before
            print(f"\n{window:>3} at a time: {count / took:,.0f} calls/s, server {cpu / count * 1e6:.1f} us CPU a call")


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


def test_twenty_subscribers_at_ten_hertz_to_fifty_vehicles(tmp_path: Path) -> None:
    with server(tmp_path, 50) as process:
        for count in (1, 20):
            before, began = process.cpu_s(), time.perf_counter()
            told = asyncio.run(subscribers(process.socket, count, 10.0, 5.0))
            share = (process.cpu_s() - before) / (time.perf_counter() - began)
            print(f"\n{count:>3} subscribers: {told / 5:,.0f} updates/s, server {100 * share:.1f} % of a core")
            assert told > 0.8 * count * 50 * 10 * 5
