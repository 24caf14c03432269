"""Topics that all vehicles share: /tf, /tf_static, /rosout and /diagnostics; their types, and what they say."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from skygcs.core.geo import EAST_DEG, Origin, enu_from_geodetic, quaternion_from_euler
from skygcs.core.ros.memory import FrameNames
from skygcs.core.ros.rotations import wxyz, xyz
from skygcs.core.ros.stamps import header
from skygcs.core.ros.topics import Topic

FLEET_MAP = "map"
"""The fleet's frame: the root of the tree."""

SHARED: dict[str, Topic] = {
    "/tf": Topic("tf2_msgs/msg/TFMessage", "default"),
    "/tf_static": Topic("tf2_msgs/msg/TFMessage", "newest"),
    "/rosout": Topic("rcl_interfaces/msg/Log", "latched"),
    "/diagnostics": Topic("diagnostic_msgs/msg/DiagnosticArray", "default"),
}
"""By their complete names."""

OK, WARN, ERROR = 0, 1, 2
"""diagnostic_msgs' DiagnosticStatus.level."""


def pose_transform(pose: Mapping[str, Any], base_link: str) -> dict[str, Any]:
    """The transform that a PoseStamped is: from its frame to ``base_link``."""
    place = pose["pose"]
    return {
        "header": pose["header"],
        "child_frame_id": base_link,
        "transform": {"translation": place["position"], "rotation": place["orientation"]},
    }


def map_transform(place: Mapping[str, float], origin: Origin, vehicle_map: str, now_ns: int) -> dict[str, Any]:
    """The transform from the fleet's frame to a vehicle's own, whose origin is ``place`` (lat_deg, lon_deg,
    alt_amsl_m)."""
    offset = enu_from_geodetic(place["lat_deg"], place["lon_deg"], place["alt_amsl_m"], origin)
    half = math.radians(origin.x_heading_deg - EAST_DEG) / 2  # true east, north, up as the fleet's frame sees them
    return {
        "header": header(now_ns, FLEET_MAP),
        "child_frame_id": vehicle_map,
        "transform": {
            "translation": dict(zip("xyz", offset, strict=True)),
            "rotation": {"w": math.cos(half), "x": 0.0, "y": 0.0, "z": math.sin(half)},
        },
    }


def mavlink_frames(frames: FrameNames, now_ns: int) -> list[dict[str, Any]]:
    """The transforms from a vehicle's frames to those of MAVLink that MAVROS sends as well (setup_static_tf of its
    lib/uas_tf.cpp): map to map_ned, base_link to base_link_frd."""
    turns = {(frames.map, "_ned"): (math.pi, 0.0, math.pi / 2), (frames.base_link, "_frd"): (math.pi, 0.0, 0.0)}
    return [
        {
            "header": header(now_ns, frame),
            "child_frame_id": f"{frame}{suffix}",
            "transform": {"translation": xyz((0.0, 0.0, 0.0)), "rotation": wxyz(quaternion_from_euler(*turn))},
        }
        for (frame, suffix), turn in turns.items()
    ]


def diagnostic(level: int, name: str, text: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """diagnostic_msgs' DiagnosticStatus; levels 0 to 3: OK, WARN, ERROR, STALE."""
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    return {"level": level, "name": name, "message": text, "hardware_id": "skygcs", "values": pairs}


def connection_status(mavros: str, connected: bool, mode: str | None, armed: bool | None) -> dict[str, Any]:
    """The connection of a vehicle with the namespace ``mavros``."""
    text = "connected" if connected else "not heard"
    return diagnostic(OK if connected else ERROR, f"{mavros}: connection", text, {"mode": mode, "armed": armed})
