"""MAVROS' services as methods of skygcs: requests to parameters, outcomes to responses. Pure."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from skygcs.core.mavlink.modes import CUSTOM_MODE_ENABLED, mode_name

Fields = Mapping[str, Any]

MAV_RESULT = {"accepted": 0, "temporarily_rejected": 1, "denied": 2, "unsupported": 3, "failed": 4, "in_progress": 5}
"""Number of MAV_RESULT for an outcome's word; any other word is failed."""

FAILED = 4

SERVICES: dict[str, str] = {
    "cmd/arming": "mavros_msgs/srv/CommandBool",
    "cmd/command": "mavros_msgs/srv/CommandLong",
    "cmd/command_int": "mavros_msgs/srv/CommandInt",
    "cmd/takeoff": "mavros_msgs/srv/CommandTOL",
    "cmd/land": "mavros_msgs/srv/CommandTOL",
    "cmd/set_home": "mavros_msgs/srv/CommandHome",
    "set_mode": "mavros_msgs/srv/SetMode",
    "set_stream_rate": "mavros_msgs/srv/StreamRate",
    "set_message_interval": "mavros_msgs/srv/MessageInterval",
    "param/get": "mavros_msgs/srv/ParamGet",
    "param/set": "mavros_msgs/srv/ParamSetV2",
    "param/pull": "mavros_msgs/srv/ParamPull",
    "mission/push": "mavros_msgs/srv/WaypointPush",
    "mission/pull": "mavros_msgs/srv/WaypointPull",
    "mission/clear": "mavros_msgs/srv/WaypointClear",
    "mission/set_current": "mavros_msgs/srv/WaypointSetCurrent",
    "home_position/req_update": "std_srvs/srv/Trigger",
}
"""Below a vehicle's namespace of MAVROS; `ROS1_SERVICES` differ."""

ROS1_SERVICES = SERVICES | {"param/set": "mavros_msgs/srv/ParamSet"}

ARM_DISARM = 400
ORDERS = {20: "vehicles.rtl", 21: "vehicles.land"}
"""MAV_CMD: COMPONENT_ARM_DISARM, NAV_RETURN_TO_LAUNCH, NAV_LAND."""

MODE_NUMBER = re.compile(r"0|[1-9][0-9]{0,19}|0X[0-9A-F]{1,19}")
"""A decimal number with a leading 0 is refused: MAVROS reads it as octal, which few mean."""
LARGEST_MODE = 0xFFFFFFFF
"""HEARTBEAT.custom_mode has 32 bits."""

INTEGER, DOUBLE = 2, 3
"""rcl_interfaces' ParameterType."""

MOST_WAYPOINTS = 2000

WAYPOINT = 16
"""MAV_CMD_NAV_WAYPOINT."""


class RequestError(ValueError):
    """Why a request cannot be carried out, for the log."""


def response(outcome: Fields) -> dict[str, Any]:
    """``success`` and ``result`` of MAVROS' commands."""
    ok = bool(outcome["ok"])
    return {"success": ok, "result": 0 if ok else MAV_RESULT.get(outcome["result"], FAILED) or FAILED}


def command_params(request: Fields) -> list[float | None]:
    """param1 to param7 of CommandLong; NaN is unset. Raises RequestError."""
    _require_command(request)
    return [_number(request[f"param{n}"]) for n in range(1, 8)]


def order_of_command(request: Fields) -> str | None:
    """The order that does the same as this CommandLong, with its checks; None: it is a command as any other."""
    if request["command"] == ARM_DISARM:
        return "vehicles.arm" if request["param1"] == 1 else "vehicles.disarm"
    return ORDERS.get(request["command"])


def command_int(request: Fields) -> dict[str, Any]:
    """The parameters of vehicles.command for CommandInt. Raises RequestError."""
    _require_command(request)
    params = [_number(request[f"param{n}"]) for n in range(1, 5)]
    where = {"int_frame": str(request["frame"]), "x": request["x"], "y": request["y"], "z": _number(request["z"])}
    return {"command": request["command"], "params": params, **where}


def takeoff_height_m(request: Fields, state: Fields) -> float | None:
    """The height above the ground that CommandTOL asks for: a PX4's altitude counts from sea level, an ArduPilot's from
    home. None: the fleet file's. Raises RequestError."""
    altitude = request["altitude"]
    if not math.isfinite(altitude) or altitude == 0:
        return None
    if state.get("autopilot") != "px4":
        return float(altitude)
    position = state.get("position")
    if position is None or position.get("alt_amsl_m") is None:
        raise RequestError("the vehicle's altitude is not known, from which a PX4's take-off altitude counts")
    return float(altitude - position["alt_amsl_m"])


def home(request: Fields) -> dict[str, Any]:
    """The parameters of vehicles.set_home for CommandHome."""
    if request["current_gps"]:
        return {}
    place = {"lat_deg": request["latitude"], "lon_deg": request["longitude"], "alt_amsl_m": request["altitude"]}
    if not all(map(math.isfinite, place.values())):
        raise RequestError("a home that is not finite")
    return place


def mode_asked(custom_mode: str, autopilot: int, mav_type: int) -> str:
    """The mode that SetMode's custom_mode names, in capitals: by its name, or by its number as in MAVROS
    (cmode_find_cmap of its lib/uas_stringify.cpp), decimal or 0x…. Raises RequestError."""
    text = custom_mode.strip().upper()
    if not text:
        raise RequestError("give custom_mode: base_mode alone names no mode of these autopilots")
    if "A" <= text[0] <= "Z":
        return text
    number = int(text, 0) if MODE_NUMBER.fullmatch(text) else LARGEST_MODE + 1
    name = "UNKNOWN" if number > LARGEST_MODE else mode_name(autopilot, mav_type, CUSTOM_MODE_ENABLED, number)
    if name.startswith("UNKNOWN"):
        raise RequestError(f"{text[:20]} is the number of no mode of this vehicle")
    return name


def interval_hz(rate_hz: float) -> float | None:
    """MAVROS' message_rate: negative is off, 0 the autopilot's own rate. None: that."""
    if not math.isfinite(rate_hz):
        raise RequestError("a rate that is not finite")
    if rate_hz < 0:
        return 0.0
    return None if rate_hz == 0 else min(max(rate_hz, 0.001), 1000.0)


def wpl_text(waypoints: Sequence[Fields], home_first: bool) -> str:
    """Waypoints as a file QGC WPL 110, which missions.upload reads. ``home_first``: the first is home, as in the lists
    of an ArduPilot; else the file's first line, which is home, is none of them. Raises RequestError."""
    if not 0 < len(waypoints) - home_first <= MOST_WAYPOINTS:
        raise RequestError(f"{len(waypoints)} waypoints: from 1 to {MOST_WAYPOINTS}, home not counted")
    lines = ["QGC WPL 110"] + ([] if home_first else ["0\t1\t0\t16\t0\t0\t0\t0\t0\t0\t0\t1"])
    for item in waypoints:
        number = len(lines) - 1
        values = [item[f"param{n}"] for n in range(1, 5)] + [item["x_lat"], item["y_long"], item["z_alt"]]
        if not all(map(math.isfinite, values[4:])) or any(map(math.isinf, values[:4])):
            raise RequestError(f"waypoint {number}: a value that is not finite")
        frame, command = (0, WAYPOINT) if home_first and number == 0 else (item["frame"], item["command"])
        texts = [str(number), "0", str(frame), str(command), *(repr(float(value)) for value in values)]
        lines.append("\t".join([*texts, str(int(item["autocontinue"]))]))
    return "\n".join(lines) + "\n"


def waypoint_messages(items: Sequence[Fields], current_seq: int | None, home: Fields | None) -> list[dict[str, Any]]:
    """The items that missions.download answers, as mavros_msgs' Waypoints, numbered as on the wire: ``current_seq`` is
    the current one. ``home``: of an ArduPilot, whose lists begin with it; None: the first item has number 0."""
    made = [] if home is None else [_home_waypoint(home) | {"is_current": current_seq == 0}]
    for item in items:
        params = [math.nan if value is None else value for value in item["params"]]
        made.append(
            {
                "frame": item["frame"],
                "command": item["command"],
                "is_current": len(made) == current_seq,
                "autocontinue": item["autocontinue"],
                **{f"param{n}": value for n, value in enumerate(params[:4], 1)},
                **dict(zip(("x_lat", "y_long", "z_alt"), params[4:], strict=True)),
            }
        )
    return made


def _home_waypoint(home: Fields) -> dict[str, Any]:
    place = {"x_lat": home["lat_deg"], "y_long": home["lon_deg"], "z_alt": home["alt_amsl_m"]}
    return {"frame": 0, "command": WAYPOINT, "autocontinue": True, **place}


def parameter_value(fields: Fields, ros1: bool) -> float:
    """The number in a request to set a parameter; of ROS 1's pair the integer unless it is 0, else the real number
    (set_cb of MAVROS 1's plugin param). Raises RequestError."""
    value = fields["value"]
    if ros1:
        number = float(value["integer"]) if value["integer"] else float(value["real"])
    elif value["type"] == INTEGER:
        number = float(value["integer_value"])
    elif value["type"] == DOUBLE:
        number = value["double_value"]
    elif value["type"] == 1:
        number = float(value["bool_value"])
    else:
        raise RequestError("a parameter's value is a number")
    if not math.isfinite(number):
        raise RequestError("a parameter's value is finite")
    return number


def mavros_value(value: float | None, type_: str | None) -> dict[str, Any]:
    """mavros_msgs' ParamValue."""
    if value is None:
        return {}
    return {"real": value} if (type_ or "").startswith("REAL") else {"integer": int(value)}


def ros2_value(value: float | None, type_: str | None) -> dict[str, Any]:
    """rcl_interfaces' ParameterValue."""
    if value is None:
        return {}
    if (type_ or "").startswith("REAL"):
        return {"type": DOUBLE, "double_value": value}
    return {"type": INTEGER, "integer_value": int(value)}


def _require_command(request: Fields) -> None:
    """Raise RequestError for 0, which is no MAV_CMD: the request of a node that has set nothing, or bytes of zeros."""
    if request["command"] == 0:
        raise RequestError("0 is not a command")


def _number(value: float) -> float | None:
    if math.isinf(value):
        raise RequestError("a parameter of a command is infinite")
    return None if math.isnan(value) else value
