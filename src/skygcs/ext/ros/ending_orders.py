"""Orders, modes and requests of nodes that end or stop a flight: none of them is ever too late. Pure.

method, service, topic, action            ends a flight
---------------------------------------   ----------------------------------------------------------------
the daemon's orders                       those of `extension.ENDS_FLIGHT`
a mode                                    one of `ENDING_MODES`, by its name: numbers are those of a vehicle
a command                                 NAV_LAND, NAV_RETURN_TO_LAUNCH, DO_FLIGHTTERMINATION 1, disarming
an action                                 land, and to cancel a goal; its result orders nothing
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.modes import AUTOPILOT_ARDUPILOT, AUTOPILOT_PX4, mode_names
from skygcs.core.mavlink.vehicle_class import ON_ROTORS, TABLE, UNKNOWN, VehicleClass, class_type
from skygcs.core.ros.px4_setpoints import service_call
from skygcs.core.ros.services import ARM_DISARM, RequestError
from skygcs.ext.ros.offboard import OFFBOARD_MODES
from skygcs.extension import ENDS_FLIGHT

Fields = Mapping[str, Any]

ENDING_METHODS = frozenset(f"vehicles.{order}" for order in ENDS_FLIGHT - {"release"})
"""Control is released by control.set, which nodes do not call."""

VEHICLE_COMMAND = "/fmu/in/vehicle_command"


def _ending_modes() -> frozenset[str]:
    names = set(mode_names(AUTOPILOT_PX4, 0))
    for kind in VehicleClass:
        names.update(mode_names(AUTOPILOT_ARDUPILOT, class_type(kind)))
    modes = {name for name in names if name.endswith(("LAND", "RTL"))}
    for able in (*TABLE.values(), *ON_ROTORS.values(), *UNKNOWN.values()):
        modes.update((able.stop_mode, able.hold_mode))
    modes.update([name.removeprefix("AUTO.") for name in modes])
    return frozenset(modes - OFFBOARD_MODES - {""})


ENDING_MODES = _ending_modes()
"""Modes that land, return, stop or hold, of all autopilots; PX4's also without "AUTO."."""


def ends_flight(method: str, params: Fields) -> bool:
    """True if this call of the daemon ends or stops a flight."""
    if method == "vehicles.mode":
        return params["mode"] in ENDING_MODES
    if method == "vehicles.command":
        return _command_ends(params["command"], params["params"][0])
    return method in ENDING_METHODS


def request_ends_flight(name: str, request: Fields) -> bool:
    """True if a request of the service of this name, or a message of this topic, asks for the end of a flight, or for
    no order at all."""
    if VEHICLE_COMMAND in name:
        return command_ends_flight(request)
    return any(name.endswith(tail) and ends(request) for tail, ends in _REQUESTS.items())


def command_ends_flight(command: Fields) -> bool:
    """The same of a vehicle_command."""
    try:
        service, request = service_call(command)
    except RequestError:
        return False
    return request_ends_flight(f"/{service}", request)


def _command_ends(command: int, param1: float | None) -> bool:
    if command in (mav_cmd.NAV_LAND, mav_cmd.NAV_RETURN_TO_LAUNCH):
        return True
    if command == ARM_DISARM:
        return param1 == 0
    return command == mav_cmd.DO_FLIGHTTERMINATION and param1 == 1


def _is_ending_command(request: Fields) -> bool:
    return _command_ends(request["command"], request["param1"])


_REQUESTS: dict[str, Callable[[Fields], bool]] = {
    "/cmd/arming": lambda request: not request["value"],
    "/cmd/command": _is_ending_command,
    "/cmd/command_int": _is_ending_command,
    "/cmd/land": lambda request: True,
    "/set_mode": lambda request: request["custom_mode"].strip().upper() in ENDING_MODES,
    "/skygcs/land/_action/send_goal": lambda request: True,
    "/_action/cancel_goal": lambda request: True,
    "/_action/get_result": lambda request: True,
}
