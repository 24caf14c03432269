"""A participant of DDS that means harm, and vehicles that nobody engaged: frames on their wire are counted."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ros.played_vehicle import VEHICLES, PlayedFleet
from support.process import wait_until

ATTACK_S = 600

MOST_GROWTH_KB = 60_000
"""Growth by a wave of 2,500 writers: a few kB of each, and samples of 1 MiB at most that wait to be read."""

AGAIN_GROWTH_KB = 20_000
"""Growth by the same wave once more: what was kept of participants that have gone is used again."""


class Attacked(PlayedFleet):
    """A daemon with ROS and three vehicles on UDP, which is attacked."""

    def attack(self) -> str:
        line = [sys.executable, "-m", "ros.hostile_node", str(self.domain), self.commands, *VEHICLES]
        own = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
        done = subprocess.run(line, capture_output=True, text=True, timeout=ATTACK_S, check=False, env=own)
        assert done.returncode == 0, done.stdout + done.stderr[-3000:]
        return done.stdout

    def peak_kb(self) -> int:
        """Most memory that the process of ROS has had."""
        pid = self.call("ros.status")["pid"]
        status = Path(f"/proc/{pid}/status").read_text()
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))


"""Two attacks, each of a minute."""


@pytest.fixture(params=["none", "setpoints", "all"])
def attacked(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Attacked]:
    made = Attacked(tmp_path, request.param)
    yield made
    made.close()


def test_nothing_is_sent_to_a_vehicle_and_the_bridge_stays(attacked: Attacked) -> None:
    """Setpoints, orders, bytes of no message, megabytes, other types, thousands of writers; twice."""
    before, first_kb = attacked.call("ros.status"), attacked.peak_kb()
    said = attacked.attack()
    assert " writers" in said
    grown_kb = attacked.peak_kb()
    attacked.attack()
    again_kb = attacked.peak_kb()
    print(f"{attacked.commands}: {first_kb} kB, after an attack {grown_kb} kB, after another {again_kb} kB\n{said}")

    sent = {name: dict(vehicle.orders()) for name, vehicle in attacked.wire.items()}
    assert not any(sent.values()), sent
    for state in attacked.vehicles().values():
        assert state["connected"] and not state["armed"] and not state["control"]
    after = attacked.call("ros.status")
    assert (after["pid"], after["restarts"]) == (before["pid"], before["restarts"])
    os.kill(after["pid"], 0)
    assert grown_kb - first_kb < MOST_GROWTH_KB and again_kb - grown_kb < AGAIN_GROWTH_KB

    wait_until(lambda: attacked.call("ros.status")["age_s"] < 5, "the process reports on")
    report = attacked.call("ros.status")["report"]
    shown = attacked.cli("ros", "status").stdout
    refused = {vehicle["name"]: vehicle["setpoints_refused"] for vehicle in report["vehicles"]}
    if attacked.commands == "none":
        assert not any(topic["count"] for topic in report["topics"] if not topic["readers"])
        assert refused == dict.fromkeys(VEHICLES, 0)
        return
    samples = re.search(r"([\d,]+) samples", shown)  # of a later report: the network may still deliver some
    assert report["rejected"] > 300 and samples is not None and int(samples[1].replace(",", "")) >= report["rejected"]
    assert all(count > 50 for count in refused.values()), refused
    assert "setpoints refused" in shown and "not under control" in shown
    assert all(vehicle["setpoints_sent"] == 0 for vehicle in report["vehicles"])
