"""The node of ROS 1 and its process, with a program in place of rospy: declarations, bytes both ways, bounds, ends."""

from __future__ import annotations

import asyncio
import io
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.ros import ros1
from skygcs.core.ros.interfaces import InterfaceError, ros1_interfaces
from skygcs.errors import SkygcsError
from skygcs.ext.ros import rospy_node
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.late_gate import LATE, WAITED
from skygcs.ext.ros.rospy_node import MOST_PENDING, RospyNode
from skygcs.ext.ros.rospy_program import Beat, Call, Program, packed, read_frame
from support.table import each

POSE = "geometry_msgs/msg/PoseStamped"


def test_a_message_of_ros_2_becomes_that_of_ros_1() -> None:
    known = ros1_interfaces()
    header = {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "map"}
    pose = {"header": header, "pose": {"position": {"x": 1.0}}}
    read = ros1.decode(known, POSE, ros1.encode(known, POSE, pose, seq=2**32 + 5))
    assert read["header"] == {**header, "seq": 5} and read["pose"]["position"]["x"] == 1.0
    log = {"stamp": {"sec": 7, "nanosec": 8}, "level": 40, "name": "alpha", "msg": "no"}
    entry = known.decode(ros1.LOG_1, ros1.encode(known, ros1.LOG, log))
    assert (entry["level"], entry["name"], entry["header"]["stamp"]["sec"]) == (8, "alpha", 7)
    assert ros1.encode(known, "std_srvs/srv/Trigger_Request", {}) == b""
    with pytest.raises(InterfaceError):
        ros1.decode(known, "std_srvs/srv/Trigger_Request", b"\0")


def test_sums_of_services_are_those_of_mavros_1() -> None:
    """As its generated code states them."""
    sums = {
        "mavros_msgs/srv/CommandBool": "e09abbb4e5bae6b558e5010966eb6e9e",
        "mavros_msgs/srv/CommandInt": "5d5fd287bf3d27ad6ec508b1692f3b09",
        "mavros_msgs/srv/CommandLong": "eb9034afc87577c0a235d45b8f3437d2",
        "mavros_msgs/srv/CommandTOL": "93ff4eaa9907f58c0e7a909cddce23e2",
        "mavros_msgs/srv/ParamSet": "c423cafb898fff374cbe8530ecd4d285",
        "mavros_msgs/srv/SetMode": "e4f18fa93379f9ff1780d270ce110203",
        "mavros_msgs/srv/WaypointPush": "96690cb0f07ea4a54cdd6f188e10228e",
        "std_srvs/srv/Trigger": "937c9679a518e3a18d831e57125ea522",
    }
    assert {name: ros1.service_md5(ros1_interfaces(), name) for name in sums} == sums
    messages = {
        "mavros_msgs/msg/State": "65cd0a9fff993b062b91e354554ec7e9",
        "mavros_msgs/msg/HomePosition": "c1167922de8c97acdb0ec714c1dba774",
        "mavros_msgs/msg/PositionTarget": "dedb0081aaf8cb20209737746bb49117",
        "mavros_msgs/msg/AttitudeTarget": "456f3af666b22ccd0222ea053a86b548",
        "tf2_msgs/msg/TFMessage": "94810edda583a504dfda3829e70d7eec",
    }
    assert {name: ros1_interfaces().ros1_definition(name)[1] for name in messages} == messages


FAKE = """
import os, sys
sys.path.insert(0, {folder!r})
from rospy_program import packed, read_frame

file, out = sys.stdin.buffer, os.fdopen(1, "wb")
out.write(packed({{"is": "up"}}))
out.flush()
with open({log!r}, "a") as log:
    while (frame := read_frame(file)) is not None:
        head, body = frame
        log.write(f"{{head['do']}} {{head.get('name', head.get('id', head.get('call')))}} {{body.hex()}}\\n")
        log.flush()
        {more}
"""


class Rig:
    """A node whose program writes down what it gets."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, more: str = "pass") -> None:
        self.log = folder / "log"
        program = folder / "fake.py"
        source = str(Path(rospy_node.__file__).parent)
        program.write_text(FAKE.format(folder=source, log=str(self.log), more=more))
        monkeypatch.setattr(rospy_node, "PROGRAM", program)
        monkeypatch.setattr(rospy_node, "FIRST_PAUSE_S", 0.01)
        self.node = RospyNode(ros1_interfaces(), "http://localhost:1", True, sys.executable)

    def lines(self) -> list[str]:
        return self.log.read_text().splitlines() if self.log.exists() else []

    async def until(self, condition: Callable[[], Any]) -> None:
        for _ in range(2000):
            if condition():
                return
            await asyncio.sleep(0.01)
        raise AssertionError(self.lines())

    def run(self, test: Callable[[], Awaitable[None]]) -> None:
        async def main() -> None:
            task = asyncio.create_task(self.node.run())
            try:
                await test()
            finally:
                self.node.close()
                task.cancel()
                await asyncio.wait({task})

        asyncio.run(main())


def test_what_is_declared_and_latched_is_sent_again_to_a_process_that_is_started_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(
        tmp_path, monkeypatch, "if head['do'] == 'send' and head['id'] == 1 and body[4:5] == b'\\x09': sys.exit(7)"
    )
    node = rig.node
    state = node.publish("/alpha/mavros/state", "mavros_msgs/msg/State", "latched")
    pose = node.publish("/alpha/mavros/local_position/pose", POSE, "sensor")
    node.subscribe("/alpha/mavros/setpoint_position/local", POSE, "default", lambda fields: None)

    async def test() -> None:
        state.write({"mode": "HOLD"})  # before the process is there
        await rig.until(lambda: len(rig.lines()) == 4)
        assert state.wanted and not pose.wanted
        pose.write({"header": {"stamp": {"sec": 9}}})  # ends it
        await rig.until(lambda: len(rig.lines()) == 9)
        declared = [line.split()[1] for line in rig.lines()[:3]]
        assert declared == [*node.publications, *node.subscribers]
        assert rig.lines()[5:] == rig.lines()[:4]
        assert ros1_interfaces().decode(state.type, bytes.fromhex(rig.lines()[3].split()[2]))["mode"] == "HOLD"

    rig.run(test)


def test_messages_requests_and_readers_come_and_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = ros1_interfaces()
    data = ros1.encode(known, POSE, {"pose": {"position": {"x": 3.0}}})
    frames = packed({"is": "message", "id": 1}, data) + packed({"is": "message", "id": 1}, data[:-3])
    frames += packed({"is": "readers", "id": 0, "count": 2}) + packed(
        {"is": "call", "id": 2, "call": 1, "late": False}, b"\x01"
    )
    frames += packed({"is": "call", "id": 2, "call": 2, "late": False}, b"")
    frames += b"".join(packed({"is": "call", "id": 2, "call": 3 + n, "late": True}, b"\0") for n in range(MOST_PENDING))
    more = f"if head['do'] == 'serve': out.write({frames!r}); out.flush()"
    rig = Rig(tmp_path, monkeypatch, more)
    node, got = rig.node, []
    gate, waited = asyncio.Event(), list[str | None]()

    async def handle(request: dict[str, Any]) -> dict[str, Any]:
        if not request["value"]:
            waited.append(LATE.get())
            await gate.wait()
        return {"success": request["value"]}

    pose = node.publish("/pose", POSE, "sensor")
    setpoint = node.subscribe("/setpoint", POSE, "default", got.append)
    service = node.serve("/arming", "mavros_msgs/srv/CommandBool", handle)

    async def test() -> None:
        await rig.until(lambda: service.overflown)
        await rig.until(lambda: "answer 1 0100" in rig.lines())
        assert (setpoint.received, setpoint.rejected, got[0]["pose"]["position"]["x"]) == (2, 1, 3.0)
        assert pose.readers == 2 and pose.wanted
        assert (service.calls, service.rejected, service.overflown) == (MOST_PENDING, 1, 1)
        assert "answer 2 0000" in rig.lines() and set(waited) == {WAITED}

    rig.run(test)


def test_without_rospy_the_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "program.py"
    program.write_text("raise SystemExit(4)")
    monkeypatch.setattr(rospy_node, "PROGRAM", program)
    node = RospyNode(ros1_interfaces(), "http://localhost:1", True, sys.executable)
    with pytest.raises(SkygcsError, match="python3-rospy"):
        asyncio.run(node.run())


class FakeRospy:
    """The part of rospy that the program uses."""

    class AnyMsg:
        _buff = b""

    class ServiceException(Exception):
        pass

    def __init__(self) -> None:
        self.made: list[Any] = []

    def Publisher(self, name: str, cls: Any, **more: Any) -> Any:
        self.made.append((name, cls, more))
        return self

    Service = Subscriber = Publisher

    def publish(self, message: Any) -> None:
        self.made.append(message._buff)

    def get_num_connections(self) -> int:
        return 1


def test_the_program_declares_publishes_and_counts() -> None:
    rospy, out = FakeRospy(), io.BytesIO()
    program = Program(rospy, out)
    about = {"name": "/a", "type": "std_msgs/String", "md5": "1", "text": "string data"}
    program.on_frame({"do": "publish", "id": 3, "keep": 1, "queue": 10, **about}, b"")
    program.on_frame({"do": "send", "id": 3}, b"abc")
    program.count_readers()
    program.count_readers()
    (name, cls, more), sent = rospy.made
    assert (name, cls._type, cls._md5sum, cls._full_text) == ("/a", "std_msgs/String", "1", "string data")
    assert more == {"latch": True, "queue_size": 10, "subscriber_listener": None} and sent == b"abc"
    out.seek(0)
    assert read_frame(out) == ({"is": "readers", "id": 3, "count": 1}, b"")
    assert read_frame(out) is None
    program.on_frame({"do": "answer", "call": 99}, b"")  # of a call that has ended


def test_what_waited_while_the_program_stood_still_is_dropped_or_called_late(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    rospy, out = FakeRospy(), io.BytesIO()
    program = Program(rospy, out)
    program.beat = Beat(lambda: now[0])
    message = rospy.AnyMsg()
    for step_s, passed in ((0.9, True), (1.2, False), (0.9, False), (0.2, True)):
        now[0] += step_s
        before = out.tell()
        program._on_message(message, 7)
        assert (out.tell() > before) is passed, now
    monkeypatch.setattr(Call, "wait", lambda call: b"")
    for step_s, late in ((60.0, True), (1.1, False)):  # whether it ends a flight the other process knows
        now[0] += step_s
        before = out.tell()
        program._answer(1, b"")
        out.seek(before)
        frame = read_frame(out)
        assert frame is not None and frame[0]["late"] is late


def test_a_later_reader_of_events_gets_the_last_hundred() -> None:
    rospy = FakeRospy()
    program = Program(rospy, io.BytesIO())
    about = {"name": "/a", "type": "std_msgs/String", "md5": "1", "text": "string data"}
    program.on_frame({"do": "publish", "id": 0, "keep": 100, "queue": 100, **about}, b"")
    for n in range(130):
        program.on_frame({"do": "send", "id": 0}, bytes([n]))
    more, got = rospy.made[0][2], []
    assert not more["latch"]
    more["subscriber_listener"].peer_subscribe("/a", None, lambda message: got.append(message._buff[0]))
    assert got == list(range(30, 130))


@each(
    "table",
    [
        {"version": 1, "px4_msgs": "1.16"},
        {"version": 1, "domain": 3},
        {"version": 2, "master": "http://a:11311"},
        {"version": 1, "master": "ftp://a"},
        {"version": 3},
    ],
)
def test_a_table_of_two_versions_is_refused(table: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        RosConfig(**table)
