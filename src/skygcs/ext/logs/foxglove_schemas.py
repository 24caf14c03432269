"""Messages in JSON with the schemas that Foxglove and Lichtblick show without set-up, and JSON of any MAVLink message.

The schemas have the names and fields of Foxglove's own (foxglove.PoseInFrame, …); `tests/unit/tlog/test_tlog_export.py`
compares them with those of foxglove-sdk.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

from skygcs.core.mavlink.dialect import FieldInfo, MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.ext.logs.motion import BatterySample, PoseSample, Quaternion

Json = dict[str, Any]

MAP_FRAME = "map"
"""The frame of all poses: metres east, north, up of the origin."""

LONGEST_SPLIT = 32
"""A longer array of bytes is data: base64, as in Foxglove's schemas."""


def _object(title: str, **properties: Json) -> Json:
    return {"title": title, "type": "object", "properties": properties}


def _list(items: Json) -> Json:
    return {"type": "array", "items": items}


_NUMBER: Json = {"type": "number"}
_INTEGER: Json = {"type": "integer"}
_TEXT: Json = {"type": "string"}
_TIME = _object("time", sec={"type": "integer", "minimum": 0}, nsec={"type": "integer", "minimum": 0})
_VECTOR = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_TRANSFORM = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)

SCHEMAS: Mapping[str, Json] = {
    schema["title"]: schema
    for schema in (
        _object("foxglove.PoseInFrame", timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
        _object("foxglove.PosesInFrame", timestamp=_TIME, frame_id=_TEXT, poses=_list(_POSE)),
        _object("foxglove.FrameTransforms", transforms=_list(_TRANSFORM)),
        _object(
            "foxglove.LocationFix",
            timestamp=_TIME,
            frame_id=_TEXT,
            latitude=_NUMBER,
            longitude=_NUMBER,
            altitude=_NUMBER,
            position_covariance=_list(_NUMBER),
            position_covariance_type=_INTEGER,
        ),
        _object(
            "foxglove.Log",
            timestamp=_TIME,
            level=_INTEGER,
            message=_TEXT,
            name=_TEXT,
            file=_TEXT,
            line=_INTEGER,
        ),
        _object("vehicle.Battery", timestamp=_TIME, volts=_NUMBER, amps=_NUMBER, percent=_NUMBER),
        _object(
            "vehicle.Velocity", timestamp=_TIME, east_mps=_NUMBER, north_mps=_NUMBER, up_mps=_NUMBER, ground_mps=_NUMBER
        ),
    )
}
"""By name."""

LOG_LEVELS = (5, 5, 5, 4, 3, 2, 2, 1)
"""foxglove.Log's level (1 debug, 2 info, 3 warning, 4 error, 5 fatal) of each MAV_SEVERITY."""


def time_of(unix_ns: int) -> Json:
    return {"sec": unix_ns // 1_000_000_000, "nsec": unix_ns % 1_000_000_000}


def _xyz(vector: Iterable[float]) -> Json:
    return dict(zip("xyz", vector, strict=True))


def _rotation(quaternion: Quaternion) -> Json:
    return dict(zip("xyzw", quaternion, strict=True))


def pose_json(pos_enu_m: Iterable[float], orientation: Quaternion) -> Json:
    """foxglove.Pose."""
    return {"position": _xyz(pos_enu_m), "orientation": _rotation(orientation)}


def pose_in_frame(unix_ns: int, pos_enu_m: Iterable[float], orientation: Quaternion) -> Json:
    return {"timestamp": time_of(unix_ns), "frame_id": MAP_FRAME, "pose": pose_json(pos_enu_m, orientation)}


def encoded(message: Json) -> str:
    """Raises ValueError for a number that is not finite."""
    return json.dumps(message, allow_nan=False, separators=(",", ":"))


def poses_in_frame(unix_ns: int, poses: Iterable[str]) -> str:
    """The path so far, encoded; ``poses``: each as `pose_json` makes it, encoded."""
    frame = encoded({"timestamp": time_of(unix_ns), "frame_id": MAP_FRAME, "poses": []})
    return f"{frame[:-2]}{','.join(poses)}]}}"


def frame_transforms(unix_ns: int, vehicle: str, pos_enu_m: Iterable[float], orientation: Quaternion) -> Json:
    """The vehicle's own frame in the map, so that a 3D view can follow it."""
    transform = {
        "timestamp": time_of(unix_ns),
        "parent_frame_id": MAP_FRAME,
        "child_frame_id": vehicle,
        "translation": _xyz(pos_enu_m),
        "rotation": _rotation(orientation),
    }
    return {"transforms": [transform]}


def location_fix(unix_ns: int, vehicle: str, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> Json:
    return {
        "timestamp": time_of(unix_ns),
        "frame_id": vehicle,
        "latitude": lat_deg,
        "longitude": lon_deg,
        "altitude": alt_amsl_m,
        "position_covariance": [0.0] * 9,
        "position_covariance_type": 0,  # unknown
    }


def log_message(unix_ns: int, vehicle: str, severity: int, text: str) -> Json:
    level = LOG_LEVELS[min(max(severity, 0), len(LOG_LEVELS) - 1)]
    return {
        "timestamp": time_of(unix_ns),
        "level": level,
        "message": text,
        "name": vehicle,
        "file": "",
        "line": 0,
    }


def battery_json(unix_ns: int, battery: BatterySample) -> Json:
    values = {"volts": battery.volts, "amps": battery.amps, "percent": battery.percent}
    return {"timestamp": time_of(unix_ns), **{name: value for name, value in values.items() if value is not None}}


def velocity_json(unix_ns: int, pose: PoseSample) -> Json:
    east, north, up = pose.vel_enu_mps
    ground = math.hypot(east, north)
    return {"timestamp": time_of(unix_ns), "east_mps": east, "north_mps": north, "up_mps": up, "ground_mps": ground}


# -- any MAVLink message


def message_schema(info: MessageInfo) -> Json:
    """A schema for plots: the message's fields, and the ids of its sender."""
    fields = {"sysid": _INTEGER, "compid": _INTEGER} | {field.name: _field_schema(field) for field in info.fields}
    return _object(f"mavlink.{info.name}", **fields)


def message_json(frame: Frame, info: MessageInfo) -> Json:
    """The fields of a frame. JSON has no NaN: such a field is left out, in an array it is null."""
    answer: Json = {"sysid": frame.sysid, "compid": frame.compid}
    values = frame.fields()
    for field in info.fields:
        value = values[field.name]
        if _is_data(field):
            value = base64.b64encode(bytes(value)).decode()
        elif isinstance(value, list):
            value = [None if isinstance(v, float) and not math.isfinite(v) else v for v in value]
        elif isinstance(value, float) and not math.isfinite(value):
            continue
        answer[field.name] = value
    return answer


def _is_data(field: FieldInfo) -> bool:
    return field.type == "uint8_t" and field.array_length > LONGEST_SPLIT


def _field_schema(field: FieldInfo) -> Json:
    if field.type == "char":
        return _TEXT
    if _is_data(field):
        return {"type": "string", "contentEncoding": "base64"}
    single = _NUMBER if field.type in ("float", "double") else _INTEGER
    if not field.array_length:
        return single
    return _list(single if single is _INTEGER else {"type": ["number", "null"]})
