"""Control replay: run again on a captured flight, flight control says the same, bit for bit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.control_replay import Replay
from support.public_data import CAPTURE
from support.table import each

SUPPORT = Path(__file__).parents[1]

SAMPLED = slice(150, None, 600)
"""Every twelve seconds, in the middle of a step."""

OURS = {
    1: (
        (0.9351, 0.0575, 0.2951, 0.1874, 0.45),
        (0.7213, -0.1984, -0.2259, 0.6239, 0.4567),
        (0.9368, -0.0576, -0.2951, 0.1787, 0.1),
        (0.7426, -0.0315, 0.2991, 0.5984, 0.4361),
        (0.9724, 0.0, 0.0, 0.2332, 0.9),
    ),
    4: (
        (0.7086, 0.2187, 0.2064, 0.6383, 0.4841),
        (0.9294, 0.1126, -0.2788, -0.2141, 0.1221),
        (0.7327, -0.1149, 0.2779, 0.6105, 0.2268),
        (0.9293, -0.1808, 0.2403, -0.2143, 0.3306),
        (0.7416, 0.0, 0.0, 0.6709, 0.9),
    ),
}
"""Attitude and thrust (w, x, y, z, thrust) in the first minute of our own capture, an ArduCopter and a PX4. Four
decimals and no digest of the bytes: sine and cosine differ in the last bit from one platform's libm to another's.
That the same machine says the same to the last bit is held against another process, below."""


def elsewhere(capture: Path, sysid: int, seconds: float) -> str:
    """The digest as another process finds it."""
    command = [sys.executable, "-m", "support.control_replay", str(capture), str(sysid), str(seconds)]
    environment = {**os.environ, "PYTHONHASHSEED": "4711", "PYTHONPATH": str(SUPPORT)}
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout.strip()


@each("sysid", OURS)
def test_our_own_capture_gives_what_it_gave_when_this_was_written(sysid: int) -> None:
    replay = Replay(CAPTURE.read_bytes(), sysid, 60.0)
    assert replay.names["SET_ATTITUDE_TARGET"] > 2900, replay.names
    for leaning, written in zip(replay.leanings[SAMPLED], OURS[sysid], strict=True):
        assert leaning == pytest.approx(written, abs=2e-4)
    assert len({packed[4:] for packed in replay.packed}) > 100, "no constant is compared (the first is the time)"
    assert elsewhere(CAPTURE, sysid, 60.0) == replay.digest
