"""Nodes of rospy as the tests run them, under the system's Python: nothing of skygcs is imported here.

    sums                     MD5 sums by genmsg of definitions on standard input
    echo SECONDS NAMESPACE…  what comes of some topics, as JSON lines
    fly NAMESPACE MODE       MAVROS' offboard example: stream, OFFBOARD, arm, a square, MODE, until it is disarmed
    flood TOPIC SECONDS      setpoints as fast as rospy sends them, and others that are no numbers
    late TOPIC COUNT         how many messages of before a reader gets that comes later; COUNT are waited for

MAVROS' own interfaces are made of their definitions by genpy, as a package of them would be.
"""

from __future__ import annotations

import json
import math
import sys
import threading
import time

import genmsg
import genpy.dynamic
import rospy
from genmsg import MsgContext, gentools, msg_loader
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import BatteryState, Imu, NavSatFix
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

SERVICES = {
    "mavros_msgs/CommandBool": "bool value\n---\nbool success\nuint8 result\n",
    "mavros_msgs/SetMode": (
        "".join(
            f"uint8 MAV_MODE_{name} = {value}\n"
            for name, value in (
                ("PREFLIGHT", 0),
                ("STABILIZE_DISARMED", 80),
                ("STABILIZE_ARMED", 208),
                ("MANUAL_DISARMED", 64),
                ("MANUAL_ARMED", 192),
                ("GUIDED_DISARMED", 88),
                ("GUIDED_ARMED", 216),
                ("AUTO_DISARMED", 92),
                ("AUTO_ARMED", 220),
                ("TEST_DISARMED", 66),
                ("TEST_ARMED", 194),
            )
        )
        + "uint8 base_mode\nstring custom_mode\n---\nbool mode_sent\n"
    ),
    "mavros_msgs/ParamGet": (
        "string param_id\n---\nbool success\nmavros_msgs/ParamValue value\n"
        f"{'=' * 80}\nMSG: mavros_msgs/ParamValue\nint64 integer\nfloat64 real\n"
    ),
}


def service_class(name: str) -> type:
    """The class of a service, with the sum that genmsg gives it."""
    text, _, more = SERVICES[name].partition("=" * 80 + "\n")
    context = MsgContext.create_default()
    for block in filter(None, more.split("=" * 80 + "\n")):
        head, _, body = block.partition("\n")
        msg_loader.load_msg_from_string(context, body, head[len("MSG: ") :])
    spec = genmsg.msg_loader.load_srv_from_string(context, text, name)
    rest = f"{'=' * 80}\n{more}" if more else ""
    request, response = (
        genpy.dynamic.generate_dynamic(f"{name}{part}", definition + rest)[f"{name}{part}"]
        for part, definition in zip(("Request", "Response"), text.split("---\n"), strict=True)
    )
    members = {"_type": name, "_md5sum": gentools.compute_md5(context, spec)}
    return type(name, (), {**members, "_request_class": request, "_response_class": response})


def sums() -> None:
    """JSON of {type: text} in, of {type: sum} out; a service's text is that of its two parts with their types."""
    found = {}
    for name, text in json.load(sys.stdin).items():
        first, *others = text.split("=" * 80 + "\n")
        context = MsgContext.create_default()
        for block in reversed(others):
            head, _, body = block.partition("\n")
            msg_loader.load_msg_from_string(context, body, head[len("MSG: ") :])
        load = msg_loader.load_srv_from_string if "\n---\n" in f"\n{first}" else msg_loader.load_msg_from_string
        found[name] = gentools.compute_md5(context, load(context, first, name))
    json.dump(found, sys.stdout)


def state_of(namespace: str, take: object) -> None:
    """Read a vehicle's state by the definition that its publisher states."""
    message = rospy.wait_for_message(f"{namespace}/state", rospy.AnyMsg, timeout=30)
    header = message._connection_header
    cls = genpy.dynamic.generate_dynamic(header["type"], header["message_definition"])[header["type"]]
    assert cls._md5sum == header["md5sum"], (cls._md5sum, header["md5sum"])
    rospy.Subscriber(f"{namespace}/state", cls, take)


def echo(seconds: float, namespaces: list[str]) -> None:
    """One line for each topic: its last message."""
    found: dict[str, dict[str, object]] = {}

    def keep(name: str, **values: object) -> None:
        before = found.get(name, {})
        found[name] = {**values, "count": before.get("count", 0) + 1}

    def head(message: object) -> dict[str, object]:
        header = message.header
        return {"stamp": header.stamp.to_sec(), "frame": header.frame_id, "seq": header.seq}

    for space in namespaces:
        state_of(
            space, lambda m, s=space: keep(f"{s}/state", connected=m.connected, armed=m.armed, mode=m.mode, **head(m))
        )
        for name, cls, values in (
            ("imu/data", Imu, lambda m: {"w": m.orientation.w}),
            ("local_position/pose", PoseStamped, lambda m: {"z": m.pose.position.z}),
            ("local_position/odom", Odometry, lambda m: {"child": m.child_frame_id}),
            ("global_position/global", NavSatFix, lambda m: {"lat": m.latitude, "lon": m.longitude}),
            ("battery", BatteryState, lambda m: {"volts": m.voltage}),
        ):
            rospy.Subscriber(
                f"{space}/{name}", cls, lambda m, n=f"{space}/{name}", v=values: keep(n, **v(m), **head(m))
            )
    rospy.Subscriber("/tf", TFMessage, lambda m: keep(f"/tf {m.transforms[0].child_frame_id}"))
    time.sleep(seconds)
    for name, values in found.items():
        print(json.dumps({"topic": name, **values}))


class Flight:
    """One vehicle under OFFBOARD."""

    def __init__(self, namespace: str) -> None:
        self.space = namespace
        self.state = self.pose = None
        self.aim = (0.0, 0.0, 4.0)
        self.ask_at = 0.0
        self.publisher = rospy.Publisher(f"{namespace}/setpoint_position/local", PoseStamped, queue_size=1)
        state_of(namespace, lambda message: setattr(self, "state", message))
        rospy.Subscriber(f"{namespace}/local_position/pose", PoseStamped, lambda m: setattr(self, "pose", m))
        rospy.Subscriber("/rosout", Log, lambda m: print(f"{time.time():.2f} {m.name}: {m.msg}", flush=True))
        self.arming = self.service("cmd/arming", "mavros_msgs/CommandBool")
        self.set_mode = self.service("set_mode", "mavros_msgs/SetMode")

    def service(self, name: str, type_: str) -> rospy.ServiceProxy:
        rospy.wait_for_service(f"{self.space}/{name}", timeout=30)
        return rospy.ServiceProxy(f"{self.space}/{name}", service_class(type_))

    def stream(self) -> None:
        """20 setpoints a second, in a thread of its own: a service takes as long as the vehicle."""
        last = time.monotonic()
        while True:
            if time.monotonic() - last > 0.3:
                print(f"{time.time():.2f} a gap of {time.monotonic() - last:.2f} s", flush=True)
            last = time.monotonic()
            setpoint = PoseStamped()
            setpoint.header.stamp = rospy.Time.from_sec(time.time())
            setpoint.pose.position.x, setpoint.pose.position.y, setpoint.pose.position.z = self.aim
            setpoint.pose.orientation.w = 1.0
            self.publisher.publish(setpoint)
            time.sleep(0.05)

    def wait(self, until: object, timeout_s: float, what: str) -> None:
        end = time.monotonic() + timeout_s
        while not until():
            assert time.monotonic() < end, f"not in time: {what}; {self.state} {self.pose and self.pose.pose.position}"
            time.sleep(0.05)

    def is_flying(self) -> bool:
        """As the example does: what is not so yet is asked for again, every other second."""
        if time.monotonic() >= self.ask_at:
            if self.state.mode != "OFFBOARD":
                print("set_mode", self.set_mode(0, "OFFBOARD").mode_sent)
            elif not self.state.armed:
                print("arming", self.arming(True).success)
            self.ask_at = time.monotonic() + 2
        return self.state.mode == "OFFBOARD" and self.state.armed and self.is_near()

    def is_near(self) -> bool:
        if self.pose is None:
            return False
        place = self.pose.pose.position
        return math.dist((place.x, place.y, place.z), self.aim) < 0.6

    def fly(self, land: str) -> None:
        self.wait(lambda: self.pose is not None and self.state is not None, 60, "a pose")
        x, y = self.pose.pose.position.x, self.pose.pose.position.y
        self.aim = (x, y, 4.0)
        threading.Thread(target=self.stream, daemon=True).start()
        time.sleep(2)
        self.wait(self.is_flying, 180, "it takes off")
        for corner in ((0, 0), (0, 4), (1, 4), (1, 0), (0, 0)):  # the other vehicles are to the east and the west
            self.aim = (x + corner[0], y + corner[1], 4.0)
            self.wait(self.is_near, 120, f"corner {corner}")
            print(f"corner {corner} mode {self.state.mode}", flush=True)
        assert self.set_mode(custom_mode=land).mode_sent
        self.wait(lambda: not self.state.armed, 120, "it is disarmed")
        print("landed")


def flood(topic: str, seconds: float) -> None:
    """As fast as it goes; every other one is not a number."""
    publisher = rospy.Publisher(topic, PoseStamped, queue_size=1)
    end, sent = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        setpoint = PoseStamped()
        setpoint.pose.position.z = math.nan if sent % 2 else 1e30
        publisher.publish(setpoint)
        sent += 1
    print(sent)


def late(topic: str, count: int) -> None:
    """Messages of before; of a type that nothing here has."""
    came: list[object] = []
    rospy.Subscriber(topic, rospy.AnyMsg, came.append)
    end = time.monotonic() + 60
    while len(came) < count and time.monotonic() < end:
        time.sleep(0.05)
    print(len(came))


def main() -> None:
    word, *rest = sys.argv[1:]
    if word == "sums":
        sums()
        return
    rospy.init_node("test", anonymous=True, disable_signals=True)
    if word == "echo":
        echo(float(rest[0]), rest[1:])
    elif word == "fly":
        Flight(rest[0]).fly(rest[1])
    elif word == "flood":
        flood(rest[0], float(rest[1]))
    elif word == "late":
        late(rest[0], int(rest[1]))
    elif word == "trigger":
        print(rospy.ServiceProxy(rest[0], Trigger)().success)
    elif word == "param":
        answer = rospy.ServiceProxy(f"{rest[0]}/param/get", service_class("mavros_msgs/ParamGet"))(rest[1])
        print(json.dumps([answer.success, answer.value.integer, answer.value.real]))


main()
