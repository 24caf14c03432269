"""Setpoints of one vehicle's topics on their way to control.setpoint.

At most one is on its way to the daemon; one that comes meanwhile waits, and the newest takes the place of an older one:
a flood of messages is as many requests as the daemon answers. Each is good for a short time there (`order_connection`),
so a node that stops, stops. Whether the vehicle follows is the daemon's: only one that is under control does.
"""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from skygcs.core.ros.fleet_origin import FleetOrigin
from skygcs.core.ros.setpoints import (
    ATTITUDE_FRESH_S,
    ATTITUDE_HZ,
    SETPOINTS,
    AttitudeError,
    AttitudePair,
    Demand,
    LocalFrame,
    SetpointError,
    origin_of,
)
from skygcs.core.token_bucket import TokenBucket
from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.ext.ros.graph import Node
from skygcs.ext.ros.offboard import UNDER_CONTROL, Offboard
from skygcs.ext.ros.order_connection import OrderConnection
from skygcs.ext.ros.vehicle_topics import VehicleTopics

SETTLED_S = 5.0
"""A setpoint that is refused now and then, between others that are followed, is logged once."""

LOGGED_PER_S, LOGGED_AT_ONCE = 1.0, 10.0
"""Refusals of one vehicle that are logged: of a node whose setpoints are wrong in turns, each is another than the one
before, and /rosout would carry as many messages as it sends setpoints."""

BODY_S = 5.0
"""Attitude that was requested for demands in the body's frame is kept so long after the last of them."""

WARNING = 4
"""MAV_SEVERITY of a refusal."""


class SetpointStream:
    """Setpoints of one vehicle, from its discovery on. ``gcs()`` returns the connection to the daemon, or None."""

    def __init__(
        self,
        node: Node,
        vehicle: VehicleTopics,
        gcs: Callable[[], OrderConnection | None],
        origin: Callable[[], FleetOrigin | None],
        clock: Callable[[], float],
        unix_ns: Callable[[], int],
    ) -> None:
        self.offboard = Offboard()
        self.refusal: str | None = None
        """Why the last setpoint was not followed."""
        self.refused = 0
        self.sent = 0
        self._refused_kind = ""
        self._refused_at = -math.inf
        self._log_share = TokenBucket(LOGGED_PER_S, LOGGED_AT_ONCE)
        self._vehicle = vehicle
        self._gcs = gcs
        self._origin = origin
        self._clock = clock
        self._unix_ns = unix_ns
        self._pair = AttitudePair()
        self._by_attitude_at = -math.inf
        """When the last demand in the body's frame came."""
        self._lacked_attitude = False
        """One of those that came since had no attitude."""
        self._waiting: tuple[float, Demand] | None = None
        """And when it came."""
        self._sending: asyncio.Task[None] | None = None
        for name, (topic, convert) in SETPOINTS.items():
            node.subscribe(f"{vehicle.mavros}/{name}", topic.type, topic.quality, self.reader(convert))
        base = f"{vehicle.mavros}/setpoint_attitude"
        node.subscribe(f"{base}/thrust", "mavros_msgs/msg/Thrust", "default", self._on_thrust)
        pose, twist = self._pair.on_pose, self._pair.on_twist
        node.subscribe(
            f"{base}/attitude",
            "geometry_msgs/msg/PoseStamped",
            "default",
            self.reader(lambda fields, frame: pose(fields, frame, clock())),
        )
        node.subscribe(
            f"{base}/cmd_vel",
            "geometry_msgs/msg/TwistStamped",
            "default",
            self.reader(lambda fields, frame: twist(fields, clock())),
        )

    def _on_thrust(self, fields: dict[str, Any]) -> None:
        self._pair.on_thrust(fields, self._clock())

    def reader(self, convert: Callable[[Mapping[str, Any], LocalFrame], Demand]) -> Callable[[dict[str, Any]], None]:
        """Return what takes a topic's messages as setpoints; ``convert`` raises SetpointError for an invalid one."""

        def on_message(fields: dict[str, Any]) -> None:
            try:
                demand = convert(fields, self.frame())
            except SetpointError as error:
                if isinstance(error, AttitudeError):
                    self._lacked_attitude, self._by_attitude_at = True, self._clock()
                self._refuse(str(error))
                return
            if demand.by_attitude:
                self._by_attitude_at = self._clock()
            self.take(demand)

        return on_message

    def frame(self) -> LocalFrame:
        """Where the vehicle's local frame lies now. Raises SetpointError while the fleet's origin changes."""
        state = self._vehicle.state
        origin = origin_of(self._origin(), state.get("position"))
        ekf, home = state.get("ekf_origin"), state.get("home")
        place = None if ekf is None else (ekf["lat_deg"], ekf["lon_deg"], ekf["alt_amsl_m"])
        home_m = None if home is None else home["alt_amsl_m"]
        yaw_rad = self._vehicle.memory.yaw_enu_rad(self._unix_ns(), round(ATTITUDE_FRESH_S * 1e9))
        return LocalFrame(origin, place, home_m, yaw_rad)

    def wanted_rates(self) -> dict[str, float]:
        """MAVLink messages that the demands need and that did not come often enough, with their rates in Hz."""
        if self._clock() - self._by_attitude_at > BODY_S:
            self._lacked_attitude = False
        if not self._lacked_attitude:
            return {}
        has_quaternion = self._vehicle.memory.has_attitude_quaternion
        return {"ATTITUDE_QUATERNION" if has_quaternion else "ATTITUDE": ATTITUDE_HZ}

    def take(self, demand: Demand) -> None:
        """Take in a setpoint."""
        came_at = self._clock()
        self.offboard.on_demand(demand, came_at)
        control = self._vehicle.state.get("control")
        if control is None or control.get("state") not in UNDER_CONTROL:
            if self.offboard.state == "idle":
                name = self._vehicle.name
                self._refuse(f"not under control: a person engages it (skygcs-cli control set {name} {demand.mode})")
            return
        self._waiting = came_at, demand
        if self._sending is None:
            self._sending = asyncio.create_task(self._send(), name=f"setpoints of {self._vehicle.name}")

    async def _send(self) -> None:
        """Send what waits, until nothing does."""
        try:
            while self._waiting is not None:
                (came_at, demand), self._waiting = self._waiting, None
                gcs = self._gcs()
                if gcs is None:
                    return
                outcome = await gcs.setpoint(self._vehicle.name, came_at, **demand.params)
                if outcome["ok"]:
                    self.sent += 1
                    self.refusal = None
                else:
                    self._refuse(outcome["message"])
        except RpcError as error:
            self._refuse(str(error))
        except DaemonUnreachable:
            self._refuse("the daemon is not there")
        finally:
            self._sending = None

    def _refuse(self, reason: str) -> None:
        """Log a reason when it is another one than before, whatever its numbers are, and not too many; count
        each."""
        self.refused += 1
        kind = re.sub(r"[0-9.]+", "", reason)
        self.refusal, self._refused_at = reason, self._clock()
        if kind != self._refused_kind and self._log_share.take(self._refused_at):
            self._refused_kind = kind
            self._vehicle.log(WARNING, f"setpoint refused: {reason}", self._unix_ns())

    def settle(self) -> None:
        """A refusal that is over for SETTLED_S may be logged again; to be called a few times a second."""
        if self.refusal is None and self._clock() - self._refused_at > SETTLED_S:
            self._refused_kind = ""

    def status(self) -> str:
        """Status as text for a person."""
        control = self._vehicle.state.get("control") or {}
        parts = [f"{control.get('state', 'off')} {control.get('control_mode') or ''}".strip()]
        if self.offboard.state != "idle":
            parts.append(f"{self.offboard.shown_mode} {self.offboard.state}")
        if self.refusal is not None:
            parts.append(f"refused: {self.refusal}")
        return ", ".join(parts)[:300]
