"""Facts in parameter names: the same parameter in two generations, and parameters of one vehicle only."""

from __future__ import annotations

import re
from typing import Literal

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
    ("statistics", r"SYSID_SW_(MREV|TYPE)|LOG_LASTFILE|(BARO|GND)\d?_(GND_PRESS|ABS_PRESS|TEMP)|BARO\d_GND_PRESS"),
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
