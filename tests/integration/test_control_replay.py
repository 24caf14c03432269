"""Control replay: run again on a captured flight, flight control says the same, bit for bit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.control_replay import Replay
from support.public_data import CAPTURE, public_file

SUPPORT = Path(__file__).parents[1]

OURS = {
    1: "3fa05c224ea450fe00ac3c0459eee77ca1077d084b89dac91528d405709a00c3",
    4: "65f142002b389387eea4cec5cb3038b03d29e570b0161d734924218521f54166",
}
"""SHA-256 of all messages of the first minute of our own capture, an ArduCopter and a PX4."""


def elsewhere(capture: Path, sysid: int, seconds: float) -> str:
    """The digest as another process finds it."""
    command = [sys.executable, "-m", "support.control_replay", str(capture), str(sysid), str(seconds)]
    environment = {**os.environ, "PYTHONHASHSEED": "4711", "PYTHONPATH": str(SUPPORT)}
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout.strip()


@pytest.mark.parametrize("sysid", OURS)
def test_our_own_capture_gives_what_it_gave_when_this_was_written(sysid: int) -> None:
    replay = Replay(CAPTURE.read_bytes(), sysid, 60.0)
    assert replay.names["SET_ATTITUDE_TARGET"] > 1500, replay.names
    assert replay.digest == OURS[sysid]
    assert len({packed[4:] for packed in replay.packed}) > 100, "no constant is compared (the first is the time)"


@pytest.mark.parametrize(("name", "seconds"), [("dronekit-v1-sik.tlog", 90.0), ("interop-testdata-v1.tlog", 60.0)])
def test_other_peoples_flights_give_the_same_in_another_process(name: str, seconds: float) -> None:
    capture = public_file(f"tlog/{name}")
    first, second = (Replay(capture.read_bytes(), 1, seconds) for _ in range(2))
    assert sum(first.names.values()) > 500, first.names
    assert first.packed == second.packed
    assert elsewhere(capture, 1, seconds) == first.digest
