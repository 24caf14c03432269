"""Raw messages and commands that have the effect of an order without its checks, and when they are refused.

`messages.send` and `vehicles.command` can send everything in the dialect. A message or command that moves a vehicle,
stops its motors or removes a protection is refused for a vehicle that is armed or not known to be disarmed, unless the
user insists. One that turns the motors of a disarmed vehicle (arming, a motor test) is refused for every vehicle.
Frames of third-party programs are not checked here: their links have roles and filters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.vehicle import orders
from skygcs.core.vehicle.orders import FORCE_HINT
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError

CONTROL = "control set and setpoint (control set raw for attitude, body rates and accelerations)"
GUARDED_MESSAGES: Mapping[str, str] = {
    "SET_ATTITUDE_TARGET": CONTROL,
    "SET_POSITION_TARGET_LOCAL_NED": CONTROL,
    "SET_POSITION_TARGET_GLOBAL_INT": CONTROL,
    "SET_ACTUATOR_CONTROL_TARGET": CONTROL,
    "MANUAL_CONTROL": CONTROL,
    "RC_CHANNELS_OVERRIDE": CONTROL,
    "TRAJECTORY_REPRESENTATION_WAYPOINTS": CONTROL,
    "TRAJECTORY_REPRESENTATION_BEZIER": CONTROL,
    "FOLLOW_TARGET": CONTROL,
    "HIL_ACTUATOR_CONTROLS": "nothing: it is a simulator's",
    "HIL_CONTROLS": "nothing: it is a simulator's",
    "HIL_STATE": "nothing: it is a simulator's",
    "HIL_STATE_QUATERNION": "nothing: it is a simulator's",
    "HIL_SENSOR": "nothing: it is a simulator's",
    "HIL_GPS": "nothing: it is a simulator's",
    "SET_GPS_GLOBAL_ORIGIN": "origin push",
    "SET_HOME_POSITION": "home",
    "MISSION_ITEM": "mission upload",
    "MISSION_ITEM_INT": "mission upload",
    "MISSION_COUNT": "mission upload",
    "MISSION_WRITE_PARTIAL_LIST": "mission upload",
    "MISSION_CLEAR_ALL": "mission clear",
    "SAFETY_SET_ALLOWED_AREA": "fence set",
    "FENCE_POINT": "fence set",
    "SERIAL_CONTROL": "the orders (it is the autopilot's shell)",
}
"""Message -> the checked order. A MISSION_ITEM with ``current`` 2 is a guided waypoint, which is flown at once."""

GUARDED_COMMANDS: Mapping[int, str] = {
    mav_cmd.DO_FOLLOW: "goto",
    mav_cmd.DO_FOLLOW_REPOSITION: "goto",
    mav_cmd.DO_ORBIT: "goto",
    mav_cmd.DO_FIGURE_EIGHT: "goto",
    mav_cmd.NAV_GUIDED_ENABLE: "mode",
    mav_cmd.CONDITION_CHANGE_ALT: "goto",
    mav_cmd.CONDITION_YAW: "goto",
    mav_cmd.DO_SET_HOME: "home",
    mav_cmd.DO_FLIGHTTERMINATION: "stop kill",
    mav_cmd.DO_CHANGE_ALTITUDE: "goto",
    mav_cmd.DO_SET_ACTUATOR: "nothing",
    mav_cmd.DO_LAND_START: "land",
    mav_cmd.DO_GO_AROUND: "goto",
    mav_cmd.DO_REPOSITION: "goto",
    mav_cmd.DO_FENCE_ENABLE: "fence set",
    mav_cmd.DO_PARACHUTE: "stop kill",
    mav_cmd.DO_INVERTED_FLIGHT: "nothing",
    mav_cmd.DO_AUTOTUNE_ENABLE: "mode",
    mav_cmd.DO_ENGINE_CONTROL: "nothing",
    mav_cmd.PREFLIGHT_CALIBRATION: "nothing",
    mav_cmd.PREFLIGHT_SET_SENSOR_OFFSETS: "nothing",
    mav_cmd.PREFLIGHT_UAVCAN: "nothing",
    mav_cmd.PREFLIGHT_STORAGE: "param set",  # also resets all parameters
    mav_cmd.PREFLIGHT_REBOOT_SHUTDOWN: "reboot",
    mav_cmd.OVERRIDE_GOTO: "goto",
    mav_cmd.COMPONENT_ARM_DISARM: "disarm",
    mav_cmd.DO_VTOL_TRANSITION: "nothing",
    mav_cmd.PAYLOAD_PREPARE_DEPLOY: "goto",
    mav_cmd.GUIDED_CHANGE_SPEED: "goto",
    mav_cmd.GUIDED_CHANGE_ALTITUDE: "goto",
    mav_cmd.GUIDED_CHANGE_HEADING: "goto",
    mav_cmd.EXTERNAL_POSITION_ESTIMATE: "nothing",
}
"""MAV_CMD -> the checked order. Mission items (16 to 95) sent as commands are added."""

TURNS_MOTORS: Mapping[int, str] = {
    mav_cmd.NAV_TAKEOFF: "takeoff",  # a disarmed PX4 keeps it and lifts off with the next arming
    mav_cmd.NAV_TAKEOFF_LOCAL: "takeoff",
    mav_cmd.NAV_VTOL_TAKEOFF: "takeoff",
    mav_cmd.DO_MOTOR_TEST: "nothing",
    mav_cmd.DO_AUX_FUNCTION: "arm, disarm and mode",  # its functions arm, stop motors and change modes
    mav_cmd.MISSION_START: "mission start",
    mav_cmd.ACTUATOR_TEST: "nothing",
    mav_cmd.SOLO_BTN_FLY_CLICK: "arm and takeoff",
    mav_cmd.SOLO_BTN_FLY_HOLD: "takeoff",
    mav_cmd.SOLO_BTN_PAUSE_CLICK: "hold",
}
"""Refused also for disarmed vehicles. Arming belongs to them, see `unguarded_command`."""

MISSION_ITEMS = range(mav_cmd.NAV_WAYPOINT, mav_cmd.NAV_LAST + 1)
ENDS_FLIGHT = frozenset({mav_cmd.NAV_RETURN_TO_LAUNCH, mav_cmd.NAV_LAND, mav_cmd.NAV_LAND_LOCAL, mav_cmd.NAV_VTOL_LAND})
"""They bring a vehicle down safely and are never refused."""

COMMAND_MESSAGES = frozenset({"COMMAND_LONG", "COMMAND_INT"})


@dataclass(frozen=True, slots=True)
class Unguarded:
    """``what``: the message or command; ``instead``: the checked order; the flag: refused for every vehicle."""

    what: str
    instead: str
    always: bool = False

    def refusal(self, vehicles: Iterable[Vehicle], now: float) -> str | None:
        """Why it is not sent to these vehicles (possibly none is known); None if it may be sent."""
        found = list(vehicles)
        if self.always:
            return self._text("can turn motors")
        if not found:
            return self._text("would reach a system that is not known to be disarmed")
        for vehicle in found:
            if (why := not_disarmed(vehicle, now)) is not None:
                return self._text(f"would reach {vehicle.name}, which {why},")
        return None

    def _text(self, why: str) -> str:
        remedy = (
            f"the checked order is {self.instead}" if not self.instead.startswith("nothing") else "no order does this"
        )
        return f"{self.what} {why} without the checks of an order: {remedy}; {FORCE_HINT}"


def not_disarmed(vehicle: Vehicle, now: float) -> str | None:
    """Why the vehicle is not known to be disarmed; None if it is."""
    if vehicle.duplicate:
        return f"shares system id {vehicle.sysid} with another"
    if vehicle.armed:
        return "is armed"
    if vehicle.in_air(now):
        return "is in the air"
    return None if vehicle.connected else "is lost"


def unguarded_message(name: str, fields: Mapping[str, Any], command_names: Mapping[int, str]) -> Unguarded | None:
    """The rule for a message; None if it may be sent to any vehicle. ``command_names``: MAV_CMD of the dialect."""
    if name in COMMAND_MESSAGES:
        command = _number(fields.get("command", 0))
        number = int(command) if math.isfinite(command) else -1
        what = command_names.get(number, f"MAV_CMD {number}").removeprefix("MAV_CMD_")
        return unguarded_command(number, _number(fields.get("param1", 0.0)), f"{name} {what}")
    instead = GUARDED_MESSAGES.get(name)
    return None if instead is None else Unguarded(name, instead)


def unguarded_command(number: int, param1: float, what: str) -> Unguarded | None:
    """The rule for a command; see `unguarded_message`."""
    if number == mav_cmd.COMPONENT_ARM_DISARM and param1 != 0.0:  # also NaN: an autopilot's reaction to it is not known
        return Unguarded(what, "arm", always=True)
    if number in TURNS_MOTORS:
        return Unguarded(what, TURNS_MOTORS[number], always=True)
    instead = GUARDED_COMMANDS.get(number)
    if instead is None and number in MISSION_ITEMS and number not in ENDS_FLIGHT:
        instead = "goto and mission"
    return None if instead is None else Unguarded(what, instead)


def require_guarded(
    vehicles: Iterable[Vehicle], now: float, dialect: Dialect, name: str | int, params: Sequence[float | None]
) -> None:
    """Raises RefusedError for a command to the system of these vehicles (possibly none is known) that would bypass the
    checks of an order, for any component: an autopilot may act on commands to a component id it does not know."""
    number, what = orders.find_command(dialect, name)
    first = params[0] if params else 0.0
    rule = unguarded_command(number, math.nan if first is None else float(first), what)
    if rule is not None and (refusal := rule.refusal(vehicles, now)) is not None:
        raise RefusedError(refusal)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
