"""The bridge between states and messages of the daemon and topics, with a node that keeps what it gets."""

from __future__ import annotations

import subprocess
import sys
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from skygcs.ext.ros import bridge
from skygcs.ext.ros.bridge import Bridge
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.dds import MOST_SAMPLE_BYTES, Network, network_config
from skygcs.ext.ros.graph import SharedTopics
from skygcs.ext.ros.methods import RosReport
from skygcs.ext.ros.process import MOST_MEMORY_BYTES
from support.ros_node import KeptNode
from support.table import each

NOW_NS = 1_700_000_000 * 10**9


class Rig:
    """A bridge at a standing clock."""

    def __init__(self, **config: Any) -> None:
        self.node = KeptNode()
        self.bridge = Bridge(self.node, RosConfig(**config), lambda: NOW_NS)

    def state(self, name: str, sysid: int, **more: Any) -> None:
        self.bridge.on_state({"name": name, "sysid": sysid, "compid": 1, "connected": True, **more})

    def message(self, vehicle: str | None, name: str, compid: int = 1, age_s: float = 0.0, **fields: Any) -> None:
        message = {"vehicle": vehicle, "compid": compid, "name": name, "fields": fields, "age_s": age_s}
        self.bridge.on_message(message)

    def heartbeat(self, vehicle: str, compid: int = 1, base_mode: int = 0x91) -> None:
        mode = {"autopilot": 12, "type": 2, "base_mode": base_mode, "custom_mode": 0x3040000, "system_status": 4}
        self.message(vehicle, "HEARTBEAT", compid, **mode)


def local(**more: float) -> dict[str, float]:
    return {"time_boot_ms": 5000, "x": 1.0, "y": 2.0, "z": -3.0, "vx": 0.0, "vy": 0.0, "vz": 0.0, **more}


def test_each_vehicle_has_its_own_topics() -> None:
    rig = Rig()
    rig.state("alpha", 1)
    rig.state("bravo", 2)
    state = rig.node.last("/alpha/mavros/state")
    assert state["connected"] is False and state["header"]["stamp"]["sec"] == NOW_NS // 10**9
    rig.heartbeat("alpha")
    rig.heartbeat("alpha", compid=191, base_mode=0)  # a companion's says nothing of the vehicle
    rig.heartbeat("nobody")
    state = rig.node.last("/alpha/mavros/state")
    assert state["connected"] and state["armed"] and state["mode"] == "AUTO.LOITER"
    assert rig.node.last("/bravo/mavros/state")["connected"] is False
    rig.message("alpha", "LOCAL_POSITION_NED", **local())
    assert rig.node.publications["/alpha/mavros/local_position/pose"].sent == 0  # nobody reads
    rig.node.read("/alpha/mavros/local_position/pose", "/tf")
    rig.message("alpha", "LOCAL_POSITION_NED", age_s=0.004, **local())
    pose = rig.node.last("/alpha/mavros/local_position/pose")
    assert pose["pose"]["position"] == {"x": 2.0, "y": 1.0, "z": 3.0}
    assert pose["header"]["frame_id"] == "alpha/map"
    assert pose["header"]["stamp"] == {"sec": NOW_NS // 10**9 - 1, "nanosec": 996_000_000}
    (transform,) = rig.node.last("/tf")["transforms"]
    assert (transform["header"]["frame_id"], transform["child_frame_id"]) == ("alpha/map", "alpha/base_link")


def test_mavlinks_frames_are_turned_as_in_mavros() -> None:
    """uas_tf.cpp, setup_static_tf: map_ned has the axes north, east, down; base_link_frd forward, right, down."""
    rig = Rig()
    rig.state("alpha", 1)
    found = {t["child_frame_id"]: t for t in rig.node.last("/tf_static")["transforms"]}
    axes = {
        "alpha/map_ned": ("alpha/map", [[0, 1, 0], [1, 0, 0], [0, 0, -1]]),
        "alpha/base_link_frd": ("alpha/base_link", [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
    }
    for child, (parent, vectors) in axes.items():
        assert found[child]["header"]["frame_id"] == parent
        w, x, y, z = (found[child]["transform"]["rotation"][name] for name in "wxyz")
        v = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.eye(3) + 2 * w * v + 2 * v @ v
        assert np.abs(turn.T - vectors).max() < 1e-12  # columns are the child's axes in the parent


def test_transforms_that_stay_are_sent_when_they_change_and_looked_up_by_their_children() -> None:
    class Fixed(dict[str, Any]):
        """The transforms that were sent; going through all of them is an error."""

        def items(self) -> Any:
            raise AssertionError("each state would cost a look at every vehicle")

        __iter__ = keys = items

    node = KeptNode()
    shared = SharedTopics(node)
    one, other = ({"child_frame_id": name, "transform": {"translation": {"x": 1.0}}} for name in ("a", "b"))
    shared.fix_transforms(one, other)
    assert [t["child_frame_id"] for t in node.last("/tf_static")["transforms"]] == ["a", "b"]
    shared._fixed = Fixed(shared._fixed)
    shared.fix_transforms(other)
    shared._fixed = dict(zip("ab", dict.values(shared._fixed), strict=True))
    assert node.publications["/tf_static"].sent == 1
    shared.fix_transforms({**other, "transform": {"translation": {"x": 2.0}}})
    found = node.last("/tf_static")["transforms"]
    assert [t["transform"]["translation"]["x"] for t in found] == [1.0, 2.0]


def test_a_vehicle_that_is_not_heard_is_disconnected_once_and_forgets_what_mavros_does() -> None:
    rig = Rig()
    rig.state("alpha", 1)
    rig.heartbeat("alpha")
    rig.bridge.vehicles["alpha"].memory.has_battery0 = True
    before = rig.node.publications["/alpha/mavros/state"].sent
    rig.state("alpha", 1, connected=False)
    rig.state("alpha", 1, connected=False)
    assert rig.node.publications["/alpha/mavros/state"].sent == before + 1
    assert rig.node.last("/alpha/mavros/state")["connected"] is False
    assert not rig.bridge.vehicles["alpha"].memory.has_battery0


def test_the_radio_is_every_vehicles() -> None:
    rig = Rig()
    rig.state("alpha", 1)
    rig.state("bravo", 2)
    topics = ["/alpha/mavros/radio_status", "/bravo/mavros/radio_status"]
    rig.node.read(*topics)
    radio = {"rssi": 190, "remrssi": 95, "txbuf": 99, "noise": 20, "remnoise": 21, "rxerrors": 0, "fixed": 1}
    rig.message(None, "RADIO_STATUS", 68, **radio)
    assert all(rig.node.last(topic)["rssi_dbm"] == -27.0 for topic in topics)


def test_texts_are_logged_and_bad_messages_counted() -> None:
    rig = Rig(frame_prefix="")
    rig.state("alpha", 1)
    rig.message("alpha", "STATUSTEXT", severity=2, text="low battery")
    entry = rig.node.last("/rosout")
    assert (entry["level"], entry["name"], entry["msg"]) == (40, "alpha.mavros", "FCU: low battery")
    rig.node.read("/alpha/mavros/local_position/pose", "/tf")
    rig.message("alpha", "LOCAL_POSITION_NED", x=1.0)
    rig.message("alpha", "LOCAL_POSITION_NED", **local(x="one"))  # type: ignore[arg-type]
    rig.message("alpha", "LOCAL_POSITION_NED", **local())
    assert rig.bridge.faults == 2
    assert rig.node.last("/alpha/mavros/local_position/pose")["header"]["frame_id"] == "map"
    assert rig.node.publications["/tf"].sent == 0  # plain frames of several vehicles would be one


def test_a_home_without_an_orientation_is_a_home() -> None:
    """An ArduPilot's orientation there is NaN, which JSON has as null."""
    rig = Rig()
    rig.state("alpha", 1)
    home = {"latitude": 473977000, "longitude": 85456000, "altitude": 488000, "q": [None] * 4}
    places = dict.fromkeys(("x", "y", "z", "approach_x", "approach_y", "approach_z"), 0.0)
    rig.message("alpha", "HOME_POSITION", **home, **places, time_usec=0)
    assert rig.node.last("/alpha/mavros/home_position/home")["geo"]["latitude"] == 47.3977
    assert rig.bridge.faults == 0


def test_names_that_are_one_in_ros_have_the_topics_of_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge, "MOST_VEHICLES", 20)
    rig = Rig()
    rig.state("uav-1", 1)
    rig.state("uav_1", 2)
    assert list(rig.bridge.vehicles) == ["uav-1"]
    for sysid in range(3, 100):
        rig.state(f"v{sysid}", sysid)
    assert (len(rig.bridge.vehicles), len(rig.bridge._refused)) == (19, 20)


def test_a_report_has_what_is_used_and_rates_what_is_read() -> None:
    rig = Rig(rates={"LOCAL_POSITION_NED": 20.0})
    rig.state("alpha", 1)
    rig.node.read("/alpha/mavros/local_position/pose")
    rig.bridge.report(1.0)
    for _ in range(20):
        rig.message("alpha", "LOCAL_POSITION_NED", **local())
    report = RosReport(**rig.bridge.report(2.0))
    (topic,) = report.topics
    assert (topic.name, topic.readers, topic.rate_hz, topic.count) == ("/alpha/mavros/local_position/pose", 1, 10.0, 20)
    assert rig.bridge.vehicles["alpha"].wanted_messages() == {"LOCAL_POSITION_NED", "LOCAL_POSITION_NED_COV"}


@each(
    "table",
    [
        {"root": "alpha"},
        {"root": "/mavros"},
        {"root": "/{name.__class__}"},
        {"frame_prefix": "{name} "},
        {"frame_prefix": "{0}"},
        {"rates": {"attitude": 5}},
        {"rates": {"ATTITUDE": 0}},
        {"peers": ("10.0.0.1</Peer>",)},
        {"domain": 233},
        {"commands": "some"},
    ],
)
def test_a_table_that_cannot_be_is_refused(table: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        RosConfig(**table)


# -- The process of ROS: its limit of memory, and the network that it is on.


LIMITED = """
import resource
from skygcs.ext.ros.process import MOST_MEMORY_BYTES
from skygcs.ext.ros.rospy_program import limit_memory
limit_memory(MOST_MEMORY_BYTES)
print(*resource.getrlimit(resource.RLIMIT_DATA))
resource.setrlimit(resource.RLIMIT_DATA, (1 << 29, MOST_MEMORY_BYTES))  # the lower one is what counts
limit_memory(MOST_MEMORY_BYTES)
print(*resource.getrlimit(resource.RLIMIT_DATA))
try:
    bytearray(1 << 30)
except MemoryError:
    print("no more")
"""


def test_its_memory_is_limited_and_a_lower_limit_stays() -> None:
    done = subprocess.run([sys.executable, "-c", LIMITED], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [f"{MOST_MEMORY_BYTES} {MOST_MEMORY_BYTES}", f"{1 << 29} {1 << 29}", "no more"]


def test_the_network_is_the_loopback_or_the_peers_and_samples_have_a_limit() -> None:
    here = ElementTree.fromstring(network_config(Network(3, True, ())))
    assert [one.get("address") for one in here.iter("NetworkInterface")] == ["127.0.0.1"]
    assert here.findtext("Domain/Internal/MaxSampleSize") == f"{MOST_SAMPLE_BYTES} B"
    lan = ElementTree.fromstring(network_config(Network(3, False, ("10.0.0.2", "drone.local"))))
    assert [one.get("address") for one in lan.iter("Peer")] == ["127.0.0.1", "10.0.0.2", "drone.local"]
    assert not list(lan.iter("NetworkInterface")) and lan.findtext("Domain/General/AllowMulticast") == "false"
