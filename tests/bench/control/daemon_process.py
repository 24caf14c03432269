"""`skygcs run FILE` as it is, whose control clocks also note when each tick was due, truly began and ended.

python -m bench.control.daemon_process FILE LATENESS [PROFILE]: writes LATENESS at its end, for each tick three doubles
(due, begun, ended) on the machine's monotonic clock; with PROFILE it runs under cProfile and writes its table there.

The daemon's own lateness counts by the loop's clock, which uvloop reads once per turn and in whole milliseconds: what
one tick waits for another of the same turn is not in it. Here it is.
"""

from __future__ import annotations

import cProfile
import pstats
import sys
import time
from array import array
from pathlib import Path

from skygcs.cli import serve
from skygcs.runtime import offboard_engagement
from skygcs.runtime.loop_clock import ControlClock

ROOM = 400_000
"""Ticks noted, allocated beforehand so that the process does not seem to grow: 100 vehicles at 50 Hz for 80 s."""


class Notebook:
    """Due, begun and ended of each, in the order of the ticks."""

    def __init__(self) -> None:
        self.times = array("d", bytes(24 * ROOM))
        self.count = 0

    def add(self, due: float, begun: float, ended: float) -> None:
        if self.count < ROOM:
            at = 3 * self.count
            self.times[at], self.times[at + 1], self.times[at + 2] = due, begun, ended
            self.count += 1


NOTEBOOK = Notebook()


class NotedClock(ControlClock):
    """Otherwise the daemon's."""

    def _run(self) -> None:
        due, begun = self._due, time.monotonic()
        super()._run()
        NOTEBOOK.add(due, begun, time.monotonic())


def main() -> int:
    file, lateness = sys.argv[1:3]
    offboard_engagement.ControlClock = NotedClock  # type: ignore[misc]
    profile = cProfile.Profile() if len(sys.argv) > 3 else None
    try:
        if profile is None:
            return serve.main(["run", "--quiet", file])
        return profile.runcall(serve.main, ["run", "--quiet", file])
    finally:
        Path(lateness).write_bytes(NOTEBOOK.times[: 3 * NOTEBOOK.count].tobytes())
        if profile is not None:
            with Path(sys.argv[3]).open("w") as out:
                pstats.Stats(profile, stream=out).sort_stats("tottime").print_stats(40)


if __name__ == "__main__":
    sys.exit(main())
