"""What the benchmarks share: parts that are measured and checked, virtual time, processor time, and build/bench, where
the figures of each are kept in a file of JSON."""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import math
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Coroutine, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import structlog

from support.virtual_asyncio import VirtualAsyncio

T = TypeVar("T")
OUT = Path(__file__).resolve().parents[2] / "build" / "bench"

Found = dict[str, Any]
Checks = list[tuple[str, bool]]
Part = tuple[Callable[[float], Found], Callable[[Found], Checks]]
"""What measures a part (given the seconds of a measurement), and (line, whether it holds) of what was found."""


def keep(name: str, figures: Mapping[str, Any], *, beside: bool = False) -> Path:
    """Write them to ``name``.json; with ``beside`` next to what an earlier run or another case has kept there."""
    path = OUT / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    known = json.loads(path.read_text()) if beside and path.is_file() else {}
    path.write_text(json.dumps({**known, **figures}, indent=1) + "\n")
    return path


def run_parts(name: str, parts: Mapping[str, Part], seconds: float) -> int:
    """The main program of a benchmark of parts: each one's lines on stdout. The exit code."""
    parser = argparse.ArgumentParser(prog=f"bench.{name}")
    parser.add_argument("--only", choices=parts)
    parser.add_argument("--seconds", type=float, default=seconds, help="of each measurement")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # a time limit, too, ends all that was started
    missed = 0
    for part, (measure, check) in parts.items():
        if options.only not in (None, part):
            continue
        print(f"{part}:", flush=True)
        found = measure(options.seconds) | {"load": os.getloadavg()[0]}
        for line, holds in check(found):
            missed += not holds
            print(f"{'ok  ' if holds else 'MISS'} {line}", flush=True)
        print(keep(name, {part: found}, beside=True))
    return 1 if missed else 0


def in_virtual_time(
    work: Callable[[Path], Coroutine[Any, Any, T]],
    loop: Callable[[], asyncio.AbstractEventLoop] = VirtualAsyncio,
) -> T:
    """Run it in a folder of its own, on a loop whose clock jumps to the next thing to do; only faults are logged."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    with tempfile.TemporaryDirectory() as folder, asyncio.Runner(loop_factory=loop) as runner:
        return runner.run(work(Path(folder)))


def cpu_s(pid: int) -> float:
    """CPU time of a process so far, without its children; 0 if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def percentile(values: Sequence[float], share: float) -> float:
    """Nearest rank: the least value that ``share`` of them do not exceed. Raises ValueError for none."""
    if not values:
        raise ValueError("no values")
    ordered = sorted(values)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]
