"""The harness of the flights with real firmware, without firmware."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from support.firmware_report import Report, Row
from support.process import ROOT, wait_until
from support.udp_relay import Truth, UdpRelay, metres


def heartbeat(sysid: int, armed: bool, custom_mode: int) -> bytes:
    sender = mav.MAVLink(None, srcSystem=sysid, srcComponent=1)
    base = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mav.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    return bytes(sender.heartbeat_encode(2, 3, base, custom_mode, 4).pack(sender))


@pytest.mark.deep  # starts a process
def test_without_binaries_the_suite_says_what_to_install() -> None:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("SKYGCS_")}
    environment["PYTHONPATH"] = str(ROOT / "tests")
    words = [sys.executable, "-m", "firmware"]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, cwd=ROOT, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert "SKYGCS_PX4" in done.stdout
    assert "SKYGCS_ARDUCOPTER" in done.stdout
    assert "waf copter" in done.stdout


@pytest.mark.deep  # starts a process
def test_a_binary_that_is_not_there_fails_the_suite(tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("SKYGCS_")}
    environment |= {"PYTHONPATH": str(ROOT / "tests"), "SKYGCS_PX4": str(tmp_path / "no")}
    words = [sys.executable, "-m", "firmware"]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, cwd=ROOT, timeout=120, check=False)
    assert done.returncode == 1
    assert "is not there" in done.stdout


def test_the_report_is_json_and_a_table(tmp_path: Path) -> None:
    report = Report(tmp_path, "px4", "short")
    report.version = "1.16.1"
    row = Row(
        "test_x", "passed", 3.25, {"RMS m": 0.12345, "Hz": {"a": 5.0}}, {"px11": ["LOITER", "RTL"], "px12": ["LOITER"]}
    )
    report.add(row)
    report.add(Row("test_y", "failed", 1.0, reason="it fell"))
    whole = json.loads(report.file("json").read_text())
    assert [r["outcome"] for r in whole["rows"]] == ["passed", "failed"]
    assert whole["rows"][0]["figures"]["RMS m"] == 0.12345
    table = report.file("txt").read_text()
    assert "RMS m 0.123, Hz {a 5}" in table
    assert "px11: LOITER > RTL" in table
    assert report.file("json").name.endswith("-px4-1.16.1-short.json")
    assert "px12" not in table
    assert "1 failed, 1 passed" in table


def test_the_truth_keeps_modes_and_forgets_other_components() -> None:
    truth = Truth(7)
    reader = mav.MAVLink(None)
    for at, (armed, mode) in enumerate([(False, 4), (True, 4), (True, 17), (True, 17)]):
        for message in reader.parse_buffer(heartbeat(7, armed, mode)):
            truth.on_message(message, float(at))
    assert truth.armed
    assert truth.modes == [(0.0, "GUIDED"), (2.0, "BRAKE")]
    assert truth.modes_since(1.0) == ["GUIDED", "BRAKE"]
    assert truth.modes_since(2.5) == ["BRAKE"]
    assert metres(43.0, 8.0, 43.0001, 8.0) == pytest.approx(11.13, abs=0.01)


def test_the_relay_passes_cuts_and_delays() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as daemon,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
    ):
        daemon.bind(("127.0.0.1", 0))
        daemon.settimeout(0.2)
        vehicle.bind(("127.0.0.1", 0))
        vehicle.settimeout(5)
        relay = UdpRelay(daemon.getsockname()[1])
        relay.start()
        try:
            sent = heartbeat(7, True, 4)
            vehicle.sendto(sent, ("127.0.0.1", relay.port))
            daemon.settimeout(5)
            data, peer = daemon.recvfrom(1000)
            assert data == sent
            daemon.sendto(b"up", peer)
            assert vehicle.recv(100) == b"up"
            relay.cut_down = {7}
            vehicle.sendto(heartbeat(7, False, 17), ("127.0.0.1", relay.port))
            wait_until(lambda: relay.truths[7].mode == "BRAKE", "the truth is seen before the cut")
            relay.clear()
            relay.delay_down_s = 0.3
            began = time.monotonic()
            last = heartbeat(7, False, 9)
            vehicle.sendto(last, ("127.0.0.1", relay.port))
            assert daemon.recv(1000) == last  # and not what was cut
            assert time.monotonic() - began >= 0.3
        finally:
            relay.stop()
