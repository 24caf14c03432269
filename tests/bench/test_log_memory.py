"""Memory and time of the tlog tools on long logs: ten times the log, the same memory.

Run by `make bench`. Results also in build/bench/log-memory.json. $SKYGCS_BENCH_LOG_MB sets the size of the longer log.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest

from bench.results import keep
from skygcs.tlog.reading import LogReader
from support.flight_log import FlightLog
from support.frames import dialect

ROOT = Path(__file__).parents[2]
LONG_MB = int(os.environ.get("SKYGCS_BENCH_LOG_MB", "100"))
GROWTH_LIMIT_MB = 40
"""A Parquet row group and a figure's points; the reader keeps a window of 64 kB."""

COMMANDS = {
    "info": ["info", "{log}", "--json"],
    "filter": ["filter", "{log}", "{out}/part.tlog", "--vehicle", "2"],
    "merge": ["merge", "{log}", "{log}", "-o", "{out}/both.tlog"],
    "split": ["split", "{log}", "-o", "{out}"],
    "csv": ["csv", "{log}", "-o", "{out}"],
    "csv-all": ["csv", "{log}", "--all", "-o", "{out}"],
    "parquet": ["csv", "{log}", "--all", "--parquet", "-o", "{out}"],
    "plot": ["plot", "{log}", "-o", "{out}/flight.png"],
}


def long_log(path: Path, megabytes: int) -> Path:
    """Nine vehicles' two minutes again and again, each time two minutes later."""
    block = FlightLog(9).content(120.0)
    cuts = [(r.offset, r.unix_us, r.raw) for r in LogReader(block, dialect())]
    with path.open("wb") as file:
        for n in range(max(megabytes * 1_000_000 // len(block), 1)):
            shift_us = n * 120_000_000
            file.write(b"".join((us + shift_us).to_bytes(8, "big") + raw for _, us, raw in cuts))
    return path


def run(arguments: list[str], folder: Path) -> tuple[float, float]:
    """(peak resident memory in MB, seconds) of one call."""
    began = time.monotonic()
    quiet = os.open(os.devnull, os.O_WRONLY)
    command = [sys.executable, "-c", "from skygcs.cli.main import main; main()", "tlog", *arguments]
    actions = [(os.POSIX_SPAWN_DUP2, quiet, 1), (os.POSIX_SPAWN_DUP2, quiet, 2)]
    pid = os.posix_spawn(sys.executable, command, os.environ, file_actions=actions)
    _, status, usage = os.wait4(pid, 0)
    os.close(quiet)
    assert os.waitstatus_to_exitcode(status) == 0, arguments
    return usage.ru_maxrss / 1024, time.monotonic() - began


@pytest.mark.parametrize("name", COMMANDS)
def test_ten_times_the_log_takes_no_more_memory(name: str, tmp_path: Path) -> None:
    reported = {}
    for megabytes in (LONG_MB // 10, LONG_MB):
        log = long_log(tmp_path / f"{megabytes}.tlog", megabytes)
        out = tmp_path / f"out{megabytes}"
        out.mkdir()
        reported[megabytes] = run([part.format(log=log, out=out) for part in COMMANDS[name]], tmp_path)
        for file in (log, *out.iterdir()):
            file.unlink()
    (short_mb, short_s), (long_mb, long_s) = reported.values()
    line = f"{name}: {short_mb:.0f} MB and {short_s:.1f} s for {LONG_MB // 10} MB of log, "
    print(f"\n{line}{long_mb:.0f} MB and {long_s:.1f} s for {LONG_MB} MB")
    note(name, {"short_rss_mb": short_mb, "short_s": short_s, "long_rss_mb": long_mb, "long_s": long_s})
    assert long_mb < short_mb + GROWTH_LIMIT_MB


def note(name: str, figures: dict[str, float]) -> None:
    keep("log-memory", {name: {k: round(v, 1) for k, v in figures.items()}}, beside=True)
