"""Resident memory of a daemon with one vehicle, beside a bare interpreter with the same event loop.

Run by `make bench`; results also in build/bench/memory.json. Interleaved round by round. Bytecode is cached, as after a
first start: a daemon that has to compile itself keeps some MB more. "whole" imports its libraries with all that they
import (without `skygcs.cli.lean_imports`). The target, 50 MB, is asserted with SKYGCS_BENCH_TARGETS=1.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from bench.results import keep
from bench.test_start import Start
from support import router_bench as bench
from support.routed import heartbeat, message

ROUNDS = int(os.environ.get("SKYGCS_BENCH_ROUNDS", "5"))
SETTLE_S = 2.0
"""Of heartbeats and attitudes, before the memory is read."""

PERIOD_S = 0.02
TIMEOUT_S = 60.0
TARGET_MB = 50.0
BARE = "import asyncio, time, uvloop; print(flush=True); time.sleep(600)"
LEAN = "from skygcs.__main__ import main; main()"
WHOLE = "from skygcs.cli.serve import main; main()"
ASK = b'{"jsonrpc":"2.0","id":1,"method":"vehicles.list"}\n'


def memory_mb(pid: int) -> dict[str, float]:
    """Resident, its own share of it (PSS), and what is no file's."""
    rows = (line.split() for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:])
    kilobytes = {row[0].rstrip(":"): int(row[1]) for row in rows}
    return {name: kilobytes[key] * 1024 / 1e6 for name, key in (("rss", "Rss"), ("pss", "Pss"), ("own", "Anonymous"))}


def bare() -> dict[str, float]:
    with subprocess.Popen([sys.executable, "-c", BARE], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        figures = memory_mb(process.pid)
        process.kill()
    return figures


def daemon(start: Start, code: str) -> dict[str, float]:
    """A recording daemon that has heard one vehicle and was asked for its state."""
    process = subprocess.Popen([sys.executable, "-c", code, "run", "-q", str(start.file)], env=start.environment)
    try:
        with socket.socket(type=socket.SOCK_DGRAM) as vehicle:
            deadline = time.monotonic() + TIMEOUT_S
            while vehicles(start.socket) != 1:
                assert process.poll() is None and time.monotonic() < deadline
                vehicle.sendto(heartbeat(1), ("127.0.0.1", start.port))
                time.sleep(PERIOD_S)
            for n in range(int(SETTLE_S / PERIOD_S)):
                frame = heartbeat(1) if n % 50 == 0 else message("ATTITUDE", 1, seq=n & 0xFF, time_boot_ms=20 * n)
                vehicle.sendto(frame, ("127.0.0.1", start.port))
                time.sleep(PERIOD_S)
        return memory_mb(process.pid)
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(30)


def vehicles(path: Path) -> int:
    """How many the daemon knows; 0 while it does not listen yet."""
    with socket.socket(socket.AF_UNIX) as client:
        try:
            client.connect(str(path))
        except OSError:
            return 0
        client.sendall(ASK)
        with client.makefile("rb") as answers:
            return len(json.loads(answers.readline())["result"])


def test_memory_with_one_vehicle(tmp_path: Path) -> None:
    start = Start(tmp_path, True, {})
    with start.daemon():
        pass  # makes the caches
    rows = bench.interleaved(
        ROUNDS, {"bare": bare, "whole": lambda: daemon(start, WHOLE), "daemon": lambda: daemon(start, LEAN)}
    )
    ratios = bench.ratios(rows, "rss", "bare")
    table = {name: {key: bench.spread(values) for key, values in row.items()} for name, row in rows.items()}
    for name, row in table.items():
        figures = ", ".join(f"{key} {value['median']:.1f}" for key, value in row.items())
        print(f"\n{name}: MB {figures}; {ratios[name]['median']:.2f} times the bare interpreter")
    keep("memory", {"rounds": ROUNDS, "MB": table, "ratios": ratios})
    assert table["daemon"]["rss"]["median"] < table["whole"]["rss"]["median"]
    if os.environ.get("SKYGCS_BENCH_TARGETS"):
        assert table["daemon"]["rss"]["median"] <= TARGET_MB
