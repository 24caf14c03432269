"""A participant of DDS that means harm, and vehicles that nobody engaged: frames on their wire are counted."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ros.played_vehicle import ARDUPILOT, PX4, PlayedVehicle
from support.process import DaemonProcess, free_port, wait_until

FLEET = """
[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0
[links.field]
type = "udp_server"
host = "127.0.0.1"
port = {port}
role = "vehicle"
[vehicles.alpha]
sysid = 1
[vehicles.bravo]
sysid = 2
[vehicles.charlie]
sysid = 3
[ros]
domain = {domain}
commands = "{commands}"
px4_msgs = "1.16"
"""

VEHICLES = {"alpha": PX4, "bravo": PX4, "charlie": ARDUPILOT}

ATTACK_S = 600

MOST_GROWTH_KB = 150_000
"""Of a wave of 2,500 writers; what is kept of each is some 10 kB."""

AGAIN_GROWTH_KB = 30_000
"""Of the same wave once more: what was kept of participants that have gone is used again."""


class Attacked(DaemonProcess):
    """A daemon with ROS and three vehicles on UDP."""

    def __init__(self, folder: Path, commands: str) -> None:
        self.domain = random.SystemRandom().randrange(50, 200)
        self.commands = commands
        port = free_port()
        super().__init__(folder, FLEET.format(port=port, domain=self.domain, commands=commands))
        self.start()
        wait_until(lambda: all(link["state"] == "up" for link in self.call("links.list")), "the link is up")
        self.wire = {name: PlayedVehicle(n, kind, port) for n, (name, kind) in enumerate(VEHICLES.items(), 1)}
        wait_until(self.is_up, "the process of ROS has all vehicles")

    def is_up(self) -> bool:
        report = self.call("ros.status")["report"]
        heard = [state for state in self.vehicles().values() if state["connected"] and state["autopilot"]]
        return report is not None and {v["name"] for v in report["vehicles"]} == VEHICLES.keys() and len(heard) == 3

    def attack(self) -> str:
        line = [sys.executable, "-m", "ros.hostile_node", str(self.domain), self.commands, *VEHICLES]
        own = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
        done = subprocess.run(line, capture_output=True, text=True, timeout=ATTACK_S, check=False, env=own)
        assert done.returncode == 0, done.stdout + done.stderr[-3000:]
        return done.stdout

    def resident_kb(self) -> int:
        pid = self.call("ros.status")["pid"]
        status = Path(f"/proc/{pid}/status").read_text()
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))

    def close(self) -> None:
        for vehicle in self.wire.values():
            vehicle.close()
        self.stop()


@pytest.fixture(params=["none", "setpoints", "all"])
def attacked(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Attacked]:
    made = Attacked(tmp_path, request.param)
    yield made
    made.close()


def test_nothing_is_sent_to_a_vehicle_and_the_bridge_stays(attacked: Attacked) -> None:
    """Setpoints, orders, bytes of no message, megabytes, other types, thousands of writers; twice."""
    before, first_kb = attacked.call("ros.status"), attacked.resident_kb()
    said = attacked.attack()
    assert " writers" in said
    grown_kb = attacked.resident_kb()
    attacked.attack()
    again_kb = attacked.resident_kb()
    print(f"{attacked.commands}: {first_kb} kB, after an attack {grown_kb} kB, after another {again_kb} kB\n{said}")

    assert {name: dict(vehicle.orders()) for name, vehicle in attacked.wire.items()} == dict.fromkeys(VEHICLES, {})
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
    assert report["rejected"] > 300 and f"{report['rejected']} samples" in shown
    assert all(count > 50 for count in refused.values()), refused
    assert "setpoints refused" in shown and "not under control" in shown
    assert all(vehicle["setpoints_sent"] == 0 for vehicle in report["vehicles"])
