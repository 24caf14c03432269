"""The parameters of the simulated firmwares, and how fast they stream what nobody asked for.

Values are the firmwares' own defaults for a quadrotor, unless a comment says why not. Types are MAV_PARAM_TYPE.
"""

from __future__ import annotations

from collections.abc import Mapping

from skygcs.sim import protocol as m
from skygcs.sim import qgc_params
from skygcs.sim.param_table import Param

_TYPES = {
    "f": m.MAV_PARAM_TYPE_REAL32,
    "i": m.MAV_PARAM_TYPE_INT32,
    "h": m.MAV_PARAM_TYPE_INT16,
    "b": m.MAV_PARAM_TYPE_INT8,
}


def _table(text: str) -> tuple[tuple[str, float, int], ...]:
    """Words of the form NAME=value:type; {a-b} in a name stands for each number from a to b."""
    found: list[tuple[str, float, int]] = []
    for word in text.split():
        name, _, rest = word.partition("=")
        value, _, kind = rest.partition(":")
        before, numbers, after = (*name.partition("{")[::2], "") if "{" in name else (name, "", "")
        numbers, _, after = numbers.partition("}")
        first, _, last = numbers.partition("-")
        names = [f"{before}{n}{after}" for n in range(int(first), int(last) + 1)] if numbers else [name]
        found.extend((each, float(value), _TYPES[kind]) for each in names)
    return tuple(found)


_PX4 = _table("""
    BAT1_CAPACITY=5200.0:f BAT1_N_CELLS=4:i BAT_CRIT_THR=0.07:f BAT_EMERGEN_THR=0.05:f BAT_LOW_THR=0.15:f
    COM_ARM_BAT_MIN=-1.0:f COM_ARM_WO_GPS=1:i COM_DISARM_LAND=2.0:f COM_DISARM_PRFLT=10.0:f COM_DL_LOSS_T=10:i
    COM_FAIL_ACT_T=5.0:f COM_LOW_BAT_ACT=0:i COM_OBL_RC_ACT=0:i COM_OF_LOSS_T=1.0:f COM_RC_IN_MODE=1:i
    COM_DLL_EXCEPT=0:i COM_RCL_EXCEPT=4:i
    GF_ACTION=2:i GF_MAX_HOR_DIST=0.0:f GF_MAX_VER_DIST=0.0:f MAV_0_MODE=0:i MAV_0_RATE=1200:i
    MAV_COMP_ID=1:i MAV_TYPE=2:i MIS_TAKEOFF_ALT=2.5:f MPC_ACC_DOWN_MAX=3.0:f MPC_ACC_HOR=3.0:f MPC_ACC_UP_MAX=4.0:f
    MPC_JERK_AUTO=4.0:f MPC_LAND_SPEED=0.7:f MPC_THR_HOVER=0.45:f MPC_TKO_SPEED=1.5:f MPC_XY_CRUISE=5.0:f
    MPC_XY_VEL_MAX=12.0:f MPC_YAWRAUTO_MAX=60.0:f MPC_Z_V_AUTO_DN=1.5:f MPC_Z_V_AUTO_UP=3.0:f NAV_ACC_RAD=2.0:f
    NAV_DLL_ACT=0:i NAV_RCL_ACT=2:i RTL_CONE_ANG=45:i RTL_MIN_DIST=10.0:f RTL_DESCEND_ALT=10.0:f RTL_LAND_DELAY=0.0:f
    EKF2_EV_CTRL=0:i EKF2_EV_DELAY=0.0:f EKF2_HGT_REF=1:i
    RTL_RETURN_ALT=30.0:f SDLOG_MODE=0:i SYS_AUTOSTART=4001:i
""")

_COPTER = _table("""
    PSC_JERK_XY=5.0:f PSC_JERK_Z=5.0:f
    ANGLE_MAX=3000:h ARMING_CHECK=1:i ATC_ANGLE_BOOST=1:b AVOID_ENABLE=3:b BATT_CAPACITY=5200:i BATT_CRT_MAH=0.0:f
    BATT_FS_CRT_ACT=0:b BATT_FS_LOW_ACT=0:b BATT_LOW_MAH=1040.0:f BATT_LOW_VOLT=10.5:f BATT_MONITOR=4:b
    COMPASS_USE=1:b DISARM_DELAY=10:b FENCE_ACTION=1:b FENCE_ALT_MAX=100.0:f FENCE_ENABLE=0:b FENCE_MARGIN=2.0:f
    EK3_SRC1_POSXY=3:b EK3_SRC1_POSZ=1:b EK3_SRC1_VELXY=3:b EK3_SRC1_VELZ=3:b EK3_SRC1_YAW=1:b VISO_TYPE=0:b
    FENCE_RADIUS=300.0:f FENCE_TYPE=7:b FRAME_CLASS=1:b FRAME_TYPE=1:b FS_EKF_ACTION=1:b FS_GCS_ENABLE=0:b
    FS_GCS_TIMEOUT=5.0:f FS_OPTIONS=16:i FS_THR_ENABLE=0:b GPS_TYPE=1:b AUTO_OPTIONS=0:i GUID_OPTIONS=0:i
    GUID_TIMEOUT=3.0:f LAND_SPEED=50:h LOG_BITMASK=176126:i MOT_THST_HOVER=0.45:f PILOT_TKOFF_ALT=0.0:f RTL_ALT=1500:i
    RTL_CONE_SLOPE=3.0:f RTL_ALT_FINAL=0:h RTL_LOIT_TIME=5000:i SERIAL1_BAUD=57:i SERIAL1_PROTOCOL=2:b
    SERIAL2_BAUD=57:i SERIAL2_PROTOCOL=2:b SR1_EXTRA1=2:h SR1_EXTRA2=1:h SR1_EXTRA3=1:h SR1_EXT_STAT=1:h
    SR1_POSITION=2:h SR1_RAW_SENS=0:h SR1_RC_CHAN=0:h SYSID_ENFORCE=0:b SYSID_MYGCS=255:h WPNAV_ACCEL=250.0:f
    WPNAV_ACCEL_Z=100.0:f WPNAV_SPEED=1000.0:f WPNAV_SPEED_DN=150.0:f WPNAV_SPEED_UP=250.0:f
""")

PX4_RATES_HZ: Mapping[str, float] = {
    "HEARTBEAT": 1,
    "SYS_STATUS": 1,
    "GPS_RAW_INT": 1,
    "ATTITUDE": 4,
    "GLOBAL_POSITION_INT": 2,
    "LOCAL_POSITION_NED": 1,
    "VFR_HUD": 1,
    "ALTITUDE": 0.5,
    "BATTERY_STATUS": 0.5,
    "EXTENDED_SYS_STATE": 1,
    "ESTIMATOR_STATUS": 0.5,
    "HOME_POSITION": 0.2,
    "MISSION_CURRENT": 0.2,
    "SYSTEM_TIME": 0.5,
}
"""Rates of the Normal profile that MAV_0_RATE 1200 leaves: some 650 B/s."""


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
station that asks for nothing still sees a landing. POSITION_TARGET_GLOBAL_INT, which the real firmware sends with
SYS_STATUS, comes on request only.
"""


def px4_params(sysid: int) -> list[Param]:
    return [Param(*p) for p in (*_PX4, *_table(qgc_params.PX4))] + [Param("MAV_SYS_ID", sysid, m.MAV_PARAM_TYPE_INT32)]


def copter_params(sysid: int) -> list[Param]:
    return [Param(*p) for p in (*_COPTER, *_table(qgc_params.COPTER))] + [
        Param("SYSID_THISMAV", sysid, m.MAV_PARAM_TYPE_INT16)
    ]


_COPTER_ONLY = (
    *("ATC_", "ANGLE_", "AUTO_", "AVOID_", "DISARM_", "FS_", "GUID_", "LAND_", "MOT_", "PILOT_", "PSC_", "RTL_"),
    *("WPNAV_", "VISO_", "FRAME_TYPE", "PHLD_", "ACRO_", "LOIT_", "CIRCLE_", "TUNE", "SIMPLE", "SUPER_", "THROW_"),
)

_ROVER = _table("""
    ATC_ACCEL_MAX=1.0:f ATC_DECEL_MAX=0.0:f ATC_TURN_MAX_G=0.6:f CRUISE_SPEED=2.0:f CRUISE_THROTTLE=50:b FS_ACTION=2:b
    FS_EKF_ACTION=1:b FS_GCS_ENABLE=0:b FS_GCS_TIMEOUT=5.0:f FS_OPTIONS=0:i FS_TIMEOUT=1.5:f INITIAL_MODE=0:b
    LOIT_RADIUS=2.0:f LOIT_TYPE=0:b RTL_SPEED=0.0:f TURN_RADIUS=0.9:f WP_RADIUS=2.0:f WP_SPEED=2.0:f
""")
"""Rover/Parameters.cpp, AR_WPNav.cpp, AR_AttitudeControl.cpp: the defaults of 4.6."""

_PLANE = _table("""
    AIRSPEED_CRUISE=12.0:f AIRSPEED_MAX=22:h AIRSPEED_MIN=9:h FS_GCS_ENABL=0:b FS_LONG_ACTN=0:b FS_LONG_TIMEOUT=5.0:f
    FS_SHORT_ACTN=0:b FS_SHORT_TIMEOUT=1.5:f LAND_DISARMDELAY=20:b Q_ENABLE=0:b ROLL_LIMIT_DEG=45.0:f
    RTL_ALTITUDE=100.0:f RTL_AUTOLAND=0:b RTL_RADIUS=0:h TECS_CLMB_MAX=5.0:f TECS_SINK_MAX=5.0:f TKOFF_ALT=50.0:f
    TKOFF_DIST=200.0:f WP_LOITER_RAD=60:h WP_RADIUS=90:h
""")
"""ArduPlane/Parameters.cpp and config.h, mode_takeoff.cpp, AP_TECS.cpp: the defaults of 4.6."""

_PX4_PLANE = _table("""
    FW_AIRSPD_MAX=20.0:f FW_AIRSPD_MIN=10.0:f FW_AIRSPD_TRIM=15.0:f FW_R_LIM=50.0:f FW_T_CLMB_R_SP=3.0:f
    FW_T_SINK_R_SP=2.0:f NAV_LOITER_RAD=80.0:f RWTO_TKOFF=1:i
    COM_DISARM_PRFLT=-1.0:f MAV_TYPE=1:i MIS_TAKEOFF_ALT=25.0:f NAV_ACC_RAD=10.0:f RTL_DESCEND_ALT=100.0:f
    RTL_LAND_DELAY=-1.0:f RTL_LOITER_RAD=80.0:f RTL_RETURN_ALT=100.0:f RTL_TYPE=1:i SYS_AUTOSTART=10041:i
""")
"""fw_path_navigation_params.c, performance_model_params.c, navigator_params.c, and what init.d/rc.fw_defaults sets."""


def _of_ardupilot(sysid: int, own: tuple[tuple[str, float, int], ...]) -> list[Param]:
    """Parameters that all of ArduPilot's programs share, and those of one of them."""
    names = {name for name, _, _ in own}
    shared = [p for p in copter_params(sysid) if not p.name.startswith(_COPTER_ONLY) and p.name not in names]
    return shared + [Param(*p) for p in own]


def rover_params(sysid: int) -> list[Param]:
    return _of_ardupilot(sysid, _ROVER)


def plane_params(sysid: int) -> list[Param]:
    return _of_ardupilot(sysid, _PLANE)


def px4_plane_params(sysid: int) -> list[Param]:
    names = {name for name, _, _ in _PX4_PLANE}
    return [p for p in px4_params(sysid) if p.name not in names] + [Param(*p) for p in _PX4_PLANE]
