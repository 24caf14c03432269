"""A program on Fast DDS alone reads every topic that the bridge publishes for three vehicles, writes every topic that
it reads and calls every service. What there is comes from the bridge itself, so none is left out."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterator
from typing import Any

import pytest

from ros.bridge_graph import graph_of
from ros.conftest import VEHICLES, RosFleet
from ros.every_topic import EveryTopicNode, Message
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.core.ros.px4_telemetry import PX4_SOURCES, PX4_TELEMETRY
from skygcs.core.ros.ros_names import ros_name
from skygcs.core.ros.topics import SOURCES, TELEMETRY
from skygcs.ext.ros.config import RosConfig
from support.needed import needs
from support.process import wait_until
from support.system_programs import FAST_DDS

PX4 = ("alpha", "bravo")
AUTOPILOTS = {"alpha": (1, "px4"), "bravo": (2, "px4"), "charlie": (3, "ardupilot")}

SUCCEEDED, CANCELED = 4, 5
"""action_msgs' GoalStatus."""


"""Three vehicles fly twice, in real time."""


@pytest.fixture(scope="module")
def node(fleet: RosFleet, tmp_path_factory: pytest.TempPathFactory) -> Iterator[EveryTopicNode]:
    needs("test-ros", *FAST_DDS)
    graph = asyncio.run(graph_of(RosConfig(commands="all", px4_msgs="1.16"), AUTOPILOTS))
    with EveryTopicNode(tmp_path_factory.mktemp("node"), fleet.domain, ros2_interfaces("1.16"), graph) as running:
        running.wait_for_the_bridge(fleet)
        yield running


def test_every_topic_that_is_read_is_written_and_nobody_flies(node: EveryTopicNode, fleet: RosFleet) -> None:
    """Each message is taken as one of its interface; of vehicles that nobody engaged each setpoint is refused."""

    def have_come() -> bool:
        """What was written before the bridge knew its writer is lost: it is written again."""
        missing = node.graph.inputs.keys() - counts(fleet).keys()
        for name in missing:
            node.write(name, {})
        time.sleep(1.5)  # the bridge reports once a second
        return not missing

    wait_until(have_come, "every message has come")
    assert not any(counts(fleet)[name][1] for name in node.graph.inputs)
    assert not any(state["armed"] or state["control"] for state in fleet.vehicles().values())
    acks = "/alpha/fmu/out/vehicle_command_ack"
    ack, *_ = wait_until(lambda: node.dump(acks)[acks], "the command is answered")
    assert node.checked("px4_msgs/msg/VehicleCommandAck", ack)["result"] != 0


def counts(fleet: RosFleet) -> dict[str, tuple[int, int]]:
    """Messages that came, and that were not taken."""
    return {t["name"]: (t["count"], t["refused"]) for t in fleet.call("ros.status")["report"]["topics"]}


class Calls:
    """Calls of the services of all vehicles, one after the other, each for all vehicles at the same time."""

    def __init__(self, node: EveryTopicNode, fleet: RosFleet) -> None:
        self.node, self.fleet = node, fleet
        self.called: set[str] = set()
        self.reasons: dict[str, str] = {}
        """Why the goals ended whose results came last."""

    def __call__(self, service: str, **request: Any) -> dict[str, dict[str, Any]]:
        """The responses by vehicle. A value of the request: for all, or a dictionary by autopilot or by vehicle."""
        begun = {}
        for vehicle, (_, autopilot) in AUTOPILOTS.items():
            own = {k: v.get(autopilot, v.get(vehicle)) if isinstance(v, dict) else v for k, v in request.items()}
            name = f"/{vehicle}/{service}"
            self.called.add(name)
            begun[vehicle] = name, self.node.begin(name, {k.replace("__", "."): v for k, v in own.items()})
        return {vehicle: self.node.reply(number, name) for vehicle, (name, number) in begun.items()}

    def succeed(self, service: str, field: str = "success", **request: Any) -> dict[str, dict[str, Any]]:
        answers = self(service, **request)
        assert {vehicle: answer[field] for vehicle, answer in answers.items()} == dict.fromkeys(VEHICLES, True), (
            service,
            self.fleet.stderr[-2000:],
        )
        return answers

    def until(self, what: str, condition: Any) -> None:
        wait_until(lambda: all(condition(state) for state in self.fleet.vehicles().values()), what)

    def act(self, action: str, goal: int, **fields: Any) -> None:
        uuid = {"goal_id__uuid": [goal] * 16}
        self.succeed(f"skygcs/{action}/_action/send_goal", "accepted", **uuid, **fields)

    def result(self, action: str, goal: int) -> dict[str, int]:
        answers = self(f"skygcs/{action}/_action/get_result", goal_id__uuid=[goal] * 16)
        self.reasons = {vehicle: answer["result"]["reason"] for vehicle, answer in answers.items()}
        return {vehicle: answer["status"] for vehicle, answer in answers.items()}

    def cancel(self, action: str, goal: int) -> dict[str, int]:
        answers = self(f"skygcs/{action}/_action/cancel_goal", goal_info__goal_id__uuid=[goal] * 16)
        return {vehicle: len(answer["goals_canceling"]) for vehicle, answer in answers.items()}


def waypoints(autopilot: str) -> dict[str, Any]:
    """Two places; an ArduPilot's list begins with home."""
    lat = [43.7806] * (autopilot == "ardupilot") + [43.7807, 43.7808]
    made: dict[str, Any] = {"start_index": 0}
    for n, value in enumerate(lat):
        plain = {"frame": 3, "command": 16, "x_lat": value, "y_long": -79.4653, "z_alt": 5.0}
        made |= {f"waypoints__{n}__{key}": each for key, each in plain.items()}
    return made


def parameters_and_streams(call: Calls) -> None:
    answers = call.succeed("mavros/param/get", param_id={"px4": "MAV_SYS_ID", "ardupilot": "SYSID_THISMAV"})
    for vehicle, answer in answers.items():
        assert answer["value"]["integer"] or answer["value"]["real"] == AUTOPILOTS[vehicle][0]
    name = {"px4": "MIS_TAKEOFF_ALT", "ardupilot": "WPNAV_SPEED"}
    value = {"px4": 3.5, "ardupilot": 450.0}
    answers = call.succeed("mavros/param/set", param_id=name, value__type=3, value__double_value=value)
    for vehicle, (_, autopilot) in AUTOPILOTS.items():
        assert answers[vehicle]["value"]["double_value"] == value[autopilot]
        told = call.fleet.call("params.get", targets=vehicle, names=[name[autopilot]])
        assert told["outcomes"][vehicle][name[autopilot]]["value"] == value[autopilot]
    answers = call.succeed("mavros/param/pull")
    assert all(answer["param_received"] > 20 for answer in answers.values())
    assert call("mavros/set_stream_rate", stream_id=0, message_rate=4, on_off=True) == {v: {} for v in VEHICLES}
    call.succeed("mavros/set_message_interval", message_id=32, message_rate=5)
    call.succeed("mavros/home_position/req_update")
    call.succeed("mavros/cmd/set_home", current_gps=True)


def missions(call: Calls) -> None:
    made = {autopilot: waypoints(autopilot) for autopilot in ("px4", "ardupilot")}
    keys = made["ardupilot"].keys()
    last = {key: {name: each.get(key) for name, each in made.items()} for key in keys}
    begun = {}
    for vehicle, (_, autopilot) in AUTOPILOTS.items():  # the lists have different lengths
        own = {key.replace("__", "."): each[autopilot] for key, each in last.items() if each[autopilot] is not None}
        name = f"/{vehicle}/mavros/mission/push"
        call.called.add(name)
        begun[vehicle] = name, call.node.begin(name, own)
    for vehicle, (name, number) in begun.items():
        count = 2 + (vehicle not in PX4)
        assert call.node.reply(number, name) == {"success": True, "wp_transfered": count}, call.fleet.stderr[-2000:]
    for vehicle, answer in call.succeed("mavros/mission/pull").items():
        assert answer["wp_received"] == 2 + (vehicle not in PX4)
    call.succeed("mavros/mission/set_current", wp_seq={"px4": 1, "ardupilot": 2})
    for vehicle in VEHICLES:
        topic = f"/{vehicle}/mavros/mission/waypoints"
        listed = wait_until(lambda topic=topic: call.node.dump(topic)[topic], "a list has come")
        fields = call.node.checked("mavros_msgs/msg/WaypointList", listed[-1])
        places = [(w["x_lat"], w["y_long"], w["z_alt"]) for w in fields["waypoints"]][-2:]
        assert places == [pytest.approx((lat, -79.4653, 5.0), abs=1e-6) for lat in (43.7807, 43.7808)], vehicle
    call.succeed("mavros/mission/clear")


def commands_and_modes(call: Calls) -> None:
    home = {"command": 512, "param1": 242}  # MAV_CMD_REQUEST_MESSAGE, HOME_POSITION
    call.succeed("mavros/cmd/command", **home)
    call.succeed("mavros/cmd/command_int", **home)
    call.succeed("mavros/set_mode", "mode_sent", custom_mode={"px4": "AUTO.LOITER", "ardupilot": "GUIDED"})
    call.succeed("mavros/cmd/arming", value=True)
    call.until("they are armed", lambda state: state["armed"])
    call.succeed("mavros/cmd/takeoff", altitude={"px4": "nan", "ardupilot": 4.0})
    call.until("they fly", lambda state: state["landed"] == "in_air" and state["position"]["alt_rel_m"] > 2)
    call.succeed("mavros/cmd/land")
    call.until("they have landed", lambda state: not state["armed"])


def actions(call: Calls) -> None:
    assert call.cancel("takeoff", 9) == dict.fromkeys(VEHICLES, 0)  # nothing is under way
    call.act("takeoff", 1, goal__height_m=5.0, goal__arm=True)
    assert call.result("takeoff", 1) == dict.fromkeys(VEHICLES, SUCCEEDED)
    places = {vehicle: state["position"]["enu_m"] for vehicle, state in call.fleet.vehicles().items()}
    x_m, y_m = ({vehicle: place[axis] for vehicle, place in places.items()} for axis in (0, 1))  # straight up
    call.act("goto", 2, goal__position__x=x_m, goal__position__y=y_m, goal__position__z=30.0)
    for vehicle in VEHICLES:
        topic = f"/{vehicle}/skygcs/goto/_action/feedback"
        wait_until(lambda topic=topic: call.node.dump(topic)[topic], "it is on its way")
    assert call.cancel("goto", 2) == dict.fromkeys(VEHICLES, 1)
    assert call.result("goto", 2) == dict.fromkeys(VEHICLES, CANCELED)
    call.until("they hold", lambda state: max(map(abs, state["position"]["vel_enu_mps"])) < 0.3)
    call.act("land", 3)
    assert call.cancel("land", 9) == dict.fromkeys(VEHICLES, 0)
    ends = call.result("land", 3)
    print(f"land ended as {ends}: {call.reasons}")
    assert ends.keys() == set(VEHICLES) and {ends[vehicle] for vehicle in PX4} == {SUCCEEDED}, call.reasons
    call.until("they have landed", lambda state: not state["armed"])


def test_every_service_is_called(node: EveryTopicNode, fleet: RosFleet) -> None:
    call = Calls(node, fleet)
    call.until("they know where they are", lambda state: (state["position"] or {}).get("lat_deg") is not None)
    parameters_and_streams(call)
    missions(call)
    commands_and_modes(call)
    actions(call)
    assert call.called == node.graph.services.keys()


def test_every_topic_is_read(node: EveryTopicNode, fleet: RosFleet) -> None:
    """After the flights. What rosbags reads in the bytes of each message is what Fast DDS read; a topic without
    messages is one of whose MAVLink messages the vehicle has sent none."""
    came = node.dump()
    assert came.keys() == node.graph.topics.keys()
    silent: dict[str, list[str]] = {}
    for name, messages in came.items():
        for message in messages:
            node.checked(node.graph.topics[name][0], message)
        if not messages:
            silent[name] = sources_of(name)
    for name, sources in silent.items():
        vehicle = name.split("/")[1]
        assert sources, f"{name}: nothing came, and it is not made of a MAVLink message"
        for source in sources:
            came_before = name.endswith("/gp_origin")  # sent once, and perhaps before the process of ROS was there
            assert came_before or fleet.call("messages.latest", target=vehicle, name=source) is None, (name, source)
        print(f"{name}: nothing, because no {' and no '.join(sources)} came{', or only before' if came_before else ''}")
    read = {name.split("/", 3)[3] for name, messages in came.items() if messages and "/mavros/" in name}
    assert len(read) > 25, sorted(read)


def sources_of(topic: str) -> list[str]:
    """The MAVLink messages that a vehicle's topic is made of."""
    _, _, space, name = topic.split("/", 3)
    if space == "mavros":
        return [source for source, made in SOURCES.items() if name in made.topics]
    plain = next((one for one in PX4_TELEMETRY if name.removeprefix("out/").startswith(one)), None)
    return [source for source, made in PX4_SOURCES.items() if plain in made.topics]


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_values_are_those_of_the_daemon(node: EveryTopicNode, fleet: RosFleet, vehicle: str) -> None:
    """A vehicle that stands on the ground again."""
    state = fleet.vehicles()[vehicle]
    came = node.dump(f"/{vehicle}/") | node.dump("/tf") | node.dump("/skygcs/fleet")

    def last(topic: str) -> dict[str, Any]:
        name = f"/{vehicle}/{topic}" if not topic.startswith("/") else topic
        message: Message = came[name][-1]
        return node.checked(node.graph.topics[name][0], message)

    place, local = state["position"], state["local"]["pos_enu_m"]
    fix = last("mavros/global_position/global")
    assert (fix["latitude"], fix["longitude"]) == pytest.approx((place["lat_deg"], place["lon_deg"]), abs=1e-5)
    assert fix["header"]["frame_id"] == f"{ros_name(vehicle)}/base_link"
    assert last("mavros/global_position/rel_alt")["data"] == pytest.approx(place["alt_rel_m"], abs=1)
    shown = last("mavros/state")
    assert (shown["mode"], shown["armed"], shown["connected"]) == (state["mode"], False, True)
    pose = last("mavros/local_position/pose")["pose"]["position"]
    assert [pose[axis] for axis in "xyz"] == pytest.approx(local, abs=1)
    assert last("mavros/battery")["voltage"] == pytest.approx(state["battery"]["volts"], abs=0.5)
    home = last("mavros/home_position/home")["geo"]
    assert home["latitude"] == pytest.approx(state["home"]["lat_deg"], abs=1e-6)
    fleet_row = next(one for one in last("/skygcs/fleet")["vehicles"] if one["name"] == vehicle)
    row = fleet_row["system_id"], fleet_row["mode"], fleet_row["namespace_root"]
    assert row == (state["sysid"], state["mode"], f"/{vehicle}")
    assert {one["child_frame_id"] for m in came["/tf"] for one in m.fields["transforms"]} <= {
        f"{name}/base_link" for name in VEHICLES
    }
    for action in ("goto", "takeoff", "land"):
        feedback = last(f"skygcs/{action}/_action/feedback")["feedback"]
        assert math.isfinite(feedback["height_m"])
    if vehicle in PX4:
        px4 = last("fmu/out/vehicle_global_position")
        assert (px4["lat"], px4["lon"]) == pytest.approx((place["lat_deg"], place["lon_deg"]), abs=1e-5)
        assert last("fmu/out/vehicle_status_v1")["system_id"] == state["sysid"]
        ned = last("fmu/out/vehicle_local_position")
        assert [ned["y"], ned["x"], -ned["z"]] == pytest.approx(local, abs=1)


def test_every_topic_has_its_name_in_one_of_the_tables(node: EveryTopicNode) -> None:
    """The graph that was read is that of the tables, and not an empty one."""
    for vehicle in VEHICLES:
        assert {f"/{vehicle}/mavros/{name}" for name in TELEMETRY} <= node.graph.topics.keys()
    assert len(node.graph.topics) > 150 and len(node.graph.services) == 3 * 26 and len(node.graph.inputs) > 30
