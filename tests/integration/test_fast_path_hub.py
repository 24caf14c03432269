"""The compiled fast path changes nothing but the speed: whatever comes, hub, fleet and wires end up as without it."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from typing import Any

import pytest

from skygcs.links import fast_path
from support.fast_path import Scenario, Station
from support.fast_path_bench import AMPLE
from support.frames import dialect, frame, heartbeat
from support.process import ROOT

native = pytest.mark.skipif(
    fast_path.new_table(dialect(), recording=False) is None and not os.environ.get("SKYGCS_REQUIRE_FASTPATH"),
    reason="skygcs was installed without a compiler",
)

SCENARIOS, BATCHES = 240, 4
HANGS_S = 600.0
"""A batch takes seconds; each scenario has a watchdog of its own."""


@pytest.mark.deep
@native
@pytest.mark.parametrize("batch", range(BATCHES))
def test_whatever_comes_ends_as_without_the_fast_path(batch: int) -> None:
    """In a process of its own: a loop without an end in compiled code lets no timeout of pytest's run."""
    count = SCENARIOS // BATCHES
    command = [sys.executable, "-m", "fuzz.fast_path", "--play", "--first", str(batch * count), "--count", str(count)]
    played = subprocess.run(
        command,
        env={**os.environ, "PYTHONPATH": str(ROOT / "tests")},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=HANGS_S,
        check=False,
    )
    said = played.stdout.splitlines()
    assert played.returncode == 0, "\n".join([*said[-40:], played.stderr[-3000:]])
    counts = json.loads(said[-1])
    assert counts["scenarios"] == count
    assert (
        counts["datagrams on the fast path"] > counts["datagrams"] / 10
    )  # else this would hold of one that takes none
    assert counts["bursts of 65 frames and more"] > 20


LINKS: dict[str, dict[str, Any]] = {"air": {"role": "radio"}, "gcs0": {"role": "gcs"}, "near": {"role": "vehicle"}}


def play(steps: list[list[bytes]]) -> tuple[Station, dict[str, Any]]:
    """What becomes of datagrams of one peer; the station is closed, its objects are there."""
    scenario = Scenario(0, LINKS, keep_vehicles=True, tap=False, steps=[[(0, data) for data in step] for step in steps])
    station = Station(scenario, pure=False)
    try:
        return station, station.play(scenario)
    finally:
        station.close()


@native
def test_steady_telemetry_takes_the_fast_path() -> None:
    frames = [[heartbeat(1, seq=2 * n), frame("ATTITUDE", sysid=1, seq=2 * n + 1)] for n in range(100)]
    station, result = play([[data for pair in frames[at : at + 20] for data in pair] for at in range(0, 100, 20)])
    assert result["channels"][-1][1]["rx_frames"] == 200
    assert 0 < sum(link.left for link in station.links) < 20


@native
def test_frames_that_come_late_through_the_fast_path_are_no_loss() -> None:
    """As PX4 sends them: one of twenty comes twelve places late. And more frames than are noted of one source."""
    order = sorted(range(1200), key=lambda n: n + (12.5 if n % 20 == 7 else 0))
    datagrams = [frame("ATTITUDE", sysid=1, seq=n & 0xFF) for n in order if n % 300 != 299]
    _, result = play([[heartbeat(1, seq=255)], *(datagrams[at : at + 100] for at in range(0, 1200, 100))])
    stats = next(sources[1 << 8 | 1] for sources in result["sources"] if 1 << 8 | 1 in sources)
    assert (stats["frames"], stats["lost"]) == (1197, 3)


@native
def test_a_restarted_source_is_not_overwritten_by_what_was_gathered() -> None:
    rng = random.Random(1)
    scenario = Scenario(0, LINKS, keep_vehicles=True, tap=False, steps=[])
    station = Station(scenario, pure=False)
    try:
        for first in (0, 10):
            frames = [frame("ATTITUDE", {"time_boot_ms": rng.randrange(99)}, seq=first + n) for n in range(10)]
            scenario.steps = [[(0, heartbeat(seq=255))]] if not first else []
            scenario.steps += [[(0, raw)] for raw in frames]
            station.play(scenario)
        # these ten are gathered, and not yet counted
        station._send([(0, frame("ATTITUDE", {"time_boot_ms": 5}, seq=20 + n)) for n in range(10)])
        station.links[0]._fast_path.ready(*AMPLE)
        station.hub.statistics.restart_source(1 << 8 | 1)
        station._send([(0, frame("ATTITUDE", {"time_boot_ms": 5}, seq=n)) for n in range(100, 110)])
        station.links[0]._fast_path.ready(*AMPLE)
        station.hub.flows.take()
        stats = next(c.sources[1 << 8 | 1] for c in station.hub.channels.values() if 1 << 8 | 1 in c.sources)
        assert (stats.frames, stats.lost) == (41, 0)
    finally:
        station.close()
