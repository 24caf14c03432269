"""What a router reads of a HEARTBEAT without unpacking it; its payload is custom_mode (4 bytes), type, autopilot ..."""

from __future__ import annotations

from skygcs.core.mavlink.frame import HEADER_V1_BYTES, HEADER_V2_BYTES, MAGIC_V2, Frame

_MAV_TYPE_GCS = 6
_MAV_AUTOPILOT_INVALID = 8


def is_autopilots(heartbeat: Frame) -> bool:
    """Whether this is the heartbeat of an autopilot."""
    raw = heartbeat.raw
    at = HEADER_V2_BYTES if raw[0] == MAGIC_V2 else HEADER_V1_BYTES
    return raw[1] >= 6 and raw[at + 5] != _MAV_AUTOPILOT_INVALID and raw[at + 4] != _MAV_TYPE_GCS


def shown_by(heartbeat: Frame) -> bytes:
    """Custom mode, type, autopilot and base mode, as sent."""
    raw = heartbeat.raw
    at = HEADER_V2_BYTES if raw[0] == MAGIC_V2 else HEADER_V1_BYTES
    return raw[at : at + 7]
