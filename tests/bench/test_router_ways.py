"""The other ways through a router: commands back to one vehicle of many, and a radio on a serial port (a pty).

Run by `make bench`; results in build/bench/router_ways.json. Nothing may be lost or go astray, whatever the time; times
are told beside those of MAVProxy (where it is installed) and, on the serial port, of a bare uvloop echo.
"""

from __future__ import annotations

import os
import shutil
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from bench.results import keep
from support import router_bench as bench
from support.pseudo_tty import PtyRadio

ROUNDS = int(os.environ.get("SKYGCS_BENCH_ROUNDS", "5"))
ECHO = "bare uvloop echo"
BACK: dict[str, Any] = {"rate": 1_000, "commands": 1_000, "seconds": 1.0, "own_sockets": 1}
SERIAL: dict[str, Any] = {"rate": 1_000, "commands": 300, "seconds": 1.0}
BAD = ("lost", "duplicates", "wrong", "corrupt")
P99_LIMIT = 2.0
"""Times the echo's, for a frame each way over the serial port."""


def mavproxy_path() -> str | None:
    return os.environ.get("SKYGCS_BENCH_MAVPROXY") or shutil.which("mavproxy.py")


def measured(target: bench.Running, load: list[str], case: dict[str, Any]) -> dict[str, float]:
    report = bench.run_load(target, load, **case)
    row = {"cpu_us": report["cpu_us"]}
    for stream in ("telemetry", "commands"):
        got = report[stream]
        row |= {f"{stream}_{key}": got[key] for key in ("p50_us", "p99_us", *BAD)}
    return row


def tell(title: str, rows: dict[str, dict[str, list[float]]]) -> dict[str, Any]:
    table = {name: {key: bench.spread(values) for key, values in row.items()} for name, row in rows.items()}
    print(f"\n{title}")
    for name, row in table.items():
        parts = [f"{name:46} {row['cpu_us']['median']:7.2f} us a frame"]
        for stream in ("telemetry", "commands"):
            p50, p99, lost, wrong = (row[f"{stream}_{key}"] for key in ("p50_us", "p99_us", "lost", "wrong"))
            told = f"lost {lost['max']:.0f}, to others {wrong['max']:.0f}"
            parts.append(f"{stream} p50/p99 {p50['median']:.0f}/{p99['median']:.0f} us, {told}")
        print("  " + "  ".join(parts))
    return table


def note(key: str, value: dict[str, Any]) -> None:
    keep("router_ways", {key: {"rounds": ROUNDS, "load_average": os.getloadavg(), **value}}, beside=True)


def all_of_ours_arrived(rows: dict[str, dict[str, list[float]]]) -> None:
    for name, row in rows.items():
        if name.startswith("skygcs"):
            assert not sum(sum(row[f"{stream}_{key}"]) for stream in ("telemetry", "commands") for key in BAD), (
                name,
                row,
            )


@pytest.mark.timeout(300)
def test_commands_back_to_one_of_twenty_vehicles(tmp_path: Path) -> None:
    load = bench.generator(tmp_path)
    routers = [
        bench.skygcs("skygcs, vehicles and recording", keep_vehicles=True, record=True, gcs=2),
        bench.skygcs("skygcs, pure Python", keep_vehicles=True, record=True, gcs=2, pure=True),
    ]
    if (found := mavproxy_path()) is not None:
        routers.append(bench.mavproxy(found, tmp_path, gcs=2))
    with ExitStack() as stack:
        targets = [stack.enter_context(bench.running(router, tmp_path, gcs=2)) for router in routers]
        for target in targets:
            bench.wait_forwarding(target, load, own_sockets=1)
        rows = bench.interleaved(ROUNDS, {t.router.name: lambda t=t: measured(t, load, BACK) for t in targets})
    note("commands back", {"table": tell("1,000/s each way, 20 vehicles on one port, 2 ground stations", rows)})
    all_of_ours_arrived(rows)


@pytest.mark.timeout(300)
def test_serial(tmp_path: Path) -> None:
    load = bench.generator(tmp_path)
    routers = [
        bench.uvloop_echo(),
        bench.skygcs("skygcs, routing only", keep_vehicles=False, record=False, serial=True),
        bench.skygcs("skygcs, vehicles and recording", keep_vehicles=True, record=True, serial=True),
    ]
    if (found := mavproxy_path()) is not None:
        routers.append(bench.mavproxy(found, tmp_path, serial=True))
    with ExitStack() as stack:
        cases = {}
        for n, router in enumerate(routers):
            radio = PtyRadio(tmp_path / f"tty{n}")
            radio.plug_in()
            stack.callback(radio.pull_out)
            target = stack.enter_context(bench.running(router, tmp_path, serial=str(radio.path)))
            bench.wait_forwarding(target, load, fd=radio.fd)
            cases[router.name] = lambda t=target, fd=radio.fd: measured(t, load, {**SERIAL, "fd": fd})
        rows = bench.interleaved(ROUNDS, cases)
    ratios = {key: bench.ratios(rows, key, ECHO) for key in ("telemetry_p99_us", "commands_p99_us", "cpu_us")}
    table = tell("serial port (pty): 1,000 frames/s in, 300 commands/s out", rows)
    for key, by_name in ratios.items():
        print(f"  {key}, times the echo's: " + ", ".join(f"{n} {r['median']:.2f}" for n, r in by_name.items()))
    note("serial", {"table": table, "ratios": ratios})
    all_of_ours_arrived(rows)
    if os.environ.get("SKYGCS_BENCH_TARGETS"):
        for key in ("telemetry_p99_us", "commands_p99_us"):
            for name, ratio in ratios[key].items():
                assert not name.startswith("skygcs") or ratio["median"] <= P99_LIMIT, (key, name, ratio)
