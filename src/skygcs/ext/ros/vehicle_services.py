"""MAVROS' services of one vehicle: each is a method of the daemon, with all of its checks.

What the daemon refuses is the response's failure, and its reason a message on /rosout: MAVROS' responses have no text.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from typing import Any

from skygcs.core.ros import services
from skygcs.core.ros.mission_list import MissionList
from skygcs.core.ros.services import FAILED, RequestError
from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.ext.ros.ending_orders import ends_flight
from skygcs.ext.ros.graph import Node
from skygcs.ext.ros.offboard import OFFBOARD_MODES, Offboard
from skygcs.ext.ros.order_connection import OrderConnection
from skygcs.ext.ros.vehicle_topics import VehicleTopics

READY_MODES = {"px4": "AUTO.LOITER", "ardupilot": "GUIDED"}
"""By autopilot: the mode in which it waits on the ground for OFFBOARD by skygcs."""

MISSION_ACK = "MISSION_ACK"

ERROR, INFO = 3, 6
"""MAV_SEVERITY."""

Fields = Mapping[str, Any]


class VehicleServices:
    """Services of one vehicle, from its discovery on. ``gcs()`` returns the connection to the daemon, or None."""

    def __init__(
        self,
        node: Node,
        vehicle: VehicleTopics,
        offboard: Offboard,
        gcs: Callable[[], OrderConnection | None],
        clock: Callable[[], float],
        unix_ns: Callable[[], int],
        ros1: bool = False,
    ) -> None:
        self._vehicle = vehicle
        self._offboard = offboard
        self._gcs = gcs
        self._clock = clock
        self._unix_ns = unix_ns
        self._ros1 = ros1
        self._waypoints = node.publish(f"{vehicle.mavros}/mission/waypoints", "mavros_msgs/msg/WaypointList", "newest")
        self._mission = MissionList()
        self._handlers: dict[str, Callable[[Fields], Awaitable[dict[str, Any]]]] = {
            "cmd/arming": self._arming,
            "cmd/command": self._command,
            "cmd/command_int": self._command_int,
            "cmd/takeoff": self._takeoff,
            "cmd/land": self._land,
            "cmd/set_home": self._set_home,
            "set_mode": self._set_mode,
            "set_stream_rate": self._set_stream_rate,
            "set_message_interval": self._set_message_interval,
            "param/get": self._param_get,
            "param/set": self._param_set,
            "param/pull": self._param_pull,
            "mission/push": self._mission_push,
            "mission/pull": self._mission_pull,
            "mission/clear": self._mission_clear,
            "mission/set_current": self._mission_set_current,
            "home_position/req_update": self._home_update,
        }
        types = services.ROS1_SERVICES if ros1 else services.SERVICES
        for name, type_ in types.items():
            node.serve(f"{vehicle.mavros}/{name}", type_, partial(self.call, name))

    async def call(self, name: str, request: dict[str, Any]) -> dict[str, Any]:
        """The response of a service; of one that fails the empty one, whose success is false."""
        try:
            return await self._handlers[name](request)
        except (RequestError, RpcError, DaemonUnreachable) as error:
            self._log(ERROR, f"{name}: {error}")
        return {"result": FAILED} if name.startswith("cmd/") and name != "cmd/command_int" else {}

    def on_state(self) -> None:
        """A state of the vehicle has come: another item of its mission may be current."""
        self._mission.on_state(self._vehicle.state.get("mission"))
        listed = self._mission.due(self._waypoints.readers > 0, self._clock())
        if listed is not None:
            self._waypoints.write(listed)

    def on_message(self, name: str, fields: Fields, age_s: float) -> None:
        """A MAVLink message of its autopilot, to any station. Raises KeyError."""
        if name == MISSION_ACK:
            self._mission.on_transfer_ended(fields.get("mission_type", 0), self._clock() - age_s)

    def forget_mission(self) -> None:
        """The vehicle has rebooted, or the connection to the daemon has ended: its mission may be another."""
        self._mission.forget()

    async def _call(self, method: str, **params: Any) -> Any:
        gcs = self._gcs()
        if gcs is None:
            raise RequestError("the daemon is not there")
        return await gcs.call(method, **params)

    async def _order(self, method: str, **params: Any) -> dict[str, Any]:
        """The vehicle's outcome of an order; one that is not ok is logged."""
        answer = await self._call(method, targets=self._vehicle.name, **params)
        outcome: dict[str, Any] = answer["outcomes"][self._vehicle.name]
        if not outcome["ok"]:
            self._log(ERROR, f"{method}: {outcome['message']}")
        return outcome

    def _log(self, severity: int, text: str) -> None:
        self._vehicle.log(severity, text, self._unix_ns())

    # -- commands

    async def _arming(self, request: Fields) -> dict[str, Any]:
        idle = self._offboard.state == "idle"
        if request["value"] and idle and self._vehicle.state.get("mode") == "OFFBOARD":
            await self._wish_offboard("OFFBOARD")  # it stands in it from an earlier flight: the node asks no more
        return services.response(await self._order("vehicles.arm" if request["value"] else "vehicles.disarm"))

    async def _command(self, request: Fields) -> dict[str, Any]:
        if request["broadcast"]:
            raise RequestError("a command to all vehicles (broadcast) is not sent from one vehicle's namespace")
        order = services.order_of_command(request)
        if order is not None:
            if order in services.ORDERS.values():
                self._end_offboard()
            return services.response(await self._order(order))
        params = {"command": request["command"], "params": services.command_params(request)}
        return services.response(await self._raw_command(params))

    async def _command_int(self, request: Fields) -> dict[str, Any]:
        if request["broadcast"]:
            raise RequestError("a command to all vehicles (broadcast) is not sent from one vehicle's namespace")
        return {"success": bool((await self._raw_command(services.command_int(request)))["ok"])}

    async def _raw_command(self, params: dict[str, Any]) -> dict[str, Any]:
        if ends_flight("vehicles.command", params):
            self._end_offboard()
        return await self._order("vehicles.command", **params)

    async def _takeoff(self, request: Fields) -> dict[str, Any]:
        height_m = services.takeoff_height_m(request, self._vehicle.state)
        return services.response(await self._order("vehicles.takeoff", height_m=height_m, arm=False))

    async def _land(self, request: Fields) -> dict[str, Any]:
        self._end_offboard()
        return services.response(await self._order("vehicles.land"))

    async def _set_home(self, request: Fields) -> dict[str, Any]:
        return services.response(await self._order("vehicles.set_home", **services.home(request)))

    # -- mode

    async def _set_mode(self, request: Fields) -> dict[str, Any]:
        memory = self._vehicle.memory
        mode = services.mode_asked(request["custom_mode"], memory.autopilot, memory.mav_type)
        if mode not in OFFBOARD_MODES:
            self._end_offboard()
            return {"mode_sent": bool((await self._order("vehicles.mode", mode=mode))["ok"])}
        if mode == "GUIDED" and self._vehicle.state.get("autopilot") == "ardupilot":
            ok = bool((await self._order("vehicles.mode", mode=mode))["ok"])
            if ok:
                self._offboard.wish_guided()
            return {"mode_sent": ok}
        return {"mode_sent": await self._wish_offboard(mode)}

    async def _wish_offboard(self, mode: str) -> bool:
        """OFFBOARD by skygcs' control. On the ground the autopilot goes to a mode in which it may be armed and take
        off: it may stand in OFFBOARD without setpoints, or in LAND.
        Raises RequestError, RpcError, DaemonUnreachable."""
        refusal = self._offboard.wish(mode, self._clock())
        if refusal is not None:
            raise RequestError(refusal)
        state = self._vehicle.state
        ready = READY_MODES.get(state.get("autopilot", ""))
        if ready is not None and not state.get("armed") and state.get("mode") != ready:
            ok = False
            try:
                ok = bool((await self._order("vehicles.mode", mode=ready, in_time=True))["ok"])
            finally:
                if not ok:
                    self._end_offboard()
            if not ok:
                return False
        self._vehicle.shown_mode = self._offboard.shown_mode
        self._log(INFO, f"{mode}: control begins when it flies")
        return True

    def _end_offboard(self) -> None:
        self._offboard.end()
        self._vehicle.shown_mode = ""

    # -- streams

    async def _set_stream_rate(self, request: Fields) -> dict[str, Any]:
        rate_hz = request["message_rate"] if request["on_off"] else 0
        await self._order("vehicles.stream", stream=request["stream_id"], rate_hz=float(min(rate_hz, 1000)))
        return {}

    async def _set_message_interval(self, request: Fields) -> dict[str, Any]:
        rate_hz = services.interval_hz(request["message_rate"])
        outcome = await self._order("vehicles.interval", message=request["message_id"], rate_hz=rate_hz)
        return {"success": bool(outcome["ok"])}

    async def _home_update(self, request: Fields) -> dict[str, Any]:
        outcome = await self._order("vehicles.request", message="HOME_POSITION")
        return {"success": bool(outcome["ok"]), "message": outcome["message"]}

    # -- parameters

    async def _param_get(self, request: Fields) -> dict[str, Any]:
        name = request["param_id"]
        answer = await self._call("params.get", targets=self._vehicle.name, names=[name])
        found = answer["outcomes"][self._vehicle.name][name]
        return {"success": bool(found["ok"]), "value": services.mavros_value(found["value"], found["type"])}

    async def _param_set(self, request: Fields) -> dict[str, Any]:
        name, value = request["param_id"], services.parameter_value(request, self._ros1)
        answer = await self._call("params.set", targets=self._vehicle.name, params={name: value})
        found = answer["outcomes"][self._vehicle.name][name]
        if not found["ok"]:
            self._log(ERROR, f"params.set: {found['message']}")
        encode = services.mavros_value if self._ros1 else services.ros2_value
        return {"success": bool(found["ok"]), "value": encode(found["value"], found["type"])}

    async def _param_pull(self, request: Fields) -> dict[str, Any]:
        refresh = bool(request["force_pull"])
        answer = await self._call("params.list", targets=self._vehicle.name, refresh=refresh, values=True)
        listed = answer["lists"][self._vehicle.name]
        return {"success": bool(listed["ok"]), "param_received": len(listed["params"] or ())}

    # -- missions

    async def _mission_push(self, request: Fields) -> dict[str, Any]:
        if request["start_index"]:
            raise RequestError("a part of a mission (start_index) is not supported: push all of it")
        home_first = self._home_is_first()
        text = services.wpl_text(request["waypoints"], home_first)
        if not await self._transfer("missions.upload", plan=text, name=f"{self._vehicle.name}.waypoints"):
            return {}
        self._publish_mission(request["waypoints"], home_first)
        return {"success": True, "wp_transfered": len(request["waypoints"])}

    async def _transfer(self, method: str, **params: Any) -> bool:
        """An order that replaces the mission. True if it succeeded."""
        ok, was_sent = False, True
        self._mission.own_begins()
        try:
            outcome = await self._order(method, **params)
            ok, was_sent = bool(outcome["ok"]), outcome["result"] != "refused"
        finally:
            self._mission.own_ended(ok, was_sent, self._clock())
        return ok

    def _publish_mission(self, waypoints: Sequence[Fields], home_first: bool) -> None:
        self._waypoints.write(self._mission.replaced(waypoints, home_first, self._clock()))

    async def _mission_pull(self, request: Fields) -> dict[str, Any]:
        home_first, home = self._home_is_first(), self._vehicle.state.get("home")
        if home_first and home is None:
            raise RequestError(
                "the vehicle's home is not known, with which an ArduPilot's list begins: "
                "call home_position/req_update, then pull again"
            )
        before = self._mission.third_party_transfers
        answer = await self._call("missions.download", target=self._vehicle.name, lists=["mission"])
        if not answer["outcome"]["ok"]:
            self._log(ERROR, f"missions.download: {answer['outcome']['message']}")
            return {}
        if self._mission.third_party_transfers != before:
            raise RequestError("somebody replaced the mission while it was pulled: pull again")
        mission = self._vehicle.state.get("mission") or {}
        listed = services.waypoint_messages(answer["mission"], mission.get("seq"), home if home_first else None)
        self._publish_mission(listed, home_first)
        return {"success": True, "wp_received": len(listed)}

    async def _mission_clear(self, request: Fields) -> dict[str, Any]:
        ok = await self._transfer("missions.clear")
        if ok:
            self._publish_mission([], self._home_is_first())
        return {"success": ok}

    async def _mission_set_current(self, request: Fields) -> dict[str, Any]:
        item = request["wp_seq"] + (not self._home_is_first())
        if item < 1:
            raise RequestError("wp_seq 0 is home: no item to fly to")
        return {"success": bool((await self._order("missions.set_current", item=item))["ok"])}

    def _home_is_first(self) -> bool:
        return self._vehicle.state.get("autopilot") == "ardupilot"
