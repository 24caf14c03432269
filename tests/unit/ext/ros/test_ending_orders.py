"""Orders, modes and requests that end a flight: each is recognised by its name, and only these are executed late."""

from __future__ import annotations

import asyncio
from typing import Any

from skygcs.core.ros.setpoints import Demand
from skygcs.errors import RpcError
from skygcs.ext.ros.bridge import Bridge
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.ending_orders import _REQUESTS, ENDING_METHODS, ENDING_MODES
from skygcs.ext.ros.late_gate import LATE
from support.extension_parts import ALL_METHODS
from support.ros_node import KeptNode
from support.table import each

PX4 = ("AUTO.LAND", "AUTO.LOITER", "AUTO.PRECLAND", "AUTO.RTL")
ARDUPILOT = (
    *("AUTOLAND", "AUTO_RTL", "BRAKE", "HOLD", "LAND", "LOITER", "LOITERALTQLAND", "POSHOLD", "QLAND", "QLOITER"),
    *("QRTL", "RTL", "SMART_RTL", "STOP"),
)


class Daemon:
    def __init__(self) -> None:
        self.asked: list[str] = []
        self.fault: Exception | None = None

    async def call(self, method: str, **params: Any) -> Any:
        if self.fault is not None:
            raise self.fault
        self.asked.append(str(params.get("mode", method)))
        return {"outcomes": {"alpha": {"ok": True, "message": "", "result": "accepted"}}}


class Rig:
    """A bridge with alpha, a PX4; its daemon does all that it is asked for."""

    def __init__(self, **state: Any) -> None:
        self.node, self.daemon = KeptNode(), Daemon()
        self.bridge = Bridge(self.node, RosConfig(commands="all"), lambda: 0)
        gcs: Any = self.daemon
        self.bridge._gcs = gcs
        alpha = {"name": "alpha", "sysid": 1, "compid": 1, "connected": True, "autopilot": "px4", "ekf_origin": {}}
        self.bridge.on_state({**alpha, "armed": True, "landed": "in_air", **state})
        self.stream = self.bridge.controls["alpha"].stream

    def stream_setpoints(self) -> None:
        demand = Demand("velocity", {"vel_enu_mps": [0.0, 0.0, 0.0]})
        self.stream.offboard.on_demand(demand, asyncio.get_running_loop().time())

    async def call(self, name: str, **fields: Any) -> list[str]:
        self.daemon.asked.clear()
        await self.node.services[f"/alpha/mavros/{name}"].call(**fields)
        return list(self.daemon.asked)


def test_every_name_is_one_of_the_daemon_and_of_its_services() -> None:
    assert ALL_METHODS.keys() >= ENDING_METHODS and {*PX4, *ARDUPILOT, "PRECLAND"} == ENDING_MODES
    served = served_by_a_bridge()
    assert [tail for tail in _REQUESTS if not any(name.endswith(tail) for name in served)] == []


def served_by_a_bridge() -> list[str]:
    async def names() -> list[str]:
        return list(Rig().node.services)

    return asyncio.run(names())


@each(
    "name, fields, asked",
    [
        *(("set_mode", {"custom_mode": mode}, [mode]) for mode in ("AUTO.LAND", "AUTO.RTL", "AUTO.LOITER", "LAND")),
        *(("set_mode", {"custom_mode": mode}, []) for mode in ("OFFBOARD", "AUTO.MISSION", "GUIDED", "POSCTL")),
        ("cmd/arming", {"value": False}, ["vehicles.disarm"]),
        ("cmd/arming", {"value": True}, []),
        ("cmd/land", {}, ["vehicles.land"]),
        ("cmd/takeoff", {}, []),
        ("cmd/command", {"command": 20}, ["vehicles.rtl"]),
        ("cmd/command", {"command": 185, "param1": 1.0}, ["vehicles.command"]),
        ("cmd/command", {"command": 185}, []),
        ("cmd/command", {"command": 22}, []),
        ("cmd/command_int", {"command": 21}, ["vehicles.command"]),
        ("param/set", {}, []),
    ],
)
async def test_only_what_ends_a_flight_is_carried_out_late(name: str, fields: dict[str, Any], asked: list[str]) -> None:
    rig = Rig()
    rig.stream_setpoints()
    LATE.set("late")
    assert await rig.call(name, **fields) == asked
    assert rig.stream.offboard.state == "idle"
    assert asked or "late" in rig.node.last("/rosout")["msg"]


async def test_a_wish_that_fails_is_none() -> None:
    rig = Rig(armed=False, mode="AUTO.LAND")
    rig.stream_setpoints()
    rig.daemon.fault = RpcError(-32000, "not now")
    await rig.call("set_mode", custom_mode="OFFBOARD")
    assert rig.stream.offboard.state == "idle" and "not now" in rig.node.last("/rosout")["msg"]
    rig.daemon.fault = None
    assert await rig.call("set_mode", custom_mode="OFFBOARD") == ["AUTO.LOITER"]
    assert rig.stream.offboard.state == "wished"
