"""Facts in parameter names: the same parameter in two generations, parameters of one vehicle only, and roles: the part
of a flight that a change of one of them would touch.

    role            touches                                       while a flight runs by it   harmless in the air
    --------------  --------------------------------------------  --------------------------  -------------------
    identity        ids and type, by which it is addressed        refused                     no
    airframe        frame, outputs, sensors' mounting             refused                     no
    setpoint loss   its own act when setpoints stop               refused                     no
    failsafe        its own acts when ground, sticks or battery fail  refused                 no
    fence           its own fence                                 refused                     no
    estimator       the source and the filter of its position     refused                     no
    return          the height and the way of its return          refused                     no
    link            its ports, and the telemetry it sends         refused                     no
    transmitter     sticks, switches and the modes on them        refused                     no
    arming          when it arms, and disarms itself              refused                     no
    tuning          gains and limits of its control               unless forced               no
    unknown         not in these tables                           unless forced               no
    harmless        logs, lights, sounds, statistics              passes                      yes

The tables are allow lists: a name that no pattern matches has an unknown effect, and nobody but a person who insists
changes that in flight. The lock of a flight uses the third column, the outgoing gate the fourth.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import StrEnum
from functools import lru_cache
from typing import Literal

# --- generations and sorts --------------------------------------------------------------------------------------------

Sort = Literal["settings", "calibration", "statistics", "identity"]
"""settings: equal on all vehicles of a type; the other sorts belong to one airframe, or to its history."""

SORTS: tuple[Sort, ...] = ("settings", "calibration", "statistics", "identity")

_RENAMED = {
    "SYSID_THISMAV": "MAV_SYSID",
    "SYSID_MYGCS": "MAV_GCS_SYSID",
    "TELEM_DELAY": "MAV_TELEM_DELAY",
}
"""Names in ArduPilot up to 4.6, and from 4.7 on, with the same meaning (others also changed their units)."""

_STREAMS = ("RAW_SENS", "EXT_STAT", "RC_CHAN", "RAW_CTRL", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3", "PARAMS", "ADSB")
"""SR0_EXTRA1, the first port's stream, is MAV1_EXTRA1 from 4.7 on."""

_OLDER = re.compile(rf"SR(\d)_({'|'.join(_STREAMS)})")
_NEWER = re.compile(rf"MAV(\d)_({'|'.join(_STREAMS)})")

_PATTERNS: tuple[tuple[Sort, str], ...] = (
    ("identity", r"SYSID_THISMAV|MAV_SYSID|MAV_SYS_ID|MAV_COMP_ID|BRD_SERIAL_NUM"),
    ("statistics", r"STAT_.*|_HASH_CHECK|LND_FLIGHT_T_(HI|LO)|COM_FLIGHT_UUID|(MIS|FENCE|RALLY)_TOTAL|FORMAT_VERSION"),
    ("statistics", r"SYSID_SW_(MREV|TYPE)|SYS_NUM_RESETS|CMD_(TOTAL|INDEX)|LOG_LASTFILE"),
    ("statistics", r"(BARO|GND)\d?_(GND_PRESS|ABS_PRESS\d?|TEMP)"),
    ("calibration", r"COMPASS_(OFS|DIA|ODI|MOT|SCALE)\d?(_[XYZ])?|COMPASS_(DEV_ID\d?|PRIO\d_ID|DEC)"),
    ("calibration", r"INS_?(ACC|GYR)\d?_?(OFFS|SCAL|ID|CALTEMP)(_[XYZ])?|INS\d?_?(ACC|GYR)\d?OFFS_[XYZ]|INS_TCAL.*"),
    ("calibration", r"INS\d_(ACC|GYR)(OFFS|SCAL)?_(X|Y|Z|ID)|AHRS_TRIM_[XYZ]|(ARSPD|BARO)\d?_(OFFSET|DEVID)"),
    ("calibration", r"CAL_.*|TC_[ABGM]\d?_.*|SENS_DPRES_OFF|RC\d{1,2}_(MIN|MAX|TRIM)"),
)
_SORTS = tuple((sort, re.compile(pattern)) for sort, pattern in _PATTERNS)


def other_name(name: str) -> str | None:
    """The parameter's name in the other generation of ArduPilot; None if it has only one."""
    if (match := _OLDER.fullmatch(name)) is not None:
        return f"MAV{int(match[1]) + 1}_{match[2]}"
    if (match := _NEWER.fullmatch(name)) is not None and match[1] != "0":
        return f"SR{int(match[1]) - 1}_{match[2]}"
    if name in _RENAMED:
        return _RENAMED[name]
    return next((old for old, new in _RENAMED.items() if new == name), None)


def sort_of(name: str) -> Sort:
    """The sort of a parameter, by its name."""
    return next((sort for sort, pattern in _SORTS if pattern.fullmatch(name)), "settings")


def turns_on(name: str) -> bool:
    """True if it enables a feature whose own parameters ArduPilot shows only then."""
    return name.endswith(("_ENABLE", "_ENABLED"))


# --- roles ------------------------------------------------------------------------------------------------------------


class ParamRole(StrEnum):
    IDENTITY = "identity"
    AIRFRAME = "airframe"
    SETPOINT_LOSS = "setpoint loss"
    FAILSAFE = "failsafe"
    FENCE = "fence"
    ESTIMATOR = "estimator"
    RETURN = "return"
    LINK = "link"
    TRANSMITTER = "transmitter"
    ARMING = "arming"
    TUNING = "tuning"
    UNKNOWN = "unknown"
    HARMLESS = "harmless"


LOCKED = frozenset(ParamRole) - {ParamRole.TUNING, ParamRole.UNKNOWN, ParamRole.HARMLESS}
"""Parameters of these roles stay as they were when a flight was certified or entered: a change is refused until it has
ended, also with force. Gains are not among them: with force they may be tuned in flight."""

EFFECTS: Mapping[ParamRole, str] = {
    ParamRole.IDENTITY: "it is addressed by it",
    ParamRole.AIRFRAME: "its motors and sensors are driven by it",
    ParamRole.SETPOINT_LOSS: "it decides what the vehicle does when setpoints stop",
    ParamRole.FAILSAFE: "its failsafes act by it",
    ParamRole.FENCE: "its own fence is made of it",
    ParamRole.ESTIMATOR: "its position is estimated by it",
    ParamRole.RETURN: "it returns by it",
    ParamRole.LINK: "its orders and its telemetry pass by it",
    ParamRole.TRANSMITTER: "its pilot takes over by it",
    ParamRole.ARMING: "it disarms by it",
    ParamRole.TUNING: "it is a gain or a limit of its control",
    ParamRole.UNKNOWN: "its effect in flight is not known to skygcs",
    ParamRole.HARMLESS: "it changes nothing that is flown",
}
"""The reason, after the parameter's name."""

_Table = tuple[tuple[ParamRole, str], ...]

_PX4: _Table = (
    (
        ParamRole.HARMLESS,
        r"SDLOG_.*|LND_FLIGHT_T_(HI|LO)|COM_FLIGHT_UUID|CBRK_BUZZER|SYS_USE_IO_LED|LIGHT_.*|EVENTS_.*",
    ),
    (ParamRole.IDENTITY, r"MAV_(SYS_ID|COMP_ID|TYPE|PROTO_VER|FWDEXTSP)"),
    (ParamRole.SETPOINT_LOSS, r"COM_OF_LOSS_T|COM_OBL_(RC_)?ACT|COM_OBC_LOSS_T"),
    (ParamRole.FENCE, r"GF_.*|CP_.*"),
    (ParamRole.RETURN, r"RTL_.*"),
    (ParamRole.TRANSMITTER, r"RC\d*_.*|RC_.*|COM_FLTMODE\d|COM_RC_(IN_MODE|OVERRIDE|STICK_OV)|MAN_.*"),
    (ParamRole.ARMING, r"COM_(ARM|DISARM|PREARM|KILL|SPOOLUP|ARMABLE|POWER)_?.*|COM_MOT_TEST_EN|LNDMC_.*"),
    (
        ParamRole.FAILSAFE,
        r"NAV_(DLL|RCL)_ACT|COM_(DL|RC|RCL|FAIL|LOW|QC|ACT|POS|VEL|WIND|IMB|TAS|HLDL|LKDOWN|FLT|FLTT)_.*",
    ),
    (ParamRole.FAILSAFE, r"BAT\d?_.*|CBRK_.*|FD_.*|COM_HOME_.*|COM_FLT.*|MIS_.*|NAV_FORCE_VT"),
    (ParamRole.ESTIMATOR, r"EKF2_.*|ATT_.*|LPE_.*|SENS_.*|CAL_.*|IMU_.*|TC_.*|GPS_.*|UAVCAN_SUB_.*|VIO_.*|SYS_HAS_.*"),
    (ParamRole.ESTIMATOR, r"SYS_MC_EST_GROUP|MAV_(ODOM|USEHIL|HASH).*|FLW_.*"),
    (ParamRole.AIRFRAME, r"SYS_.*|CA_.*|PWM_.*|HIL_.*|SIH_.*|UAVCAN_.*|DSHOT_.*|MOT_.*|THR_.*|VT_.*|FW_.*|RBCLW_.*"),
    (
        ParamRole.LINK,
        r"MAV_\d_.*|SER_.*|MAV_(RADIO|SIK|BROADCAST|S_MODE).*|NET_.*|UXRCE_.*|XRCE_.*|RTPS_.*|MAV_SIGN_.*",
    ),
    (ParamRole.TUNING, r"MC_.*|MPC_.*|NAV_.*|WV_.*"),
)

_ARDUPILOT: _Table = (
    (ParamRole.HARMLESS, r"LOG_(?!BACKEND_TYPE).*|NTF_.*|STAT_.*|OSD.*|LED.*"),
    (ParamRole.IDENTITY, r"SYSID_(THISMAV|MYGCS|ENFORCE)|MAV_(SYSID|GCS_SYSID|GCS_SYSID_HI|OPTIONS|COMPID)"),
    (ParamRole.SETPOINT_LOSS, r"GUID_(TIMEOUT|OPTIONS)"),
    (ParamRole.FENCE, r"FENCE_.*|AVOID_.*|OA_.*|PRX.*|RALLY_.*|AVD_.*"),
    (ParamRole.RETURN, r"RTL_.*|SRTL_.*|LAND_.*|PLND_.*"),
    (
        ParamRole.TRANSMITTER,
        r"RC\d+_.*|RC_.*|RCMAP_.*|FLTMODE.*|MODE\d|PILOT_.*|SIMPLE|SUPER_SIMPLE|TUNE(_.*)?|INITIAL_MODE",
    ),
    (ParamRole.ARMING, r"ARMING_.*|DISARM_DELAY|BRD_SAFETY.*|MOT_SPOOL_.*|MOT_SAFE_.*|LGR_.*|TKOFF_.*"),
    (ParamRole.FAILSAFE, r"FS_.*|BATT\d?_.*|CHUTE_.*|AFS_.*|DR_.*|GCS_PID_MASK|CRASH_.*|TERRAIN_.*"),
    (
        ParamRole.ESTIMATOR,
        r"EK[23]_.*|AHRS_.*|INS.*|COMPASS_.*|GPS\d?_.*|BARO\d?_.*|GND_.*|VISO_.*|FLOW_.*|RNGFND.*|BCN_.*",
    ),
    (ParamRole.ESTIMATOR, r"EKF_.*|ARSPD.*|EAHRS_.*"),
    (
        ParamRole.AIRFRAME,
        r"FRAME_.*|SERVO.*|MOT_(?!THST_HOVER).*|ESC_.*|H_.*|Q_.*|BRD_.*|CAN_.*|RPM\d?_.*|SCHED_.*|SCR_.*|SIM_.*",
    ),
    (ParamRole.AIRFRAME, r"RELAY.*|GRIP_.*|FORMAT_VERSION|SYSID_SW_.*|RELOAD_.*"),
    (ParamRole.LINK, r"SERIAL\w*_.*|SR\d_.*|MAV\d_.*|TELEM_DELAY|MAV_TELEM_DELAY|NET_.*|DDS_.*|DID_.*"),
    (
        ParamRole.TUNING,
        r"ATC_.*|PSC_.*|WPNAV_.*|WP_.*|LOIT_.*|CIRCLE_.*|PHLD_.*|ANGLE_MAX|MOT_THST_HOVER|AUTO_.*|ACRO_.*|THROW_.*",
    ),
)

_TABLES: Mapping[str, tuple[tuple[ParamRole, re.Pattern[str]], ...]] = {
    family: tuple((role, re.compile(pattern)) for role, pattern in table)
    for family, table in (("px4", _PX4), ("ardupilot", _ARDUPILOT))
}


@lru_cache(maxsize=4096)
def role_of(family: str, name: str) -> ParamRole:
    """The role of a parameter of this firmware ("px4", "ardupilot"); the first pattern that matches counts."""
    table = _TABLES.get(family, ())
    return next((role for role, pattern in table if pattern.fullmatch(name)), ParamRole.UNKNOWN)
