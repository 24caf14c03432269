"""Setpoints of a bridge's vehicle on their way to the daemon: by which attitude and which origin they are turned."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

from skygcs.core.geo import Origin
from skygcs.core.ros.fleet_origin import FleetOrigin
from skygcs.ext.ros.bridge import Bridge
from skygcs.ext.ros.config import RosConfig
from support.ros_node import KeptNode

pytestmark = pytest.mark.looptime

BODY_NED, VELOCITY = 8, 0x5C7


class Daemon:
    def __init__(self) -> None:
        self.setpoints: list[dict[str, Any]] = []
        self.origin: Origin | None = None
        self.generation = 0

    async def call(self, method: str, **params: Any) -> Any:
        if method == "origin.get":
            return {"origin": None if self.origin is None else self.origin.as_dict(), "generation": self.generation}
        if method == "vehicles.interval":
            await asyncio.sleep(8.9)
        return {"outcomes": {}, "vehicles": {}}

    async def setpoint(self, name: str, valid_s: float, **params: Any) -> dict[str, Any]:
        self.setpoints.append(params)
        return {name: {"ok": True, "message": ""}}


class Rig:
    """A bridge with alpha under control; the clock of its computer is the loop's."""

    def __init__(self) -> None:
        self.node, self.daemon = KeptNode(), Daemon()
        self.loop = asyncio.get_running_loop()
        self.began = self.loop.time()
        self.bridge = Bridge(self.node, RosConfig(commands="setpoints"), self.unix_ns)
        self.bridge._gcs = self.daemon  # type: ignore[assignment]
        self.bridge._origin = FleetOrigin(None, 0)
        self.state()
        self.stream = self.bridge.controls["alpha"].stream

    def unix_ns(self) -> int:
        return 1_700_000_000 * 10**9 + round((self.loop.time() - self.began) * 1e9)

    def state(self, connected: bool = True, **more: Any) -> None:
        state = {"name": "alpha", "sysid": 1, "compid": 1, "connected": connected, "autopilot": "px4", "armed": True}
        self.bridge.on_state({**state, "control": {"state": "flying"}, **more})

    def message(self, name: str, **fields: Any) -> None:
        message = {"vehicle": "alpha", "compid": 1, "name": name, "fields": fields, "age_s": 0.0}
        self.bridge.on_message(message)

    def hear(self, yaw: float) -> None:
        mode = {"autopilot": 12, "type": 2, "base_mode": 0x91, "custom_mode": 0x6000000, "system_status": 4}
        self.message("HEARTBEAT", **mode)
        boot_ms = round((self.loop.time() - self.began) * 1000) + 1000
        rates = {"rollspeed": 0.0, "pitchspeed": 0.0, "yawspeed": 0.0}
        self.message("ATTITUDE", time_boot_ms=boot_ms, roll=0.0, pitch=0.0, yaw=yaw, **rates)

    async def forward(self) -> list[list[float]]:
        """A node wants 5 m/s forward; what is sent of it."""
        velocity = {"x": 5.0, "y": 0.0, "z": 0.0}
        self.node.subscribers["/alpha/mavros/setpoint_raw/local"].give(
            coordinate_frame=BODY_NED, type_mask=VELOCITY, velocity=velocity
        )
        for _ in range(5):
            await asyncio.sleep(0)
        sent = [params["vel_enu_mps"] for params in self.daemon.setpoints]
        self.daemon.setpoints.clear()
        return sent


async def test_a_body_frame_velocity_flies_by_a_fresh_attitude_or_not_at_all() -> None:
    rig = Rig()
    assert await rig.forward() == [] and "attitude" in (rig.stream.refusal or "")  # east would be a guess
    rig.hear(yaw=math.pi)
    assert await rig.forward() == [pytest.approx([0.0, -5.0, 0.0], abs=1e-6)]
    await asyncio.sleep(0.4)
    assert len(await rig.forward()) == 1
    await asyncio.sleep(0.2)
    assert await rig.forward() == []
    rig.hear(yaw=0.0)
    assert await rig.forward() == [pytest.approx([0.0, 5.0, 0.0], abs=1e-6)]
    rig.state(connected=False)
    rig.state()
    assert await rig.forward() == []


async def test_attitude_is_requested_while_body_frame_velocities_lack_it() -> None:
    rig = Rig()
    rig.hear(yaw=0.0)
    assert await rig.forward() and rig.bridge._rates_of_setpoints() == {}  # it comes often enough
    await asyncio.sleep(1.0)
    assert await rig.forward() == []
    assert rig.bridge._rates_of_setpoints() == {"alpha": {"ATTITUDE": 5.0}}
    for _ in range(8):
        rig.hear(yaw=0.0)
        assert len(await rig.forward()) == 1
        assert rig.bridge._rates_of_setpoints() == {"alpha": {"ATTITUDE": 5.0}}  # or it would be slow again
        await asyncio.sleep(1.0)
    rig.bridge.vehicles["alpha"].memory.has_attitude_quaternion = True
    assert rig.bridge._rates_of_setpoints() == {"alpha": {"ATTITUDE_QUATERNION": 5.0}}
    await asyncio.sleep(5.0)
    assert rig.bridge._rates_of_setpoints() == {}


HERE, THERE = Origin(43.7806, -79.4653, 180.0, 90.0), Origin(43.7815, -79.4653, 180.0, 90.0)
"""THERE is 100 m to the north."""


async def test_a_place_is_of_the_origin_that_the_vehicles_state_names_or_of_none() -> None:
    rig = Rig()
    ekf = {"lat_deg": HERE.lat_deg, "lon_deg": HERE.lon_deg, "alt_amsl_m": HERE.alt_amsl_m}

    async def sent() -> list[list[float]]:
        pose = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}}
        rig.node.subscribers["/alpha/mavros/setpoint_position/local"].give(pose=pose)
        for _ in range(5):
            await asyncio.sleep(0)
        found = [params["pos_enu_m"] for params in rig.daemon.setpoints]
        rig.daemon.setpoints.clear()
        return found

    rig.bridge._origin = FleetOrigin(HERE, 1)
    rig.state(ekf_origin=ekf, position={"origin_generation": 1})
    assert await sent() == [pytest.approx([1.0, 2.0, 3.0], abs=0.01)]
    rig.state(ekf_origin=ekf, position={"origin_generation": 2})
    assert await sent() == [] and "origin" in (rig.stream.refusal or "")
    rig.bridge._origin = FleetOrigin(THERE, 2)
    assert await sent() == [pytest.approx([1.0, -98.0, 3.0], abs=0.2)]
    rig.bridge._origin = None  # another connection: its generations may be another daemon's
    assert await sent() == []


async def test_the_origin_is_read_anew_while_vehicles_answer_slowly() -> None:
    """Requests for rates take 9 s each; a state names another origin."""
    rig = Rig()
    rig.node.read("/alpha/mavros/local_position/pose")
    rig.hear(yaw=0.0)
    gcs: Any = rig.daemon
    tasks = [
        asyncio.create_task(work)
        for work in (
            rig.bridge._reports(gcs),
            rig.bridge._rates(gcs, {"LOCAL_POSITION_NED": 5.0}),
            rig.bridge._follow_origin(gcs),
        )
    ]
    await asyncio.sleep(1.5)
    rig.daemon.origin, rig.daemon.generation = THERE, 1
    rig.state(position={"origin_generation": 1})
    await asyncio.sleep(0.2)
    assert rig.bridge._origin == FleetOrigin(THERE, 1) and rig.bridge.fleet.has_origin
    rig.daemon.origin, rig.daemon.generation = HERE, 2
    await asyncio.sleep(1.2)  # without a state that names it
    assert rig.bridge._origin == FleetOrigin(HERE, 2)
    for task in tasks:
        task.cancel()
