"""Services of one vehicle against a daemon of the test: what they ask of it, and what mission/waypoints shows."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.ext.ros.bridge import Bridge
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.graph import SharedTopics
from skygcs.ext.ros.offboard import Offboard
from skygcs.ext.ros.vehicle_services import VehicleServices
from skygcs.ext.ros.vehicle_topics import VehicleTopics
from support.ros_node import KeptNode

pytestmark = pytest.mark.looptime

LIST = "/alpha/mavros/mission/waypoints"


class Daemon:
    """Every order succeeds, unless ``ok`` says otherwise."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.ok, self.result = True, "refused"
        """Its result if it is not ok."""
        self.meanwhile: Callable[[], None] = lambda: None

    async def call(self, method: str, **params: Any) -> Any:
        self.asked.append((method, params))
        self.meanwhile()
        outcome = {"ok": self.ok, "message": "done", "result": "accepted" if self.ok else self.result}
        if method == "missions.download":
            item = {"number": 1, "command": 16, "frame": 3, "params": [0.0, None, 0.0, None, 43.0, -79.0, 10.0]}
            return {"outcome": outcome, "mission": [{**item, "autocontinue": True}]}
        return {"outcomes": {"alpha": outcome}}


class Rig:
    def __init__(self, autopilot: str, number: int) -> None:
        self.node, self.daemon = KeptNode(), Daemon()
        self.state: dict[str, Any] = {"name": "alpha", "sysid": 1, "autopilot": autopilot, "connected": True}
        self.vehicle = VehicleTopics(SharedTopics(self.node), RosConfig(), self.state, 0)
        mode = {"autopilot": number, "type": 2, "base_mode": 0x81, "custom_mode": 0, "system_status": 4}
        self.vehicle.on_message("HEARTBEAT", mode, 0)
        self.services = VehicleServices(
            self.node,
            self.vehicle,
            Offboard(),
            lambda: self.daemon,  # type: ignore[arg-type, return-value]
            asyncio.get_running_loop().time,
            lambda: 0,
        )

    def on_current(self, seq: int) -> None:
        self.state["mission"] = {"seq": seq, "item": seq + 1}
        self.services.on_state()

    async def call(self, name: str, type_: str, **fields: Any) -> dict[str, Any]:
        known, request = ros2_interfaces(), f"mavros_msgs/srv/{type_}_Request"
        return await self.services.call(name, known.decode(request, known.encode(request, fields)))

    def lists(self) -> list[tuple[int, list[bool]]]:
        """What was published: the current number, and which waypoints are current."""
        messages = self.node.publications[LIST].messages
        return [(m["current_seq"], [bool(w["is_current"]) for w in m["waypoints"]]) for m in messages]


def places(*latitudes: float) -> list[dict[str, Any]]:
    plain = {"frame": 3, "command": 16, "y_long": -79.0, "z_alt": 5.0, "autocontinue": True}
    return [{**plain, "x_lat": lat} for lat in latitudes]


async def test_the_list_is_shown_when_it_is_pushed_cleared_or_flown() -> None:
    """MAVROS' mission_protocol_base publishes after an accepted transfer, and with each new MISSION_CURRENT."""
    rig = Rig("px4", 12)
    answer = await rig.call("mission/push", "WaypointPush", waypoints=places(43.0, 43.1))
    assert answer == {"success": True, "wp_transfered": 2} and rig.lists() == [(0, [False, False])]
    rig.on_current(1)
    assert len(rig.lists()) == 1  # nobody reads
    rig.node.read(LIST)
    await asyncio.sleep(1.0)
    rig.on_current(1)
    rig.on_current(1)
    assert rig.lists()[1:] == [(1, [False, True])]
    rig.daemon.ok = False
    assert not (await rig.call("mission/push", "WaypointPush", waypoints=places(43.5))).get("success")
    assert not (await rig.call("mission/clear", "WaypointClear"))["success"]
    assert len(rig.lists()) == 2
    rig.daemon.ok = True
    assert (await rig.call("mission/clear", "WaypointClear"))["success"]
    assert rig.lists()[2:] == [(1, [])]
    assert (await rig.call("mission/pull", "WaypointPull"))["wp_received"] == 1
    assert rig.node.publications[LIST].quality == "newest"


async def test_an_ardupilots_list_counts_from_home() -> None:
    rig = Rig("ardupilot", 3)
    await rig.call("mission/push", "WaypointPush", waypoints=places(42.9, 43.0, 43.1))
    rig.node.read(LIST)
    await asyncio.sleep(1.0)
    rig.on_current(2)
    assert rig.lists()[-1] == (2, [False, False, True])


async def test_an_ardupilots_list_is_pulled_with_home_or_not_at_all() -> None:
    """Its wire counts home as 0, so the one item is 1; a list without home would be pushed back with it as home."""
    rig = Rig("ardupilot", 3)
    rig.state["mission"] = {"seq": 1, "item": 1, "count": 1}
    rig.services.on_state()
    assert not (await rig.call("mission/pull", "WaypointPull")).get("success") and rig.lists() == []
    assert "home_position/req_update" in rig.node.last("/rosout")["msg"] and rig.daemon.asked == []
    rig.state["home"] = {"lat_deg": 42.9, "lon_deg": -79.0, "alt_amsl_m": 180.0}
    assert (await rig.call("mission/pull", "WaypointPull"))["wp_received"] == 2
    assert rig.lists() == [(1, [False, True])]
    pulled = rig.node.last(LIST)["waypoints"]
    await rig.call("mission/push", "WaypointPush", waypoints=pulled)
    home, item = rig.daemon.asked[-1][1]["plan"].splitlines()[1:]
    assert "42.9" in home and item.split("\t")[8] == "43.0"


async def test_a_list_that_is_not_the_vehicles_any_more_is_not_shown_as_new() -> None:
    rig = Rig("px4", 12)

    async def pushed() -> int:
        assert (await rig.call("mission/push", "WaypointPush", waypoints=places(43.0, 43.1, 43.2)))["success"]
        rig.node.publications[LIST].readers = 1
        await asyncio.sleep(3.0)
        return len(rig.lists())

    def fly(seq: int) -> int:
        rig.on_current(seq)
        return len(rig.lists())

    assert fly(1) == 0 and await pushed() == 1 and fly(2) == 2
    before = await pushed()
    rig.services.on_message("MISSION_ACK", {"type": 0, "mission_type": 0}, 0.5)
    assert fly(1) == before
    before = await pushed()
    rig.services.forget_mission()
    assert fly(2) == before
    before = await pushed()
    rig.state["mission"] = {"seq": 2, "count": 7}
    rig.services.on_state()
    assert fly(1) == before
    before = await pushed()
    rig.daemon.ok, rig.daemon.result = False, "timeout"
    await rig.call("mission/clear", "WaypointClear")
    assert fly(2) == before


async def test_a_mission_that_is_replaced_while_it_is_pulled_is_none() -> None:
    rig = Rig("px4", 12)
    rig.daemon.meanwhile = lambda: rig.services.on_message("MISSION_ACK", {"type": 0, "mission_type": 0}, 0.0)
    assert not (await rig.call("mission/pull", "WaypointPull")).get("success") and rig.lists() == []


async def test_a_mode_is_set_by_name_or_number() -> None:
    rig = Rig("ardupilot", 3)
    for asked in ("loiter", "5", "0x5"):
        assert (await rig.call("set_mode", "SetMode", custom_mode=asked))["mode_sent"]
        assert rig.daemon.asked.pop() == ("vehicles.mode", {"targets": "alpha", "mode": "LOITER"})
    for asked in ("", "99"):
        assert not (await rig.call("set_mode", "SetMode", custom_mode=asked, base_mode=216)).get("mode_sent")
    assert rig.daemon.asked == []


@pytest.mark.parametrize("end", ["ack", "reboot", "lost"])
async def test_the_bridge_passes_on_what_ends_a_list(end: str) -> None:
    node = KeptNode()
    bridge = Bridge(node, RosConfig(commands="all"), lambda: 0)
    daemon: Any = Daemon()
    bridge._gcs = daemon
    state = {"name": "alpha", "sysid": 1, "compid": 1, "connected": True, "autopilot": "px4"}
    bridge.on_state(state)
    bridge.on_state({**state, "name": "bravo", "sysid": 2})
    pushed = await node.services["/alpha/mavros/mission/push"].call(waypoints=places(43.0, 43.1))
    assert pushed["success"]
    node.read(LIST)
    await asyncio.sleep(3.0)
    control = bridge.controls["alpha"]
    for compid, vehicle in ((191, "alpha"), (1, "bravo")):  # a companion's, another vehicle's
        ack = {"vehicle": vehicle, "compid": compid, "name": "MISSION_ACK", "age_s": 0.0}
        bridge.on_message({**ack, "fields": {"type": 0, "mission_type": 0}})
    control.on_event({"kind": "reboot", "vehicle": "bravo"})
    bridge.on_state({**state, "mission": {"seq": 1, "count": 2}})
    assert [message["current_seq"] for message in node.publications[LIST].messages] == [0, 1]
    assert "MISSION_ACK" in bridge._sources
    match end:
        case "ack":
            ack = {"vehicle": "alpha", "compid": 1, "name": "MISSION_ACK", "age_s": 0.0}
            bridge.on_message({**ack, "fields": {"type": 0, "mission_type": 0}})
        case "reboot":
            control.on_event({"kind": "reboot", "vehicle": "alpha"})
        case _:
            control.lost()
    await asyncio.sleep(3.0)
    bridge.on_state({**state, "mission": {"seq": 0, "count": 2}})
    assert node.publications[LIST].sent == 2
