"""Nodes of rospy, with a real master of ROS 1, read the topics of three vehicles, call services and fly."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ros.conftest import FLEET, VEHICLES, RosFleet
from ros.rosmaster import Master
from skygcs.core.ros.interfaces import ros1_interfaces
from skygcs.core.ros.ros1 import RULE, ros1_name, ros1_type, service_md5, service_parts
from skygcs.core.ros.services import ROS1_SERVICES
from skygcs.core.ros.setpoints import SETPOINTS
from skygcs.core.ros.shared_topics import SHARED
from skygcs.core.ros.topics import TELEMETRY
from support.needed import needs
from support.process import DaemonProcess, wait_until
from support.system_programs import ROS1


class Ros1Fleet(RosFleet):
    """A daemon whose process of ROS is in ROS 1."""

    def __init__(self, folder: Path, master: Master) -> None:
        self.master = master
        ros = f'[ros]\nversion = 1\nmaster = "{master.uri}"\ncommands = "all"\n'
        rates = FLEET[FLEET.index("[ros.rates]") :]
        DaemonProcess.__init__(self, folder, FLEET[: FLEET.index("[ros]")] + ros + rates)

    def services_are_up(self) -> bool:
        return f"/{VEHICLES[-1]}/mavros/set_mode" in self.published()

    def published(self) -> list[str]:
        """Topics and services that the master knows."""
        topics = self.master.ran("rostopic", "list").stdout.split()
        return topics + self.master.ran("rosservice", "list").stdout.split()


@pytest.fixture(scope="module")
def master(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Master]:
    needs("test-ros", *ROS1)
    made = Master(tmp_path_factory.mktemp("master"))
    made.start()
    yield made
    made.stop()


@pytest.fixture(scope="module")
def fleet(master: Master, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros1Fleet]:
    with Ros1Fleet(tmp_path_factory.mktemp("ros1"), master) as running:
        wait_until(running.services_are_up, "its services are known")
        yield running


def test_sums_are_those_of_genmsg(master: Master) -> None:
    known = ros1_interfaces()
    types = {
        topic.type for topic in (*TELEMETRY.values(), *SHARED.values(), *(topic for topic, _ in SETPOINTS.values()))
    }
    texts, sums = {}, {}
    for type_ in map(ros1_type, types):
        texts[ros1_name(type_)], sums[ros1_name(type_)] = known.ros1_definition(type_)
    for service in set(ROS1_SERVICES.values()):
        parts = [known.ros1_definition(part)[0].partition(RULE) for part in service_parts(service)]
        (request, _, first), (response, _, second) = parts
        others = [block for block in (first, second) if block]
        texts[ros1_name(service)] = f"{request}---\n{response}" + "".join(f"{RULE}{block}" for block in others)
        sums[ros1_name(service)] = service_md5(known, service)
    done = master.node("sums", given=json.dumps(texts))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == sums and len(sums) > 40


def test_every_vehicle_is_read(master: Master, fleet: Ros1Fleet) -> None:
    done = master.node("echo", "20", *(f"/{name}/mavros" for name in VEHICLES))
    found: dict[str, dict[str, Any]] = {one.pop("topic"): one for one in map(json.loads, done.stdout.splitlines())}
    topics = ("state", "imu/data", "local_position/pose", "local_position/odom", "global_position/global", "battery")
    spaces = [f"/{name}/mavros/{topic}" for name in VEHICLES for topic in topics]
    assert found.keys() == {*spaces, *(f"/tf {name}/base_link" for name in VEHICLES)}, done.stderr
    states = fleet.vehicles()
    for name in VEHICLES:
        fix = found[f"/{name}/mavros/global_position/global"]
        assert fix["frame"] == f"{name}/base_link" and fix["stamp"] > 1e9
        assert fix["lat"] == pytest.approx(states[name]["position"]["lat_deg"], abs=1e-5)
        assert fix["lon"] == pytest.approx(states[name]["position"]["lon_deg"], abs=1e-5)
        assert found[f"/{name}/mavros/state"]["connected"] is True
        assert found[f"/{name}/mavros/local_position/odom"]["child"] == f"{name}/base_link"
        assert found[f"/{name}/mavros/battery"]["volts"] > 5
        pose = found[f"/{name}/mavros/local_position/pose"]
        assert pose["count"] > 60 and pose["seq"] >= pose["count"] - 1  # the requested rate is 10 Hz


def test_ros_s_own_programs_see_the_topics(master: Master, fleet: Ros1Fleet) -> None:
    assert master.ran("rostopic", "type", "/alpha/mavros/vfr_hud").stdout.strip() == "mavros_msgs/VFR_HUD"
    echoed = master.ran("rostopic", "echo", "-n", "1", "/alpha/mavros/global_position/rel_alt")
    assert echoed.stdout.startswith("data: "), echoed.stderr
    assert master.ran("rosservice", "type", "/alpha/mavros/set_mode").stdout.strip() == "mavros_msgs/SetMode"
    assert master.node("trigger", "/alpha/mavros/home_position/req_update").stdout.strip() == "True"
    success, number, _ = json.loads(master.node("param", "/alpha/mavros", "MAV_SYS_ID").stdout)
    assert success and number == 1
    assert "ROS 1" in fleet.call("ros.status")["report"]["network"]


def test_a_reader_that_comes_later_gets_the_events_of_before(master: Master, fleet: Ros1Fleet) -> None:
    for _ in range(5):  # an event each
        fleet.call("vehicles.request", targets="alpha", message="HOME_POSITION")
    assert int(master.node("late", "/skygcs/events", "5").stdout) >= 5


@pytest.mark.parametrize(("name", "land"), [("alpha", "AUTO.LAND"), ("charlie", "LAND")])
def test_an_offboard_node_flies_a_square_and_lands(master: Master, fleet: Ros1Fleet, name: str, land: str) -> None:
    """A PX4 and an ArduCopter, by the node that MAVROS' documentation has: stream, OFFBOARD, arm, fly, land."""
    done = master.node("fly", f"/{name}/mavros", land)
    assert done.returncode == 0, done.stdout + done.stderr + fleet.stderr[-3000:]
    assert done.stdout.count("mode OFFBOARD") == 5 and done.stdout.endswith("landed\n")


def test_a_flood_of_bad_setpoints_leaves_the_daemon_and_the_process_well(master: Master, fleet: Ros1Fleet) -> None:
    before = fleet.call("ros.status")
    sent = int(master.node("flood", "/bravo/mavros/setpoint_position/local", "5").stdout)
    assert sent > 1000
    after = fleet.call("ros.status")
    assert (after["pid"], after["restarts"]) == (before["pid"], before["restarts"])
    assert not fleet.vehicles()["bravo"]["armed"]


def test_a_master_that_is_started_anew_finds_the_same_topics(master: Master, fleet: Ros1Fleet) -> None:
    before = fleet.call("ros.status")
    master.stop()
    master.start()
    wait_until(fleet.services_are_up, "everything is declared anew")
    done = master.node("echo", "5", "/alpha/mavros")
    assert '"topic": "/alpha/mavros/state"' in done.stdout, done.stderr
    assert fleet.call("ros.status")["pid"] == before["pid"]
    assert fleet.vehicles()["alpha"]["connected"]


def test_names_are_taken_from_the_master_at_the_end(master: Master, tmp_path: Path) -> None:
    own = Master(tmp_path)
    own.start()
    try:
        with Ros1Fleet(tmp_path, own) as running:
            wait_until(running.services_are_up, "its services are known")
        wait_until(lambda: "/tf" not in running.published(), "nothing is left at the master")
        assert not [name for name in running.published() if "mavros" in name]
    finally:
        own.stop()
