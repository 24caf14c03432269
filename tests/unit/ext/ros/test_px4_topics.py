"""PX4's own topics of a bridge: who has them, what they lead to, and in which order commands are carried out."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from skygcs.core.geo import EAST_DEG, Origin
from skygcs.core.ros.fleet_origin import FleetOrigin
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.ext.ros.bridge import Bridge
from skygcs.ext.ros.commands import status_lines
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.dds import MOST_UNDER_WAY_S, SERVICE_HEADER, DdsNode, Network
from skygcs.ext.ros.fresh_node import FreshNode
from skygcs.ext.ros.late_gate import LateGate
from skygcs.ext.ros.methods import RosReport
from support.ros_node import KeptNode

NOW_NS = 1_700_000_000 * 10**9
PLACE = {"lat_deg": 43.7806, "lon_deg": -79.4653, "alt_amsl_m": 180.0}
UNSET = [math.nan] * 3
HOLDS = {"position": [0.0, 0.0, -4.0], "velocity": UNSET, "acceleration": UNSET, "yaw": 0.0, "yawspeed": math.nan}


class Daemon:
    """What the bridge calls; orders wait while its gate is closed."""

    def __init__(self) -> None:
        self.orders: list[tuple[str, dict[str, Any]]] = []
        self.setpoints: list[dict[str, Any]] = []
        self.refuses: set[str] = set()
        self.gate = asyncio.Event()
        self.gate.set()

    async def call(self, method: str, **params: Any) -> Any:
        if method == "vehicles.request":
            return {"outcomes": {}}
        await self.gate.wait()
        self.orders.append((method, params))
        ok = method not in self.refuses
        outcome = {"ok": ok, "result": "accepted" if ok else "denied", "message": "" if ok else "not now"}
        return {"outcomes": {params["targets"]: outcome}}

    async def setpoint(self, name: str, came_at: float, **params: Any) -> dict[str, Any]:
        self.setpoints.append(params)
        return {"ok": True, "message": ""}


class Rig:
    """A bridge with alpha, a PX4, and charlie, an ArduPilot."""

    def __init__(self, **config: Any) -> None:
        self.node = KeptNode()
        self.daemon = Daemon()
        self.bridge = Bridge(self.node, RosConfig(**{"px4_msgs": "1.16", "commands": "all", **config}), lambda: NOW_NS)
        self.bridge._gcs = self.daemon  # type: ignore[assignment]
        self.bridge._origin = FleetOrigin(Origin(**PLACE, x_heading_deg=EAST_DEG), 1)
        self.state("alpha", 1, "px4")
        self.state("charlie", 3, "ardupilot")

    def state(self, name: str, sysid: int, autopilot: str, **more: Any) -> None:
        state = {"name": name, "sysid": sysid, "compid": 1, "connected": True, "autopilot": autopilot}
        self.bridge.on_state({**state, "armed": False, "mode": "AUTO.LOITER", "ekf_origin": PLACE, **more})

    def heartbeat(self, name: str) -> None:
        mode = {"autopilot": 12, "type": 2, "base_mode": 0x91, "custom_mode": 0x3040000, "system_status": 4}
        self.bridge.on_message({"vehicle": name, "compid": 1, "name": "HEARTBEAT", "fields": mode, "age_s": 0.0})

    def stream(self, **more: Any) -> None:
        self.node.subscribers["/alpha/fmu/in/offboard_control_mode"].give(position=True)
        self.node.subscribers["/alpha/fmu/in/trajectory_setpoint"].give(**{**HOLDS, **more})

    def command(self, number: int, *params: float, target: int = 1) -> None:
        values = {f"param{n}": value for n, value in enumerate(params, 1)}
        self.node.subscribers["/alpha/fmu/in/vehicle_command"].give(
            command=number, target_system=target, target_component=1, source_system=9, **values
        )

    def acks(self) -> list[tuple[int, int]]:
        messages = self.node.publications["/alpha/fmu/out/vehicle_command_ack"].messages
        return [(message["command"], message["result"]) for message in messages]


def run(test: Callable[[Rig], Awaitable[None]], **config: Any) -> None:
    async def main() -> None:
        rig = Rig(**config)
        await test(rig)
        for control in rig.bridge.controls.values():
            control.lost()
        await asyncio.sleep(0)

    asyncio.run(main())


async def settle() -> None:
    for _ in range(20):
        await asyncio.sleep(0)


def test_only_px4s_have_px4s_topics_and_only_if_they_are_wanted() -> None:
    async def check(rig: Rig) -> None:
        names = [*rig.node.publications, *rig.node.subscribers]
        assert "/alpha/fmu/out/vehicle_status_v1" in names and "/alpha/fmu/in/vehicle_command" in names
        assert not [name for name in names if name.startswith("/charlie/fmu")]
        rig.state("delta", 4, "")
        assert "/delta/fmu/out/vehicle_status_v1" not in rig.node.publications
        rig.state("delta", 4, "px4")
        rig.state("delta", 4, "px4")
        assert "/delta/fmu/out/vehicle_status_v1" in rig.node.publications

    run(check)

    async def none(rig: Rig) -> None:
        assert not [name for name in (*rig.node.publications, *rig.node.subscribers) if "/fmu/" in name]

    run(none, px4_msgs="none")

    async def no_commands(rig: Rig) -> None:
        assert "/alpha/fmu/in/trajectory_setpoint" in rig.node.subscribers
        assert "/alpha/fmu/in/vehicle_command" not in rig.node.subscribers

    run(no_commands, commands="setpoints")

    async def no_setpoints(rig: Rig) -> None:
        assert not rig.node.subscribers

    run(no_setpoints, commands="none")


def test_telemetry_is_sent_while_it_is_read_and_asks_for_its_messages() -> None:
    async def check(rig: Rig) -> None:
        topic = "/alpha/fmu/out/vehicle_status_v1"
        rig.heartbeat("alpha")
        assert rig.node.publications[topic].sent == 0
        rig.node.read(topic)
        rig.heartbeat("alpha")
        assert (rig.node.last(topic)["nav_state"], rig.node.last(topic)["arming_state"]) == (4, 2)
        assert rig.bridge.vehicles["alpha"].wanted_messages() == {"HEARTBEAT", "EXTENDED_SYS_STATE", "SYS_STATUS"}
        rig.stream()
        rig.command(176, 1, 6)
        await settle()
        rig.heartbeat("alpha")
        assert rig.node.last(topic)["nav_state"] == 14  # nodes wait for it, as for MAVROS' state

    run(check)


def test_offboard_and_arming_at_once_are_carried_out_in_their_order() -> None:
    async def check(rig: Rig) -> None:
        rig.node.read("/alpha/fmu/out/vehicle_command_ack")
        rig.state("alpha", 1, "px4", mode="AUTO.LAND")
        rig.stream()
        rig.daemon.gate.clear()
        rig.command(176, 1, 6)
        rig.command(400, 1)
        await settle()
        assert rig.daemon.orders == [] and rig.acks() == []
        rig.daemon.gate.set()
        await settle()
        assert [method for method, _ in rig.daemon.orders] == ["vehicles.mode", "vehicles.arm"]
        assert rig.acks() == [(176, 0), (400, 0)]
        assert rig.bridge.controls["alpha"].stream.offboard.state == "wished"

    run(check)


def test_commands_that_fail_are_acknowledged_so_and_logged() -> None:
    async def check(rig: Rig) -> None:
        rig.node.read("/alpha/fmu/out/vehicle_command_ack")
        rig.command(176, 1, 6)  # without setpoints
        rig.command(70_000)
        rig.daemon.refuses.add("vehicles.arm")
        rig.command(400, 1)
        rig.command(400, 1, target=2)  # another vehicle's
        await settle()
        assert rig.acks() == [(176, 4), (70_000, 4), (400, 2)]
        texts = [message["msg"] for message in rig.node.publications["/rosout"].messages]
        assert any("no setpoint came" in text for text in texts) and any("70000" in text for text in texts)
        assert any("not now" in text for text in texts)

    run(check)


def test_a_flood_of_commands_is_bounded() -> None:
    async def check(rig: Rig) -> None:
        rig.node.read("/alpha/fmu/out/vehicle_command_ack")
        rig.daemon.gate.clear()
        for _ in range(1000):
            rig.command(400, 1)
        assert rig.acks().count((400, 1)) == 1000 - 8
        report = RosReport(**rig.bridge.report(1.0))
        assert {vehicle.name: vehicle.commands_rejected for vehicle in report.vehicles}["alpha"] == 1000 - 8
        shown = "\n".join(status_lines({"report": report.model_dump(), "age_s": 0.0, "restarts": 0}))
        assert "alpha  /alpha  off  992 commands rejected\n" in shown and "setpoints" not in shown
        rig.daemon.gate.set()
        await settle()
        assert len(rig.daemon.orders) == 8
        rig.command(400, 1)
        await settle()
        assert rig.acks()[-1] == (400, 0)

    run(check)


def test_what_ends_a_flight_goes_at_once_in_place_of_what_waits() -> None:
    async def check(rig: Rig) -> None:
        rig.node.read("/alpha/fmu/out/vehicle_command_ack")
        rig.daemon.gate.clear()
        for _ in range(9):
            rig.command(511, 30, 1e5)
        await settle()
        for number in (21, 400):
            for _ in range(100):
                rig.command(number, 0)
        rig.command(176, 1, 4, 6)  # AUTO.LAND
        rig.command(400, 1)
        await settle()
        rig.daemon.gate.set()
        await settle()
        asked = [method.removeprefix("vehicles.") for method, _ in rig.daemon.orders]
        assert asked == ["land", "disarm", "mode", "arm"]
        assert {(511, 6), (511, 1), (21, 5), (400, 5)} <= set(rig.acks())
        assert rig.acks()[-4:] == [(21, 0), (400, 0), (176, 0), (400, 0)]

    run(check)


def test_setpoints_go_the_way_of_mavros_setpoints() -> None:
    async def check(rig: Rig) -> None:
        stream = rig.bridge.controls["alpha"].stream
        rig.stream()
        await settle()
        assert rig.daemon.setpoints == [] and "not under control" in (stream.refusal or "")
        rig.state("alpha", 1, "px4", armed=True, control={"state": "flying"})
        rig.stream(position=[1.0, 2.0, -4.0])
        await settle()
        (found,) = rig.daemon.setpoints
        assert [round(value, 3) for value in found["pos_enu_m"]] == [2.0, 1.0, 4.0]
        rig.stream(position=UNSET)
        assert "NaN" in (stream.refusal or "") and len(rig.daemon.setpoints) == 1
        assert any("NaN" in message["msg"] for message in rig.node.publications["/rosout"].messages)

    run(check)


# -- Requests of DDS on their way to a handler, at a real participant of the loopback.


ROWS = [(0.0, True), (MOST_UNDER_WAY_S - 0.1, True), (-3600.0, True), (MOST_UNDER_WAY_S + 0.1, False)]


async def test_a_request_that_was_long_under_way_orders_nothing_but_the_end_of_a_flight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    handled: list[bool] = []
    logged: list[str] = []

    async def handle(request: dict[str, Any]) -> dict[str, Any]:
        handled.append(bool(request["value"]))
        return {"success": True}

    interfaces, type_ = ros2_interfaces("1.16"), "mavros_msgs/srv/CommandBool"
    node = DdsNode(Network(87, True, ()), interfaces, asyncio.get_running_loop(), lambda: NOW_NS)
    fresh = FreshNode(node, LateGate(lambda: True), lambda name, reason: logged.append(f"{name}: {reason}"))
    try:
        fresh.serve("/alpha/mavros/cmd/arming", type_, handle)
        service = node.services["/alpha/mavros/cmd/arming"]
        answers: list[bytes] = []
        service.replies.write_bytes = answers.append  # type: ignore[method-assign]
        for arm in (True, False):
            data = interfaces.encode(f"{type_}_Request", {"value": arm})
            for age_s, _ in ROWS:
                service._on_request(data[:4] + SERVICE_HEADER.pack(1, 1) + data[4:], NOW_NS - round(age_s * 1e9))
            await asyncio.sleep(0.01)
    finally:
        node.close()
    head = 4 + SERVICE_HEADER.size
    read = [interfaces.decode(f"{type_}_Response", answer[:4] + answer[head:]) for answer in answers]
    assert [answer["success"] for answer in read] == [asked for _, asked in ROWS] + [True] * len(ROWS)
    assert handled == [True] * 3 + [False] * 4
    assert len(logged) == 1 and "5.1 s ago" in logged[0]
