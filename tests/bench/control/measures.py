"""What is read off a track, a table of times, or a process: all pure but for `usage_of`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

SETTLED_WITHIN = 0.05
"""Share of the step around its end; the usual 5 % band."""


def overshoot_percent(track_m: Sequence[float], step_m: float) -> float:
    """How far it went beyond a step from 0, in percent of the step."""
    most = max(position / step_m for position in track_m)
    return max(0.0, 100.0 * (most - 1.0))


def within_s(track_m: Sequence[float], end_m: float, off_m: float, period_s: float) -> float | None:
    """From when on it stayed within ``off_m`` of its end; None if it was outside in the last tenth of the track."""
    outside = [n for n, position in enumerate(track_m) if abs(position - end_m) > off_m]
    if not outside:
        return 0.0
    return (outside[-1] + 1) * period_s if outside[-1] < 0.9 * (len(track_m) - 1) else None


def settling_s(track_m: Sequence[float], step_m: float, period_s: float) -> float | None:
    """From when on it stayed within 5 % of a step from 0; None if it has not settled."""
    return within_s(track_m, step_m, SETTLED_WITHIN * abs(step_m), period_s)


def swing_m(track_m: Sequence[float], last_s: float, period_s: float) -> float:
    """Peak to peak over the last seconds."""
    last = track_m[-max(1, round(last_s / period_s)) :]
    return max(last) - min(last)


@dataclass(frozen=True, slots=True)
class Usage:
    """What a process has used so far, and how much memory it holds."""

    cpu_s: float
    """On a CPU, all threads, to the nanosecond."""
    waited_s: float
    """Runnable, but the CPUs were busy with others: what a loaded machine adds to every lateness."""
    rss_mb: float


def usage_of(pid: int) -> Usage:
    """Linux only. Threads that have ended are not counted; neither the daemon nor the simulator ends any."""
    ran = waited = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        on_cpu, in_queue, _ = (task / "schedstat").read_text().split()
        ran += int(on_cpu)
        waited += int(in_queue)
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return Usage(ran / 1e9, waited / 1e9, pages * os.sysconf("SC_PAGE_SIZE") / 1e6)
