"""Who is a vehicle: only the autopilot of one, told by its HEARTBEAT.

Not a GCS, a radio, a camera, a companion or an ADS-B receiver, whatever sysid they use; not a frame that no CRC vouches
for. Seen in the wild: 2/2 flooding heartbeats with autopilot INVALID, 1/0 as ADS-B and as a second quadrotor with
autopilot INVALID, a GCS 255/190 that calls its autopilot ArduPilot.
"""

from __future__ import annotations

from skygcs.core.mavlink.frame import Frame

HEARTBEAT = 0

AUTOPILOT_GENERIC = 0
AUTOPILOT_INVALID = 8

TYPE_GENERIC = 0

NOT_VEHICLES = frozenset({6, 18, 26, 27, 30, 31, 32, 33, 34, 36, 38, 39, 40, 41, 42, 44, 48})
"""MAV_TYPE: GCS, onboard controller, gimbal, ADS-B, camera, charging station, FLARM, servo, Open Drone ID, battery,
log, OSD, IMU, GPS, winch, illuminator, gripper. Parachute (37) is an airframe; what is yet to be defined is one too."""


def is_vehicle(vehicle_type: int, autopilot: int) -> bool:
    """Whether a HEARTBEAT with these fields makes its sender a vehicle.

    A generic autopilot must at least say what it flies; a real one may not know yet (PX4 before its airframe is set).
    """
    if autopilot == AUTOPILOT_INVALID or vehicle_type in NOT_VEHICLES:
        return False
    return autopilot != AUTOPILOT_GENERIC or vehicle_type != TYPE_GENERIC


def discovers(frame: Frame) -> bool:
    """Whether this frame makes its sender a vehicle: a verified HEARTBEAT of an autopilot. Never raises."""
    if frame.msgid != HEARTBEAT or frame.info is None or frame.sysid == 0:
        return False
    fields = frame.fields()
    return is_vehicle(fields.get("type", TYPE_GENERIC), fields.get("autopilot", AUTOPILOT_INVALID))
