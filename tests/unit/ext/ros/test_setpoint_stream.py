"""Setpoints of a bridge's vehicle on their way to the daemon: by which attitude and which origin they are turned."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

from skygcs.core.geo import Origin
from skygcs.core.ros.fleet_origin import FleetOrigin
from skygcs.errors import RpcError
from skygcs.ext.ros.bridge import CATCH_UP_S, STALE_S, Bridge
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.order_connection import ORDER_WITHIN_S, VALID_S, OrderConnection
from skygcs.runtime.loop_clock import SleepWatch
from support.ros_node import KeptNode

pytestmark = pytest.mark.looptime

BODY_NED, VELOCITY = 8, 0x5C7
AHEAD_S = 1000.0
"""The daemon's clock."""


class Daemon:
    def __init__(self) -> None:
        self.setpoints: list[dict[str, Any]] = []
        self.valid_s: list[float] = []
        self.origin: Origin | None = None
        self.generation = 0
        self.called: list[str] = []
        self.deadlines: dict[str, float | None] = {}

    async def call(self, method: str, **params: Any) -> Any:
        self.called.append(method)
        if method == "messages.list":
            return []
        if method == "daemon.info":
            return {"now_s": asyncio.get_running_loop().time() + AHEAD_S}
        if method == "origin.get":
            return {"origin": None if self.origin is None else self.origin.as_dict(), "generation": self.generation}
        if method == "vehicles.interval":
            await asyncio.sleep(8.9)
        return {"outcomes": {"alpha": {"ok": False, "result": "denied", "message": "not now"}}, "vehicles": {}}

    async def call_by(self, deadline_s: float | None, method: str, **params: Any) -> Any:
        self.deadlines[method] = deadline_s
        if method == "control.setpoint":
            del params["targets"]
            self.valid_s.append(params.pop("valid_s"))
            self.setpoints.append(params)
            return {"outcomes": {"alpha": {"ok": True, "message": ""}}}
        return await self.call(method, **params)

    async def vehicles(self) -> list[Any]:
        return []

    async def _nothing(self, *_: Any, **__: Any) -> AsyncIterator[Any]:
        await asyncio.Event().wait()
        yield

    messages = telemetry = events = plan = _nothing


class Rig:
    """A bridge with alpha under control; the clock of its computer is the loop's."""

    def __init__(self, commands: Any = "setpoints") -> None:
        self.node, self.daemon = KeptNode(), Daemon()
        self.loop = asyncio.get_running_loop()
        self.began = self.loop.time()
        self.bridge = Bridge(self.node, RosConfig(commands=commands), self.unix_ns, self.loop.time)
        self.bridge.sleep = self.sleep = SleepWatch(self.bridge._on_woke, self.loop)
        self.orders = OrderConnection(self.daemon, self.loop.time, self.bridge.is_awake)  # type: ignore[arg-type]
        self.bridge._gcs = self.orders
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


async def test_a_node_that_is_wrong_in_turns_does_not_flood_the_log() -> None:
    rig = Rig()
    topic, log = rig.node.subscribers["/alpha/mavros/setpoint_raw/local"], rig.node.publications["/rosout"]
    before = log.sent
    for n in range(2000):  # 200 Hz for 10 s
        topic.give(coordinate_frame=1 + n % 2, type_mask=VELOCITY, velocity={"x": math.nan, "y": 1e300, "z": 0.0})
        await asyncio.sleep(0.005)
    assert rig.stream.refused == 2000 and 2 <= log.sent - before <= 20


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


async def test_what_waited_while_only_this_process_stood_still_is_not_ordered() -> None:
    """Only the bridge was stopped: to the daemon, which ran, a setpoint or a goal of a minute ago was a new one."""
    rig = Rig("all")
    rig.hear(yaw=0.0)
    rig.sleep.beat()
    assert len(await rig.forward()) == 1
    rig.loop.stand_still(60.0)  # type: ignore[attr-defined]
    await asyncio.sleep(0.001)  # the loop reads its clock
    goal = {"goal_id": {"uuid": [7] * 16}, "goal": {}}
    for order in ("takeoff", "land"):
        await rig.node.services[f"/alpha/skygcs/{order}/_action/send_goal"].call(**goal)
    assert rig.daemon.called == ["vehicles.land"]
    assert "skygcs/takeoff/_action/send_goal: not carried out" in rig.node.publications["/rosout"].messages[-2]["msg"]
    rig.hear(yaw=0.0)
    assert await rig.forward() == []
    assert rig.bridge.node.stale == 2 and rig.bridge._woken.is_set() and rig.orders.retired
    await asyncio.sleep(STALE_S)
    rig.hear(yaw=0.0)
    assert await rig.forward() == [], "the connection is closed: what waits in it is of before, too"
    rig.orders.retired = False
    assert len(await rig.forward()) == 1


async def test_an_order_that_was_begun_before_a_standstill_is_not_given_after_it() -> None:
    rig = Rig("all")
    rig.sleep.beat()
    rig.loop.stand_still(60.0)  # type: ignore[attr-defined]
    await asyncio.sleep(0.001)  # the loop reads its clock
    gcs = rig.bridge.controls["alpha"]._gcs()
    assert gcs is not None
    for order in (gcs.call("vehicles.arm"), gcs.setpoint("alpha", rig.loop.time())):
        with pytest.raises(RpcError, match="stood still"):
            await order
    await gcs.call("vehicles.land")
    assert rig.daemon.called == ["vehicles.land"] and rig.daemon.setpoints == []


async def test_the_connection_to_the_daemon_ends_after_a_standstill() -> None:
    rig = Rig("all")
    rig.sleep.beat()
    serving = asyncio.create_task(rig.bridge.serve(rig.daemon))  # type: ignore[arg-type]
    await asyncio.sleep(1.0)
    assert not serving.done()
    rig.loop.stand_still(60.0)  # type: ignore[attr-defined]
    await asyncio.sleep(0.001)  # the loop reads its clock
    rig.sleep.beat()
    await asyncio.sleep(0.1)
    assert serving.done() and serving.exception() is None


async def test_whatever_is_ordered_has_a_deadline_of_the_daemons_clock_but_what_ends_a_flight() -> None:
    """A daemon that stood still, or a socket in which it waited, must not make a late order of it."""
    rig = Rig("all")
    await rig.orders.compare_clocks()
    rig.hear(yaw=0.0)
    assert len(await rig.forward()) == 1
    await rig.node.services["/alpha/mavros/cmd/land"].call()
    await rig.node.services["/alpha/skygcs/takeoff/_action/send_goal"].call(goal_id={"uuid": [7] * 16}, goal={})
    rig.bridge.controls["alpha"]._begin(rig.bridge.controls["alpha"]._take_off(3.0))
    rig.bridge.controls["alpha"]._begin(rig.bridge.controls["alpha"]._ask_origin())
    await asyncio.sleep(0.05)
    now = rig.loop.time() + AHEAD_S
    assert rig.daemon.deadlines.pop("control.setpoint") == pytest.approx(now + VALID_S, abs=0.2)
    asked = {"vehicles.takeoff", "vehicles.request"}
    assert rig.daemon.deadlines == {method: pytest.approx(now + ORDER_WITHIN_S, abs=0.2) for method in asked}


async def test_a_setpoint_is_good_from_when_it_came() -> None:
    rig = Rig()
    for age_s, valid_s in ((0.0, 0.5), (0.3, 0.2), (0.45, 0.1)):
        await rig.orders.setpoint("alpha", rig.loop.time() - age_s)
        assert rig.daemon.valid_s[-1] == pytest.approx(valid_s)


async def test_what_waited_in_a_long_turn_is_not_ordered_and_what_comes_after_it_is() -> None:
    rig = Rig("all")
    watch = asyncio.create_task(rig.bridge.watch())
    rig.hear(yaw=0.0)
    assert len(await rig.forward()) == 1
    for stood_s, sent in ((0.9, 1), (1.5, 0), (3.5, 0)):
        await asyncio.sleep(0.3)
        rig.loop.stand_still(stood_s)  # type: ignore[attr-defined]
        await asyncio.sleep(0.001)  # the loop reads its clock
        rig.hear(yaw=0.0)
        assert len(await rig.forward()) == sent, stood_s
        called = list(rig.daemon.called)
        for name in ("cmd/land", "cmd/takeoff"):
            await rig.node.services[f"/alpha/mavros/{name}"].call()
        assert rig.daemon.called[len(called) :][:1] == ["vehicles.land"]
        assert ("vehicles.takeoff" in rig.daemon.called) == bool(sent), stood_s
        rig.daemon.called.clear()
        await asyncio.sleep(CATCH_UP_S + 0.01)
        rig.hear(yaw=0.0)
        assert len(await rig.forward()) == 1, "the connection is as good as before"
    watch.cancel()
