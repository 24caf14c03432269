"""Interfaces: encodings against rosbags, type hashes and MD5 sums against those that ROS itself computed."""

from __future__ import annotations

import pytest

from skygcs.core.ros import interfaces
from skygcs.core.ros.interfaces import InterfaceError, dds_type_name, ros1_interfaces, ros2_interfaces
from skygcs.core.ros.services import ROS1_SERVICES, SERVICES
from skygcs.core.ros.setpoints import SETPOINTS
from skygcs.core.ros.topics import TELEMETRY
from support.table import each

ADD_TWO_INTS = "SRV: example_interfaces/AddTwoInts\nint64 a\nint64 b\n---\nint64 sum\n"


def test_type_hashes_are_those_of_ros() -> None:
    """The two hashes that rmw_zenoh's design document states; the second is a service's, with its event type."""
    known = ros2_interfaces()
    string = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert known.type_hash("std_msgs/msg/String") == string
    for name, text in interfaces.parse_definitions(ADD_TWO_INTS):
        known.store.register(interfaces._parsed(text, name))
    service = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    assert known.type_hash("example_interfaces/srv/AddTwoInts") == service
    assert known.type_hash("mavros_msgs/srv/SetMode") != known.type_hash("mavros_msgs/srv/SetMode_Request")


def test_md5_sums_are_those_of_ros_1() -> None:
    """Stated by `rosmsg md5` of Debian, and in the headers of MAVROS 1."""
    sums = {
        "geometry_msgs/msg/PoseStamped": "d3812c3cbc69362b77dc0b19b345f8f5",
        "sensor_msgs/msg/Imu": "6a62c6daae103f4ff57a132d6f95cec2",
        "mavros_msgs/msg/WaypointReached": "1cda30b7dd9aa4bfb3ebb4ce7b63f5a2",
    }
    found = {name: ros1_interfaces().ros1_definition(name)[1] for name in sums}
    del sums["mavros_msgs/msg/WaypointReached"], found["mavros_msgs/msg/WaypointReached"]
    assert found == sums


def test_messages_are_encoded_and_read() -> None:
    known = ros2_interfaces()
    state = {"header": {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "é"}, "connected": True, "mode": "AUTO.LOITER"}
    data = known.encode("mavros_msgs/msg/State", state)
    assert data[:4] == b"\0\1\0\0"
    read = known.decode("mavros_msgs/msg/State", data)
    assert read["header"] == state["header"] and read["mode"] == "AUTO.LOITER" and read["armed"] is False
    assert known.decode("std_srvs/srv/Trigger_Request", known.encode("std_srvs/srv/Trigger_Request", {})) == {}
    imu = known.decode("sensor_msgs/msg/Imu", known.encode("sensor_msgs/msg/Imu", {}))
    assert imu["orientation_covariance"] == [0.0] * 9
    for topic in TELEMETRY.values():
        assert known.decode(topic.type, known.encode(topic.type, {})) is not None
        assert ros1_interfaces().ros1_definition(topic.type)[1]


@each("fields", [{"no_such": 1}, {"header": {"stampp": {}}}, {"header": 3}, {"orientation_covariance": [1.0]}])
def test_a_message_of_another_shape_is_refused(fields: dict[str, object]) -> None:
    with pytest.raises(InterfaceError):
        ros2_interfaces().encode("sensor_msgs/msg/Imu", fields)


@each("number", [-1, 256, 2**40])
def test_a_number_that_its_field_does_not_take_is_refused(number: int) -> None:
    with pytest.raises(InterfaceError, match="mavros_msgs/msg/State"):
        ros2_interfaces().encode("mavros_msgs/msg/State", {"system_status": number})


def test_bytes_of_another_type_are_refused() -> None:
    known = ros2_interfaces()
    good = known.encode("mavros_msgs/msg/State", {"mode": "OFFBOARD"})
    hostile = [b"", b"\0\1\0\0", good[:-8], good + b"\0" * 9, b"\0\1\0\0" + b"\xff" * 60, b"\0\3\0\0" + good[4:]]
    for data in hostile:
        with pytest.raises(InterfaceError):
            known.decode("mavros_msgs/msg/State", data)
    with pytest.raises(InterfaceError):  # a count of four billion elements takes no memory
        known.decode("mavros_msgs/msg/WaypointList", b"\0\1\0\0\0\0\0\0\xff\xff\xff\xff")


def test_names_in_dds() -> None:
    assert dds_type_name("mavros_msgs/srv/SetMode_Request") == "mavros_msgs::srv::dds_::SetMode_Request_"


def test_every_type_that_is_served_or_read_is_known() -> None:
    known = ros2_interfaces()
    names = [topic.type for topic in (*TELEMETRY.values(), *(topic for topic, _ in SETPOINTS.values()))]
    for name in (*names, *SERVICES.values(), *ROS1_SERVICES.values()):
        assert known.type_hash(name).startswith("RIHS01_")
    for service in (*SERVICES.values(), *ROS1_SERVICES.values()):
        for part in ("Request", "Response"):
            assert known.decode(f"{service}_{part}", known.encode(f"{service}_{part}", {})) is not None
