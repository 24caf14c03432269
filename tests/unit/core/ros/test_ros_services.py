"""Requests and responses of MAVROS' services."""

from __future__ import annotations

import math
from typing import Any

import pytest

from skygcs.core.mission.formats import read_wpl
from skygcs.core.mission.item import MissionType
from skygcs.core.ros import services
from skygcs.core.ros.interfaces import ros1_interfaces, ros2_interfaces
from skygcs.core.ros.mission_list import MissionList
from skygcs.core.ros.services import RequestError
from support.table import each


def waypoint(command: int, frame: int, x: float, y: float, z: float, **params: float) -> dict[str, Any]:
    known = ros2_interfaces()
    place = {"x_lat": x, "y_long": y, "z_alt": z, "autocontinue": True}
    data = known.encode("mavros_msgs/msg/Waypoint", {"command": command, "frame": frame, **place, **params})
    return known.decode("mavros_msgs/msg/Waypoint", data)


def test_waypoints_are_a_file_that_is_read_as_they_were() -> None:
    items = [waypoint(22, 3, 43.1, -79.1, 10), waypoint(16, 3, 43.2, -79.2, 20, param4=math.nan)]
    for first, pushed in ((False, items), (True, [waypoint(16, 0, 43.0, -79.0, 180), *items])):
        plan, _ = read_wpl(services.wpl_text(pushed, first), "pushed")
        found = plan.items(MissionType.MISSION)
        assert [item.command for item in found] == [22, 16]
        assert found[1].seven[4:] == pytest.approx((43.2, -79.2, 20))
        assert found[1].seven[3] is None
        assert (plan.home is not None and plan.home.lat_deg == 43.0) is first


@each("pushed", [[], [waypoint(16, 3, math.nan, 0, 0)], [waypoint(16, 3, 0, 0, 0)] * 2001])
def test_waypoints_that_are_none(pushed: list[dict[str, Any]]) -> None:
    with pytest.raises(RequestError):
        services.wpl_text(pushed, False)


def test_a_mission_that_was_read_is_a_list() -> None:
    item = {"number": 1, "command": 16, "frame": 3, "params": [0.0, None, 0.0, None, 43.0, -79.0, 10.0]}
    items = [{**item, "autocontinue": True}]
    home = {"lat_deg": 43.5, "lon_deg": -79.5, "alt_amsl_m": 180.0}
    for first, current in ((None, 0), (home, 1)):
        mission = MissionList()
        mission.on_state({"seq": current, "count": 1})
        assert mission.due(True, 0.0) is None  # no list is known yet
        listed = mission.replaced(services.waypoint_messages(items, current, first), first is not None, 0.0)
        ros2_interfaces().encode("mavros_msgs/msg/WaypointList", listed)
        assert listed["current_seq"] == current and listed["waypoints"][-1]["is_current"]
        assert len(listed["waypoints"]) == 1 + current


def test_a_list_is_shown_again_when_another_item_is_current() -> None:
    """mission_protocol_base: handle_mission_current."""
    mission = MissionList()
    mission.on_state(None)
    mission.on_state({"seq": 0, "count": 2})
    mission.replaced([waypoint(16, 3, 43.1, -79.1, 10), waypoint(16, 3, 43.2, -79.1, 10)], False, 0.0)
    assert mission.due(True, 5.0) is None
    mission.on_state({"seq": 1, "count": 2})
    listed = mission.due(True, 5.0)
    assert listed is not None and listed["current_seq"] == 1
    assert [item["is_current"] for item in listed["waypoints"]] == [False, True]
    assert mission.due(True, 10.0) is None
    assert mission.replaced([], False, 10.0) == {"current_seq": 1, "waypoints": []}


def test_a_list_is_shown_once_a_second_and_only_to_readers() -> None:
    mission, shown = MissionList(), []
    mission.replaced([waypoint(16, 3, 43.1, -79.1, 10)] * 50, False, 0.0)
    for tick in range(100):  # the current item is another one ten times a second
        mission.on_state({"seq": tick % 49 + 1, "count": 50})
        if (listed := mission.due(tick >= 30, tick / 10)) is not None:
            shown.append((tick / 10, listed["current_seq"]))
    assert [at for at, _ in shown] == [3.0 + n for n in range(7)]
    assert shown[0][1] == 31  # the newest
    mission.replaced([waypoint(16, 3, 43.1, -79.1, 10)] * 50, False, 10.0)
    mission.on_state({"seq": 7, "count": 50})
    assert mission.due(True, 10.9) is None and mission.due(True, 11.0) is not None


def known(mission: MissionList) -> bool:
    """True if another current item would be published."""
    mission.on_state({"seq": mission._current_seq + 1, "count": mission._count})
    return mission.due(True, 1e9) is not None


def listed(count: int, home_first: bool = False) -> MissionList:
    """A list of so many waypoints, home included, of a vehicle that still reports the one before."""
    mission = MissionList()
    mission.on_state({"seq": 0, "count": 9})
    mission.own_begins()
    mission.on_transfer_ended(0, 10.0)
    mission.own_ended(True, True, 10.1)
    mission.replaced([waypoint(16, 3, 43.1, -79.1, 10)] * count, home_first, 10.1)
    mission.on_state({"seq": 0, "count": 9})
    return mission


def test_a_list_is_forgotten_when_somebody_else_replaces_it() -> None:
    assert known(listed(3))
    for mission_type, is_forgotten in ((0, True), (255, True), (1, False), (2, False)):
        mission = listed(3)
        mission.on_transfer_ended(mission_type, 20.0)
        assert known(mission) is not is_forgotten and mission.third_party_transfers == is_forgotten
    repeated = listed(3)
    for at, is_kept in ((10.9, True), (11.2, False)):
        repeated.on_transfer_ended(0, at)
        assert known(repeated) is is_kept
    for count, home_first, reported, is_kept in (
        *((3, False, 3, True), (3, False, 2, False), (3, False, 4, False), (0, False, 0, True)),
        *((3, True, 2, True), (3, True, 1, False)),
        (3, True, 3, True),  # MISSION_COUNT counts home, MISSION_CURRENT.total does not
        (3, False, None, True),  # it reports none any more
    ):
        mission = listed(count, home_first)
        mission.on_state({"seq": 0, "count": reported})
        assert known(mission) is is_kept, (count, home_first, reported)


def test_a_list_is_forgotten_after_an_own_transfer_that_failed_on_its_way() -> None:
    for was_sent, acks, is_kept in ((True, 0, False), (False, 0, True), (False, 1, False)):
        mission = listed(3)
        mission.own_begins()
        for _ in range(acks):
            mission.on_transfer_ended(0, 20.0)
        mission.own_ended(False, was_sent, 21.0)
        assert known(mission) is is_kept
    late = listed(3)
    late.own_begins()
    late.own_ended(False, False, 21.0)
    late.on_transfer_ended(0, 20.0)  # another's, heard meanwhile
    assert not known(late)


NO_MODES = [
    "",
    "77",
    "-4",
    "+4",
    "0b100",
    "0o4",
    "4_0",
    "\u0664",
    "04",
    "4.0",
    str(2**32 + 4),
    hex(2**32 + 4),
    "9" * 5000,
]


def test_a_mode_by_name_or_by_number() -> None:
    """lib/uas_stringify.cpp: cmode_from_str takes names in any case, else a number."""
    assert services.mode_asked(" auto.land ", 12, 2) == "AUTO.LAND"
    assert services.mode_asked("4", 3, 2) == "GUIDED" and services.mode_asked("15", 3, 1) == "GUIDED"
    assert services.mode_asked("0x60000", 12, 2) == services.mode_asked(str(6 << 16), 12, 2) == "OFFBOARD"
    for text in NO_MODES:
        with pytest.raises(RequestError):
            services.mode_asked(text, 3, 2)


def test_commands() -> None:
    request = {"command": 183, **{f"param{n}": float(n) for n in range(1, 8)}, "param2": math.nan}
    assert services.command_params(request) == [1, None, 3, 4, 5, 6, 7]
    arm, disarm = ({"command": 400, "param1": value} for value in (1.0, 0.0))
    orders = [services.order_of_command(asked) for asked in (request, arm, disarm)]
    assert orders == [None, "vehicles.arm", "vehicles.disarm"]
    for result, number in (("accepted", 0), ("denied", 2), ("refused", 4)):
        ok = result == "accepted"
        assert services.response({"ok": ok, "result": result}) == {"success": ok, "result": number}
    with pytest.raises(RequestError):
        services.command_params({**request, "param1": math.inf})
    for made in (services.command_params, services.command_int):
        with pytest.raises(RequestError, match="0 is not a command"):
            made({**request, "command": 0})
    assert [services.interval_hz(hz) for hz in (-1.0, 0.0, 5.0, 1e9)] == [0.0, None, 5.0, 1000.0]
    assert services.takeoff_height_m({"altitude": 190.0}, {"autopilot": "px4", "position": {"alt_amsl_m": 180.0}}) == 10
    assert services.takeoff_height_m({"altitude": 8.0}, {"autopilot": "ardupilot"}) == 8
    with pytest.raises(RequestError):
        services.takeoff_height_m({"altitude": 190.0}, {"autopilot": "px4"})


def test_parameters() -> None:
    assert services.parameter_value({"value": {"type": 3, "double_value": 0.5}}, ros1=False) == 0.5
    for integer, real, number in ((0, 0.5, 0.5), (3, 0.5, 3), (-2, 0.0, -2), (-2, 0.5, -2), (0, 0.0, 0)):
        assert services.parameter_value({"value": {"integer": integer, "real": real}}, ros1=True) == number
    for value in ({"type": 4, "string_value": "x"}, {"type": 3, "double_value": math.nan}):
        with pytest.raises(RequestError):
            services.parameter_value({"value": value}, ros1=False)
    for value, type_ in ((3.0, "INT32"), (0.5, "REAL32"), (None, None)):
        ros2_interfaces().encode("rcl_interfaces/msg/ParameterValue", services.ros2_value(value, type_))
    assert services.mavros_value(3.0, "INT32") == {"integer": 3}
    assert ros1_interfaces().encode("mavros_msgs/msg/ParamValue", services.mavros_value(0.5, "REAL32"))
