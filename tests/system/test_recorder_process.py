"""The recorder in a process of its own: killed, and against a real limit of the file size."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from skygcs.tlog.reading import LogReader
from support.frames import dialect

pytestmark = pytest.mark.system

RECORDS_PER_S = 200

CHILD = """
import asyncio, resource, signal, sys, time
from pathlib import Path
from skygcs.runtime.recorder import Recorder
from support.frames import heartbeat

async def main():
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    if (limit := int(sys.argv[2])):
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    recorder = Recorder(Path(sys.argv[1]), max_bytes=10**9, max_age_s=1e9, on_event=lambda e: print(e.text, flush=True))
    task = asyncio.create_task(recorder.run())
    count = 0
    heartbeat(1)  # reads the dialect, which may take longer than what is tested
    print("begun", flush=True)
    begun = time.monotonic()
    while True:
        stamps, elapsed_s = [], time.monotonic() - begun
        # up to the limit, beyond it a second later, then so few that a new file has room however long the machine waits
        due = 300 + 100 * (elapsed_s > 1.0) + elapsed_s if limit else elapsed_s * 200
        for _ in range(int(due) - count):
            stamps.append(time.time_ns() // 1000)
            recorder.offer(heartbeat(1 + count % 250), stamps[-1])
            count += 1
        print("".join(f"{stamp}\\n" for stamp in stamps), end="", flush=True)
        await asyncio.sleep(0.005)

asyncio.run(main())
"""


def start(folder: Path, limit: int = 0) -> subprocess.Popen[str]:
    tests = Path(__file__).resolve().parents[1]
    return subprocess.Popen(
        [sys.executable, "-c", CHILD, str(folder), str(limit)],
        env={**os.environ, "PYTHONPATH": str(tests)},
        stdout=subprocess.PIPE,
        text=True,
    )


def test_kill_9_costs_at_most_the_last_second(tmp_path: Path) -> None:
    with start(tmp_path) as child:
        assert child.stdout is not None and child.stdout.readline() == "begun\n"
        offered_us = [int(child.stdout.readline())]
        while offered_us[-1] - offered_us[0] < 2_000_000:
            offered_us.append(int(child.stdout.readline()))
        child.send_signal(signal.SIGKILL)
        offered_us += [int(line) for line in child.stdout if line.endswith("\n")]
    (path,) = tmp_path.glob("*.tlog")
    reader = LogReader(path.read_bytes(), dialect())
    records = list(reader)
    assert reader.faults.skipped_bytes == 0
    assert len(records) > RECORDS_PER_S // 4
    assert offered_us[-1] - records[-1].unix_us < 1_000_000
    assert [r.unix_us for r in records] == offered_us[: len(records)]


def test_a_file_that_may_not_grow_ends_with_a_whole_record_and_recording_goes_on(tmp_path: Path) -> None:
    """RLIMIT_FSIZE cuts a write short and refuses the next, as a full disk does."""
    with start(tmp_path, limit=10_000) as child:
        assert child.stdout is not None and child.stdout.readline() == "begun\n"
        reported = (line for line in child.stdout if not line.strip().isdigit())
        assert "File too large" in next(reported)
        assert "recording again" in next(reported)
        child.send_signal(signal.SIGKILL)
    paths = list(tmp_path.glob("*.tlog"))
    assert len(paths) >= 2  # a new file has room again
    for path in paths:
        reader = LogReader(path.read_bytes(), dialect())
        assert all(r.verdict == "ok" for r in reader)
        assert reader.faults.skipped_bytes == 0
