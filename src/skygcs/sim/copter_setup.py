"""ArduCopter's modes by number, its parameters and stream groups, as far as a simulated one has them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from skygcs.sim import protocol as m
from skygcs.sim.param_table import Param


class CopterMode(IntEnum):
    """HEARTBEAT.custom_mode (ArduCopter/mode.h)."""

    STABILIZE = 0
    ACRO = 1
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    CIRCLE = 7
    LAND = 9
    DRIFT = 11
    SPORT = 13
    FLIP = 14
    AUTOTUNE = 15
    POSHOLD = 16
    BRAKE = 17
    THROW = 18
    AVOID_ADSB = 19
    GUIDED_NOGPS = 20
    SMART_RTL = 21
    FLOWHOLD = 22
    FOLLOW = 23
    ZIGZAG = 24
    SYSTEMID = 25
    AUTOROTATE = 26
    AUTO_RTL = 27
    TURTLE = 28


NEEDS_POSITION = frozenset(
    {
        CopterMode.AUTO,
        CopterMode.GUIDED,
        CopterMode.LOITER,
        CopterMode.RTL,
        CopterMode.CIRCLE,
        CopterMode.DRIFT,
        CopterMode.POSHOLD,
        CopterMode.BRAKE,
        CopterMode.SMART_RTL,
        CopterMode.FOLLOW,
        CopterMode.ZIGZAG,
        CopterMode.AUTO_RTL,
    }
)
NO_ARMING_MODES = frozenset(
    {
        CopterMode.RTL,
        CopterMode.LAND,
        CopterMode.CIRCLE,
        CopterMode.FLIP,
        CopterMode.AUTOTUNE,
        CopterMode.BRAKE,
        CopterMode.AVOID_ADSB,
        CopterMode.SMART_RTL,
        CopterMode.FOLLOW,
        CopterMode.SYSTEMID,
        CopterMode.AUTOROTATE,
        CopterMode.AUTO_RTL,
    }
)
GUIDED_FLAG_MODES = frozenset(
    {
        CopterMode.AUTO,
        CopterMode.GUIDED,
        CopterMode.LOITER,
        CopterMode.RTL,
        CopterMode.CIRCLE,
        CopterMode.LAND,
        CopterMode.POSHOLD,
        CopterMode.BRAKE,
        CopterMode.SMART_RTL,
        CopterMode.FOLLOW,
    }
)
"""Modes in which HEARTBEAT.base_mode has MAV_MODE_FLAG_GUIDED_ENABLED."""

_F, _8, _16, _32 = m.MAV_PARAM_TYPE_REAL32, m.MAV_PARAM_TYPE_INT8, m.MAV_PARAM_TYPE_INT16, m.MAV_PARAM_TYPE_INT32
_PARAMS: tuple[tuple[str, float, int], ...] = (
    ("ANGLE_MAX", 3000, _16),
    ("ARMING_CHECK", 1, _32),
    ("ATC_ANGLE_BOOST", 1, _8),
    ("BATT_CAPACITY", 5200, _32),
    ("BATT_CRT_MAH", 0.0, _F),
    ("BATT_FS_CRT_ACT", 0, _8),
    ("BATT_FS_LOW_ACT", 0, _8),
    ("BATT_LOW_MAH", 1040.0, _F),
    ("BATT_LOW_VOLT", 10.5, _F),
    ("BATT_MONITOR", 4, _8),
    ("COMPASS_USE", 1, _8),
    ("DISARM_DELAY", 10, _8),
    ("FENCE_ACTION", 1, _8),
    ("FENCE_ALT_MAX", 100.0, _F),
    ("FENCE_ENABLE", 0, _8),
    ("FENCE_RADIUS", 300.0, _F),
    ("FENCE_TYPE", 7, _8),
    ("FRAME_CLASS", 1, _8),
    ("FRAME_TYPE", 1, _8),
    ("FS_EKF_ACTION", 1, _8),
    ("FS_GCS_ENABLE", 0, _8),
    ("FS_GCS_TIMEOUT", 5.0, _F),
    ("FS_OPTIONS", 16, _32),
    ("FS_THR_ENABLE", 0, _8),
    ("GPS_TYPE", 1, _8),
    ("AUTO_OPTIONS", 0, _32),
    ("GUID_OPTIONS", 0, _32),
    ("GUID_TIMEOUT", 3.0, _F),
    ("LAND_SPEED", 50, _16),
    ("LOG_BITMASK", 176126, _32),
    ("MOT_THST_HOVER", 0.45, _F),
    ("PILOT_TKOFF_ALT", 0.0, _F),
    ("RTL_ALT", 1500, _32),
    ("RTL_ALT_FINAL", 0, _16),
    ("RTL_LOIT_TIME", 5000, _32),
    ("SERIAL1_BAUD", 57, _32),
    ("SERIAL1_PROTOCOL", 2, _8),
    ("SERIAL2_BAUD", 57, _32),
    ("SERIAL2_PROTOCOL", 2, _8),
    ("SR1_EXTRA1", 2, _16),
    ("SR1_EXTRA2", 1, _16),
    ("SR1_EXTRA3", 1, _16),
    ("SR1_EXT_STAT", 1, _16),
    ("SR1_POSITION", 2, _16),
    ("SR1_RAW_SENS", 0, _16),
    ("SR1_RC_CHAN", 0, _16),
    ("SYSID_ENFORCE", 0, _8),
    ("SYSID_MYGCS", 255, _16),
    ("WPNAV_ACCEL", 250.0, _F),
    ("WPNAV_SPEED", 1000.0, _F),
    ("WPNAV_SPEED_DN", 150.0, _F),
    ("WPNAV_SPEED_UP", 250.0, _F),
)

STREAM_GROUPS: Mapping[int, tuple[str, tuple[str, ...]]] = {
    m.MAV_DATA_STREAM_RAW_SENSORS: ("SR1_RAW_SENS", ("RAW_IMU",)),
    m.MAV_DATA_STREAM_EXTENDED_STATUS: (
        "SR1_EXT_STAT",
        ("SYS_STATUS", "MISSION_CURRENT", "GPS_RAW_INT", "FENCE_STATUS"),
    ),
    m.MAV_DATA_STREAM_RC_CHANNELS: ("SR1_RC_CHAN", ("RC_CHANNELS",)),
    m.MAV_DATA_STREAM_POSITION: ("SR1_POSITION", ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")),
    m.MAV_DATA_STREAM_EXTRA1: ("SR1_EXTRA1", ("ATTITUDE",)),
    m.MAV_DATA_STREAM_EXTRA2: ("SR1_EXTRA2", ("VFR_HUD",)),
    m.MAV_DATA_STREAM_EXTRA3: (
        "SR1_EXTRA3",
        ("SYSTEM_TIME", "BATTERY_STATUS", "EKF_STATUS_REPORT", "EXTENDED_SYS_STATE"),
    ),
}
"""MAV_DATA_STREAM -> (its rate's parameter, its messages).

EXTENDED_SYS_STATE is in no group of the real firmware, which sends it on request only; here it is, so that a ground
station that asks for nothing still sees a landing.
"""


def copter_params(sysid: int) -> list[Param]:
    return [Param(*p) for p in _PARAMS] + [Param("SYSID_THISMAV", sysid, _16)]
