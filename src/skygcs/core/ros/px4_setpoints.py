"""Setpoints and commands of PX4's own topics (fmu/in/…) as those of MAVROS, so that both go the same way.

offboard_control_mode says which part of trajectory_setpoint counts, and that the node lives; a part is NaN where it is
not to be controlled (TrajectorySetpoint.msg). Both are NED; NaN stays NaN when the axes are changed.

    offboard_control_mode   position is         velocity is         acceleration is
    ---------------------   -----------------   -----------------   ---------------
    position                the setpoint        feed-forward        feed-forward
    velocity                not used            the setpoint        feed-forward
    acceleration            not used            not used            the setpoint
    none of the three       refused: attitudes, rates, thrusts and actuators are not taken from PX4's topics
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.modes import CUSTOM_MODE_ENABLED, px4_mode_name
from skygcs.core.ros.rotations import enu_from_ned, xyz
from skygcs.core.ros.services import ARM_DISARM, RequestError
from skygcs.core.ros.setpoints import (
    IGNORE_AXYZ,
    IGNORE_VXYZ,
    IGNORE_XYZ,
    IGNORE_YAW,
    IGNORE_YAW_RATE,
    LOCAL_NED,
    Demand,
    LocalFrame,
    SetpointError,
    raw_local,
)

Fields = Mapping[str, Any]

MODE_FRESH_S = 0.5
"""offboard_control_mode is good for so long: PX4 asks for more than 2 Hz."""

PX4_INPUTS: dict[str, str] = {
    "offboard_control_mode": "px4_msgs/msg/OffboardControlMode",
    "trajectory_setpoint": "px4_msgs/msg/TrajectorySetpoint",
    "vehicle_command": "px4_msgs/msg/VehicleCommand",
}
"""Topics below fmu/in, without the version."""

ACK_TYPE = "px4_msgs/msg/VehicleCommandAck"

PARTS = ("position", "velocity", "acceleration")
"""Parts of a setpoint, the outermost loop first."""

LAST_COMMAND = 0xFFFF
"""Larger ones are PX4's own, which no MAVLink message carries."""

AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""


class OffboardControlMode:
    """The newest offboard_control_mode."""

    def __init__(self) -> None:
        self._fields: Fields = {}
        self._at = -math.inf

    def on_message(self, fields: Fields, now: float) -> None:
        """One that came."""
        self._fields, self._at = fields, now

    def demand(self, setpoint: Fields, frame: LocalFrame, now: float) -> Demand:
        """A trajectory_setpoint under it. Raises SetpointError."""
        if now - self._at > MODE_FRESH_S:
            raise SetpointError(f"no offboard_control_mode came in the last {MODE_FRESH_S} s: stream it above 2 Hz")
        first = next((n for n, part in enumerate(PARTS) if self._fields[part]), None)
        if first is None:
            raise SetpointError("offboard_control_mode asks for none of position, velocity, acceleration")
        return trajectory_setpoint(setpoint, PARTS[first:], frame)


def trajectory_setpoint(fields: Fields, parts: Sequence[str], frame: LocalFrame) -> Demand:
    """TrajectorySetpoint, of which only these parts count, by setpoint_raw/local. Raises SetpointError."""
    ignores = dict(zip(PARTS, (IGNORE_XYZ, IGNORE_VXYZ, IGNORE_AXYZ), strict=True))
    mask, target = 0, {}
    for part, bits in ignores.items():
        north, east, down = fields[part] if part in parts else (math.nan,) * 3
        enu = enu_from_ned(north, east, down)
        mask |= sum(bit for bit, value in zip(bits, enu, strict=True) if math.isnan(value))
        target["acceleration_or_force" if part == "acceleration" else part] = xyz(enu)
    if mask == sum(sum(bits) for bits in ignores.values()):
        raise SetpointError(f"trajectory_setpoint: {', '.join(parts)} are all NaN")
    yaw, yaw_rate = fields["yaw"], fields["yawspeed"]
    mask |= IGNORE_YAW * math.isnan(yaw) | IGNORE_YAW_RATE * math.isnan(yaw_rate)
    turned = {"yaw": math.pi / 2 - yaw, "yaw_rate": -yaw_rate}
    return raw_local({"coordinate_frame": LOCAL_NED, "type_mask": mask, **target, **turned}, frame)


def is_for(command: Fields, sysid: int) -> bool:
    """True if a VehicleCommand is for this vehicle's autopilot."""
    return command["target_system"] in (0, sysid) and command["target_component"] in (0, AUTOPILOT)


def service_call(command: Fields) -> tuple[str, dict[str, Any]]:
    """MAVROS' service that does what a VehicleCommand asks for, and its request. Raises RequestError."""
    number = command["command"]
    if number > LAST_COMMAND:
        raise RequestError(f"command {number} is one of PX4's own, which MAVLink does not carry")
    if number == ARM_DISARM:
        return "cmd/arming", {"value": command["param1"] == 1}
    if number == mav_cmd.DO_SET_MODE:
        return "set_mode", {"base_mode": 0, "custom_mode": _mode(command)}
    params = {f"param{n}": command[f"param{n}"] for n in range(1, 8)}
    return "cmd/command", {"broadcast": False, "command": number, "confirmation": 0, **params}


def _mode(command: Fields) -> str:
    base, main, sub = (command[f"param{n}"] for n in (1, 2, 3))
    if not all(math.isnan(value) or 0 <= value <= 255 for value in (base, main, sub)):
        raise RequestError("DO_SET_MODE: a mode is a number from 0 to 255")
    if math.isnan(base) or not int(base) & CUSTOM_MODE_ENABLED or math.isnan(main):
        raise RequestError("DO_SET_MODE: give param1 1 and PX4's main mode as param2, as 1 and 6 for OFFBOARD")
    name = px4_mode_name(int(main) << 16 | (0 if math.isnan(sub) else int(sub)) << 24)
    if name.startswith("UNKNOWN"):
        raise RequestError(f"DO_SET_MODE: {name} is not a mode of PX4")
    return name


def ack(command: Fields, result: int) -> dict[str, Any]:
    """VehicleCommandAck's fields, but for its time; ``result``: a MAV_RESULT."""
    return {
        "command": command["command"],
        "result": result,
        "target_system": command["source_system"],
        "target_component": command["source_component"],
        "from_external": True,
    }
