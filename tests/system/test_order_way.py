"""The way of an order through the code, from its line on the socket to its frame at the link, stays short."""

from __future__ import annotations

import json
import os
import subprocess
import sys

from support.process import ROOT

MOST_CALLS = 17
"""Functions that wait for each other, or started each other's task; 15 are wanted. It is only ever lowered."""

MOST_FILES = 7
"""Files that they stand in, as many as wanted."""


def test_an_order_takes_few_calls_to_the_wire() -> None:
    line = [sys.executable, "-m", "figures.plain_daemon"]
    there = os.environ | {"PYTHONPATH": str(ROOT / "tests")}
    done = subprocess.run(line, env=there, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    assert 0 < len(found["calls"]) <= MOST_CALLS, "\n".join(" ".join(call) for call in found["calls"])
    assert len(found["call_files"]) <= MOST_FILES, found["call_files"]
