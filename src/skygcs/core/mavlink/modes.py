"""Flight modes by name: what HEARTBEAT.custom_mode means for PX4 and for each ArduPilot vehicle.

PX4 packs a main and a sub mode (px4_custom_mode.h: main << 16 | sub << 24); ArduPilot numbers its modes per vehicle
type. Names are the common ones: PX4's as MAVROS writes them (AUTO.LOITER), ArduPilot's as in its
parameters. Names are looked up in any case and with any of ``. _ -`` or nothing between the words.
"""

from __future__ import annotations

from typing import Literal

from skygcs.spelling import near_names

Family = Literal["px4", "ardupilot", "generic"]

AUTOPILOT_ARDUPILOT = 3
AUTOPILOT_PX4 = 12
"""Values of MAV_AUTOPILOT; they are part of the protocol and never change."""

CUSTOM_MODE_ENABLED = 0x01
SAFETY_ARMED = 0x80
"""Bits of HEARTBEAT.base_mode (MAV_MODE_FLAG)."""

PX4_MAIN_AUTO = 4

_PX4_MAIN = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    4: "AUTO",
    5: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
    8: "RATTITUDE",
    9: "SIMPLE",
    10: "TERMINATION",
    11: "ALTITUDE_CRUISE",
}

_PX4_SUB = {
    (3, 1): "POSCTL.ORBIT",
    (3, 2): "POSCTL.SLOW",
    (4, 1): "AUTO.READY",
    (4, 2): "AUTO.TAKEOFF",
    (4, 3): "AUTO.LOITER",
    (4, 4): "AUTO.MISSION",
    (4, 5): "AUTO.RTL",
    (4, 6): "AUTO.LAND",
    (4, 7): "AUTO.RTGS",
    (4, 8): "AUTO.FOLLOW_TARGET",
    (4, 9): "AUTO.PRECLAND",
    (4, 10): "AUTO.VTOL_TAKEOFF",
    **{(4, 10 + n): f"AUTO.EXTERNAL{n}" for n in range(1, 9)},
}

_PX4_ALIASES = {
    "HOLD": "AUTO.LOITER",
    "RETURN": "AUTO.RTL",
    "FOLLOWME": "AUTO.FOLLOW_TARGET",
    "ALTITUDE": "ALTCTL",
    "POSITION": "POSCTL",
    "STABILIZE": "STABILIZED",
}
"""Other names of modes, used by QGroundControl and MAVSDK."""

_COPTER = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    4: "GUIDED",
    5: "LOITER",
    6: "RTL",
    7: "CIRCLE",
    8: "POSITION",
    9: "LAND",
    10: "OF_LOITER",
    11: "DRIFT",
    13: "SPORT",
    14: "FLIP",
    15: "AUTOTUNE",
    16: "POSHOLD",
    17: "BRAKE",
    18: "THROW",
    19: "AVOID_ADSB",
    20: "GUIDED_NOGPS",
    21: "SMART_RTL",
    22: "FLOWHOLD",
    23: "FOLLOW",
    24: "ZIGZAG",
    25: "SYSTEMID",
    26: "AUTOROTATE",
    27: "AUTO_RTL",
    28: "TURTLE",
    29: "RATE_ACRO",
}
"""8 and 10 exist in ArduCopter 3.x only; newer firmware refuses them itself."""

COPTER_NOT_ARMABLE = frozenset(
    {"RTL", "CIRCLE", "LAND", "FLIP", "AUTOTUNE", "BRAKE", "AVOID_ADSB", "SMART_RTL", "FOLLOW", "SYSTEMID"}
    | {"AUTOROTATE", "AUTO_RTL"}
)
"""Modes in which ArduCopter refuses every unforced arming by a ground station ("… mode not armable"), whatever its
pre-arm checks say: `allows_arming` of ArduCopter/mode.h and mode_auto.cpp, the same in 4.6.3 and 4.7-dev."""

PX4_NOT_ARMABLE = frozenset(
    {"AUTO.RTL", "AUTO.LAND", "AUTO.PRECLAND", "AUTO.FOLLOW_TARGET", "POSCTL.ORBIT", "TERMINATION"}
)
"""Modes in which PX4 refuses arming (mode_req_prevent_arming of commander/ModeUtil/mode_requirements.cpp, 1.16): its
bit of the arming checks is clear in them, whatever the checks say."""

COPTER_AUTO_ARMABLE = 1
"""Bit of AUTO_OPTIONS: only with it ArduCopter arms in AUTO (ModeAuto::allows_arming, since 4.1)."""

_PLANE = {
    0: "MANUAL",
    1: "CIRCLE",
    2: "STABILIZE",
    3: "TRAINING",
    4: "ACRO",
    5: "FBWA",
    6: "FBWB",
    7: "CRUISE",
    8: "AUTOTUNE",
    10: "AUTO",
    11: "RTL",
    12: "LOITER",
    13: "TAKEOFF",
    14: "AVOID_ADSB",
    15: "GUIDED",
    16: "INITIALISING",
    17: "QSTABILIZE",
    18: "QHOVER",
    19: "QLOITER",
    20: "QLAND",
    21: "QRTL",
    22: "QAUTOTUNE",
    23: "QACRO",
    24: "THERMAL",
    25: "LOITERALTQLAND",
    26: "AUTOLAND",
}

_ROVER = {
    0: "MANUAL",
    1: "ACRO",
    2: "LEARNING",
    3: "STEERING",
    4: "HOLD",
    5: "LOITER",
    6: "FOLLOW",
    7: "SIMPLE",
    8: "DOCK",
    9: "CIRCLE",
    10: "AUTO",
    11: "RTL",
    12: "SMART_RTL",
    15: "GUIDED",
    16: "INITIALISING",
}

_SUB = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    4: "GUIDED",
    7: "CIRCLE",
    9: "SURFACE",
    16: "POSHOLD",
    19: "MANUAL",
    20: "MOTORDETECT",
    21: "SURFTRAK",
}

_TRACKER = {0: "MANUAL", 1: "STOP", 2: "SCAN", 3: "SERVO_TEST", 4: "GUIDED", 10: "AUTO", 16: "INITIALISING"}

_BLIMP = {0: "LAND", 1: "MANUAL", 2: "VELOCITY", 3: "LOITER", 4: "RTL", 5: "AUTO", 6: "HOLD"}

COPTER_TYPES = frozenset({2, 3, 4, 13, 14, 15, 29, 35, 43})
PLANE_TYPES = frozenset({1, 16, 17, 19, 20, 21, 22, 23, 24, 25, 28, 47})


def family(autopilot: int) -> Family:
    """The firmware family of a HEARTBEAT.autopilot."""
    if autopilot == AUTOPILOT_PX4:
        return "px4"
    if autopilot == AUTOPILOT_ARDUPILOT:
        return "ardupilot"
    return "generic"


def mode_name(autopilot: int, vehicle_type: int, base_mode: int, custom_mode: int) -> str:
    """Name of a HEARTBEAT's mode; for an unknown mode its number. Never raises."""
    kind = family(autopilot)
    if kind == "generic":
        return _generic_name(base_mode)
    if kind == "px4":
        return px4_mode_name(custom_mode)
    return ardupilot_mode_name(vehicle_type, custom_mode)


def mode_names(autopilot: int, vehicle_type: int) -> tuple[str, ...]:
    """Every mode that `mode_number` knows for this kind of vehicle."""
    kind = family(autopilot)
    if kind == "px4":
        return tuple(name for main, name in _PX4_MAIN.items() if main != PX4_MAIN_AUTO) + tuple(_PX4_SUB.values())
    return tuple(_ardupilot_table(vehicle_type).values()) if kind == "ardupilot" else ()


def mode_number(autopilot: int, vehicle_type: int, name: str) -> int:
    """custom_mode of a mode. Raises KeyError with a message for the user that lists near matches."""
    kind = family(autopilot)
    if kind == "px4":
        return px4_custom_mode(name)
    if kind == "ardupilot":
        return _number_in(_ardupilot_table(vehicle_type), name)
    raise KeyError("skygcs knows no mode names of this autopilot")


def px4_mode_name(custom_mode: int) -> str:
    """MANUAL, POSCTL, AUTO.LOITER ...; UNKNOWN(main.sub) for a mode that is not in the table."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    if sub:
        return _PX4_SUB.get((main, sub)) or f"UNKNOWN({main}.{sub})"
    return _PX4_MAIN.get(main) or f"UNKNOWN({main}.{sub})"


def px4_custom_mode(name: str) -> int:
    """The custom_mode of a PX4 mode. Raises KeyError with a message for the user."""
    key = _group_values(name)
    key = _group_values(_PX4_ALIASES.get(key, key))
    for (main, sub), known in _PX4_SUB.items():
        if key in (_group_values(known), _group_values(known.partition(".")[2])):  # AUTO.LAND, or LAND for short
            return main << 16 | sub << 24
    for main, known in _PX4_MAIN.items():
        if main != PX4_MAIN_AUTO and _group_values(known) == key:
            return main << 16
    raise KeyError(_unknown(name, mode_names(AUTOPILOT_PX4, 0)))


def ardupilot_mode_name(vehicle_type: int, custom_mode: int) -> str:
    """Name of an ArduPilot mode, from the table of the firmware that flies this MAV_TYPE."""
    return _ardupilot_table(vehicle_type).get(custom_mode) or f"UNKNOWN({custom_mode})"


def copter_mode_number(name: str) -> int:
    """Number of an ArduCopter mode. Raises KeyError with a message for the user."""
    return _number_in(_COPTER, name)


def _ardupilot_table(vehicle_type: int) -> dict[int, str]:
    if vehicle_type in PLANE_TYPES:
        return _PLANE
    if vehicle_type in (10, 11):
        return _ROVER
    if vehicle_type == 12:
        return _SUB
    if vehicle_type == 5:
        return _TRACKER
    if vehicle_type == 7:
        return _BLIMP
    return _COPTER if vehicle_type in COPTER_TYPES else {}


def _number_in(table: dict[int, str], name: str) -> int:
    key = _group_values(name)
    for number, known in table.items():
        if _group_values(known) == key:
            return number
    raise KeyError(_unknown(name, tuple(table.values())))


def _group_values(name: str) -> str:
    return "".join(c for c in name.upper() if c.isalnum())


def _unknown(name: str, known: tuple[str, ...]) -> str:
    if not known:
        return (
            f"skygcs does not know the modes of this type of vehicle, so not {name!r} either; a raw command "
            "(DO_SET_MODE) sets one by its number"
        )
    near = near_names(name, known, n=3, cutoff=0.5)
    if near:
        return f"no mode {name!r}; did you mean {', '.join(near)}?"
    return f"no mode {name!r}; there are {', '.join(known)}"


def _generic_name(base_mode: int) -> str:
    """Only MAV_MODE_FLAG is common to all autopilots."""
    for bit, name in ((0x04, "AUTO"), (0x08, "GUIDED"), (0x10, "STABILIZE"), (0x40, "MANUAL")):
        if base_mode & bit:
            return name
    return "UNKNOWN"
