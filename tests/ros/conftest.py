"""A daemon with three simulated vehicles and its process of ROS, in a domain of its own."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.process import DaemonProcess, wait_until

FLEET = """
[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0
x_heading_deg = 60
[links.field]
type = "simulated"
px4 = 2
ardupilot = 1
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
[ros.rates]
LOCAL_POSITION_NED = 10
ATTITUDE = 10
"""

VEHICLES = ("alpha", "bravo", "charlie")


class RosFleet(DaemonProcess):
    """A daemon whose process of ROS has reported its vehicles."""

    def __init__(self, folder: Path, commands: str = "all") -> None:
        self.domain = random.SystemRandom().randrange(50, 200)  # of its own: another run is not seen
        super().__init__(folder, FLEET.format(domain=self.domain, commands=commands))

    def start(self) -> None:
        super().start()
        wait_until(self.is_up, f"the process of ROS has all vehicles; the daemon said: {self.stderr_path}")

    def is_up(self) -> bool:
        report = self.call("ros.status")["report"]
        return report is not None and {v["name"] for v in report["vehicles"]} == set(VEHICLES)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosFleet]:
    with RosFleet(tmp_path_factory.mktemp("ros")) as running:
        yield running
