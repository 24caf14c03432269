"""The firmware against `skygcs.sim.behaviours`: what the simulator's vehicles take for true of it.

The flights are those of tests/unit/sim/test_behaviours.py. They come first: one vehicle of its own, nothing between it
and the ground station. What differs is a mistake of the table, and so of the simulator.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware.conftest import ROW
from skygcs.config.firmware import find_ardupilot
from support.behaviour_checks import CHECKS, fly
from support.behaviour_flights import get_ready, rules
from support.behaviour_rig import FirmwareRig
from support.firmware_field import available
from support.firmware_report import Report, Row

LATE_S = 1.5
"""A firmware, its link and the station on one busy machine."""

MINUTES = {
    "position and velocity",
    "ground station lost",
    "beyond the fence",
    "returns",
    "gps lost",
    "battery critical",
    "circle",
    "velocity then silence",
    "attitude targets",
    "attitude then silence",
    "answers in flight",
}
"""Flights of a minute, on a busy computer."""

OF_4_7 = ("mode 0xd entered: True", "quaternion of length 1.01: ")
"""Where an ArduCopter 4.7 differs from the table, which is 4.6's: its simulator's build has SPORT (config.h), and an
attitude that is no rotation has GUIDED begin anew, level, instead of being passed over
(GCS_MAVLink_Copter.cpp, handle_message_set_attitude_target)."""


@pytest.fixture(scope="module")
def rig(
    request: pytest.FixtureRequest, report: Report, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[FirmwareRig]:
    firmware = request.config.getoption("--firmware")
    if firmware not in available():
        pytest.skip(f"no binary of {firmware} is named; `make test-firmware` says what to set")
    folder: Path = tmp_path_factory.mktemp("behaviours")
    began = time.monotonic()
    flown = FirmwareRig(firmware, folder)
    try:
        get_ready(flown)
        row = Row("start of the vehicle for the table", "passed", time.monotonic() - began)
        row.figures = {"ready s": round(flown.now, 1), "the table says s": rules(flown).ready_after_s.value}
        report.add(row)
        yield flown
    finally:
        flown.close()


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.minutes] if n in MINUTES else [], id=n) for n in CHECKS]
)
def test_the_firmware_does_what_the_table_says(
    name: str, rig: FirmwareRig, report: Report, request: pytest.FixtureRequest
) -> None:
    row = Row(request.node.nodeid.rpartition("/")[2])
    request.node.stash[ROW] = row
    began = time.monotonic()
    try:
        get_ready(rig)
        row.figures, problems = fly(name, rig, late_s=LATE_S)
        if rig.firmware == "ardupilot" and b"ArduCopter V4.7" in find_ardupilot("ardupilot").binary.read_bytes():
            problems = [problem for problem in problems if not problem.startswith(OF_4_7)]
        assert not problems, "; ".join(problems)
    finally:
        row.seconds = time.monotonic() - began
        report.add(row)
