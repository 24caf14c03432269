"""The items that the two firmwares accept in a mission, and conversions of other items that keep their meaning.

The tables were read from the firmwares' sources:

    PX4 v1.16.1         src/modules/mavlink/mavlink_mission.cpp, parse_mavlink_mission_item: accepted at the upload
                        src/modules/navigator/MissionFeasibility/FeasibilityChecker.cpp: flown, or "Mission rejected"
    PX4 main, 2026-08   src/modules/mavlink/mavlink_command_params.hpp: parameters that it does not use are refused
    ArduPilot 4.6.3     libraries/AP_Mission/AP_Mission.cpp, mavlink_int_to_mission_cmd, sanity_check_params: accepted
                        the same and ArduCopter/mode_auto.cpp, start_command: flown, or skipped
    both                the same files, format_mavlink_mission_item and mission_cmd_to_mavlink_int: what they report

`convert` and `refusals` handle one item, `for_firmware` the whole mission. An item is converted first, and `refusals`
checks the converted item: so the check and the upload have the same result. `same_item` compares a list that was read
with the one that was sent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import (
    FENCE_COMMANDS,
    GLOBAL,
    GLOBAL_FRAMES,
    MISSION_FRAME,
    RELATIVE_ALT,
    TERRAIN_ALT,
    UNSET_INT,
    MissionItem,
)
from skygcs.spelling import enumerated

Family = Literal["px4", "ardupilot"]

ROI_NONE, ROI_LOCATION = 0, 3
"""MAV_ROI, DO_SET_ROI's param1."""

PX4_PLACED = frozenset(
    {
        mav_cmd.NAV_WAYPOINT,
        mav_cmd.NAV_LOITER_UNLIM,
        mav_cmd.NAV_LOITER_TIME,
        mav_cmd.NAV_LAND,
        mav_cmd.NAV_TAKEOFF,
        mav_cmd.NAV_LOITER_TO_ALT,
        mav_cmd.NAV_ROI,
        mav_cmd.NAV_VTOL_TAKEOFF,
        mav_cmd.NAV_VTOL_LAND,
        mav_cmd.DO_SET_ROI_LOCATION,
        mav_cmd.DO_SET_ROI,
        mav_cmd.CONDITION_GATE,
    }
)
"""Accepted in a global frame."""

PX4_PLACELESS = frozenset(
    {
        mav_cmd.NAV_RETURN_TO_LAUNCH,
        mav_cmd.NAV_ROI,
        mav_cmd.NAV_DELAY,
        mav_cmd.CONDITION_DELAY,
        mav_cmd.CONDITION_DISTANCE,
        mav_cmd.DO_JUMP,
        mav_cmd.DO_CHANGE_SPEED,
        mav_cmd.DO_SET_HOME,
        mav_cmd.DO_SET_ACTUATOR,
        mav_cmd.DO_LAND_START,
        mav_cmd.DO_SET_ROI_WPNEXT_OFFSET,
        mav_cmd.DO_SET_ROI_NONE,
        mav_cmd.DO_CONTROL_VIDEO,
        mav_cmd.DO_SET_ROI,
        mav_cmd.DO_DIGICAM_CONTROL,
        mav_cmd.DO_MOUNT_CONFIGURE,
        mav_cmd.DO_MOUNT_CONTROL,
        mav_cmd.DO_SET_CAM_TRIGG_DIST,
        mav_cmd.DO_GRIPPER,
        mav_cmd.DO_SET_CAM_TRIGG_INTERVAL,
        mav_cmd.OBLIQUE_SURVEY,
        mav_cmd.SET_CAMERA_MODE,
        mav_cmd.SET_CAMERA_FOCUS,
    }
    | {
        mav_cmd.SET_CAMERA_SOURCE,
        mav_cmd.DO_GIMBAL_MANAGER_PITCHYAW,
        mav_cmd.DO_GIMBAL_MANAGER_CONFIGURE,
        mav_cmd.IMAGE_START_CAPTURE,
        mav_cmd.IMAGE_STOP_CAPTURE,
        mav_cmd.DO_TRIGGER_CONTROL,
        mav_cmd.VIDEO_START_CAPTURE,
        mav_cmd.VIDEO_STOP_CAPTURE,
        mav_cmd.DO_VTOL_TRANSITION,
        mav_cmd.DO_WINCH,
    }
)
"""Accepted in MAV_FRAME_MISSION only."""

PX4_SINCE_1_17 = frozenset({mav_cmd.DO_AUTOTUNE_ENABLE, mav_cmd.COMPONENT_ARM_DISARM})
"""Accepted in either frame, from 1.17 on."""

PX4_NOT_FLOWN = {
    mav_cmd.CONDITION_DELAY: "use NAV_DELAY; from 1.18 on it is flown as one",
    mav_cmd.CONDITION_DISTANCE: "no version flies it",
}
"""Accepted at the upload, and then "Mission rejected: unsupported cmd"."""

PX4_VTOL = frozenset({mav_cmd.NAV_VTOL_TAKEOFF, mav_cmd.NAV_VTOL_LAND, mav_cmd.DO_VTOL_TRANSITION})
"""Commands of VTOLs; any other vehicle rejects the mission."""

PX4_NO_PLACE_YET = (PX4_PLACELESS | {mav_cmd.DO_SET_ROI_LOCATION}) - {
    mav_cmd.NAV_RETURN_TO_LAUNCH,
    mav_cmd.CONDITION_DELAY,
    mav_cmd.CONDITION_DISTANCE,
    mav_cmd.DO_SET_ACTUATOR,
    mav_cmd.DO_GRIPPER,
    mav_cmd.DO_WINCH,
}
"""The only items allowed before a takeoff; else it is "not first waypoint item" and the mission is rejected."""

PX4_NUMBERS = frozenset(
    {
        mav_cmd.DO_SET_ACTUATOR,
        mav_cmd.DO_SET_ROI_WPNEXT_OFFSET,
        mav_cmd.DO_DIGICAM_CONTROL,
        mav_cmd.DO_MOUNT_CONFIGURE,
        mav_cmd.DO_MOUNT_CONTROL,
        mav_cmd.OBLIQUE_SURVEY,
        mav_cmd.DO_GIMBAL_MANAGER_PITCHYAW,
        mav_cmd.DO_GIMBAL_MANAGER_CONFIGURE,
    }
)
"""Commands without a position whose param5 to param7 PX4 reads; it ignores those of all others."""

PX4_FLOWN_PLACE = frozenset(
    {
        mav_cmd.NAV_LOITER_UNLIM,
        mav_cmd.NAV_LOITER_TIME,
        mav_cmd.NAV_LAND,
        mav_cmd.NAV_TAKEOFF,
        mav_cmd.NAV_LOITER_TO_ALT,
        mav_cmd.NAV_VTOL_TAKEOFF,
        mav_cmd.NAV_VTOL_LAND,
    }
)
"""Besides waypoints: positions to fly to, also 0, 0. (For an ArduPilot 0, 0 is its own position then.)"""

PX4_PARAMS: Mapping[int, tuple[int, ...]] = {
    mav_cmd.NAV_WAYPOINT: (1, 2, 4),
    mav_cmd.NAV_LOITER_UNLIM: (3, 4),
    mav_cmd.NAV_LOITER_TIME: (1, 2, 3, 4),
    mav_cmd.NAV_RETURN_TO_LAUNCH: (),
    mav_cmd.NAV_LAND: (1, 2, 4),
    mav_cmd.NAV_TAKEOFF: (1, 4),
    mav_cmd.NAV_LOITER_TO_ALT: (1, 2, 4),
    mav_cmd.NAV_VTOL_TAKEOFF: (4,),
    mav_cmd.NAV_VTOL_LAND: (3, 4),
    mav_cmd.NAV_DELAY: (1, 2, 3, 4),
    mav_cmd.CONDITION_DELAY: (1,),
    mav_cmd.CONDITION_DISTANCE: (1,),
    mav_cmd.DO_JUMP: (1, 2),
    mav_cmd.DO_CHANGE_SPEED: (1, 2, 3),
    mav_cmd.DO_LAND_START: (),
    mav_cmd.DO_SET_ROI_LOCATION: (),
    mav_cmd.DO_SET_ROI_WPNEXT_OFFSET: (1,),
    mav_cmd.DO_SET_ROI_NONE: (1,),
    mav_cmd.DO_SET_CAM_TRIGG_DIST: (1, 2, 3, 4),
    mav_cmd.DO_GRIPPER: (1, 2),
    mav_cmd.DO_SET_CAM_TRIGG_INTERVAL: (1, 2, 3),
    mav_cmd.SET_CAMERA_MODE: (1, 2),
    mav_cmd.SET_CAMERA_FOCUS: (1, 2, 3),
    mav_cmd.SET_CAMERA_SOURCE: (1, 2, 3),
    mav_cmd.IMAGE_START_CAPTURE: (1, 2, 3, 4),
    mav_cmd.IMAGE_STOP_CAPTURE: (1,),
    mav_cmd.DO_TRIGGER_CONTROL: (1, 2, 3, 4),
    mav_cmd.VIDEO_START_CAPTURE: (1, 2, 3),
    mav_cmd.VIDEO_STOP_CAPTURE: (1, 2),
    mav_cmd.DO_VTOL_TRANSITION: (1, 2),
    mav_cmd.CONDITION_GATE: (),
    mav_cmd.DO_WINCH: (1, 2, 3, 4),
}
"""Which of param1 to param4 a PX4 uses. 1.16 ignores the others, later versions refuse an item that has one of them."""

ARDUPILOT_TAKEN = frozenset(
    {
        mav_cmd.NAV_WAYPOINT,
        mav_cmd.NAV_LOITER_UNLIM,
        mav_cmd.NAV_LOITER_TURNS,
        mav_cmd.NAV_LOITER_TIME,
        mav_cmd.NAV_RETURN_TO_LAUNCH,
        mav_cmd.NAV_LAND,
        mav_cmd.NAV_TAKEOFF,
        mav_cmd.NAV_CONTINUE_AND_CHANGE_ALT,
        mav_cmd.NAV_LOITER_TO_ALT,
        mav_cmd.NAV_SPLINE_WAYPOINT,
        mav_cmd.NAV_ALTITUDE_WAIT,
        mav_cmd.NAV_VTOL_TAKEOFF,
        mav_cmd.NAV_VTOL_LAND,
        mav_cmd.NAV_GUIDED_ENABLE,
        mav_cmd.NAV_DELAY,
        mav_cmd.NAV_PAYLOAD_PLACE,
        mav_cmd.CONDITION_DELAY,
        mav_cmd.CONDITION_DISTANCE,
        mav_cmd.CONDITION_YAW,
        mav_cmd.DO_JUMP,
        mav_cmd.DO_CHANGE_SPEED,
        mav_cmd.DO_SET_HOME,
        mav_cmd.DO_SET_RELAY,
        mav_cmd.DO_REPEAT_RELAY,
        mav_cmd.DO_SET_SERVO,
        mav_cmd.DO_REPEAT_SERVO,
    }
    | {
        mav_cmd.DO_RETURN_PATH_START,
        mav_cmd.DO_LAND_START,
        mav_cmd.DO_GO_AROUND,
        mav_cmd.DO_PAUSE_CONTINUE,
        mav_cmd.DO_SET_REVERSE,
        mav_cmd.DO_SET_ROI_LOCATION,
        mav_cmd.DO_SET_ROI_NONE,
        mav_cmd.DO_SET_ROI,
        mav_cmd.DO_DIGICAM_CONFIGURE,
        mav_cmd.DO_DIGICAM_CONTROL,
        mav_cmd.DO_MOUNT_CONTROL,
        mav_cmd.DO_SET_CAM_TRIGG_DIST,
        mav_cmd.DO_FENCE_ENABLE,
        mav_cmd.DO_PARACHUTE,
        mav_cmd.DO_INVERTED_FLIGHT,
        mav_cmd.DO_GRIPPER,
        mav_cmd.DO_AUTOTUNE_ENABLE,
        mav_cmd.NAV_SET_YAW_SPEED,
        mav_cmd.DO_SET_RESUME_REPEAT_DIST,
        mav_cmd.DO_SPRAYER,
        mav_cmd.DO_SEND_SCRIPT_MESSAGE,
        mav_cmd.DO_AUX_FUNCTION,
    }
    | {
        mav_cmd.DO_GUIDED_LIMITS,
        mav_cmd.DO_ENGINE_CONTROL,
        mav_cmd.SET_CAMERA_ZOOM,
        mav_cmd.SET_CAMERA_FOCUS,
        mav_cmd.SET_CAMERA_SOURCE,
        mav_cmd.JUMP_TAG,
        mav_cmd.DO_JUMP_TAG,
        mav_cmd.DO_GIMBAL_MANAGER_PITCHYAW,
        mav_cmd.IMAGE_START_CAPTURE,
        mav_cmd.IMAGE_STOP_CAPTURE,
        mav_cmd.VIDEO_START_CAPTURE,
        mav_cmd.VIDEO_STOP_CAPTURE,
        mav_cmd.DO_VTOL_TRANSITION,
        mav_cmd.DO_WINCH,
        mav_cmd.NAV_SCRIPT_TIME,
        mav_cmd.NAV_ATTITUDE_TIME,
    }
)
"""Accepted in any frame if the command has no position. 195 and 197 since 4.6: `convert` replaces them by 201."""

ARDUPILOT_PLACED = frozenset(
    {
        mav_cmd.NAV_WAYPOINT,
        mav_cmd.NAV_LOITER_UNLIM,
        mav_cmd.NAV_LOITER_TURNS,
        mav_cmd.NAV_LOITER_TIME,
        mav_cmd.NAV_LAND,
        mav_cmd.NAV_TAKEOFF,
        mav_cmd.NAV_CONTINUE_AND_CHANGE_ALT,
        mav_cmd.NAV_LOITER_TO_ALT,
        mav_cmd.NAV_SPLINE_WAYPOINT,
        mav_cmd.NAV_VTOL_TAKEOFF,
        mav_cmd.NAV_VTOL_LAND,
        mav_cmd.NAV_GUIDED_ENABLE,
        mav_cmd.NAV_PAYLOAD_PLACE,
        mav_cmd.DO_SET_HOME,
        mav_cmd.DO_RETURN_PATH_START,
        mav_cmd.DO_LAND_START,
        mav_cmd.DO_GO_AROUND,
        mav_cmd.DO_SET_ROI_LOCATION,
        mav_cmd.DO_SET_ROI,
    }
)
"""`stored_in_location`: latitude, longitude and altitude must be valid, and the frame one that has them, or MISSION."""

ARDUPILOT_HERE = ARDUPILOT_PLACED - {
    mav_cmd.NAV_WAYPOINT,
    mav_cmd.NAV_SPLINE_WAYPOINT,
    mav_cmd.NAV_PAYLOAD_PLACE,
    mav_cmd.DO_SET_ROI_LOCATION,
    mav_cmd.DO_SET_ROI,
}
"""Commands for which 0, 0 means the vehicle's position then, or nothing."""

ARDUPILOT_ANY_HEIGHT = frozenset(
    {
        mav_cmd.NAV_LAND,
        mav_cmd.NAV_VTOL_LAND,
        mav_cmd.NAV_GUIDED_ENABLE,
        mav_cmd.DO_SET_HOME,
        mav_cmd.DO_RETURN_PATH_START,
        mav_cmd.DO_LAND_START,
        mav_cmd.DO_GO_AROUND,
    }
)
"""Commands that do not use the altitude, so that 0 may be sent if it is not set."""

COPTER_SKIPS = frozenset(
    {
        mav_cmd.NAV_CONTINUE_AND_CHANGE_ALT,
        mav_cmd.NAV_ALTITUDE_WAIT,
        mav_cmd.DO_GO_AROUND,
        mav_cmd.DO_PAUSE_CONTINUE,
        mav_cmd.DO_SET_REVERSE,
        mav_cmd.DO_INVERTED_FLIGHT,
        mav_cmd.DO_AUTOTUNE_ENABLE,
        mav_cmd.NAV_SET_YAW_SPEED,
        mav_cmd.DO_ENGINE_CONTROL,
        mav_cmd.DO_VTOL_TRANSITION,
    }
)
"""Accepted, because planes or rovers use them; an ArduCopter skips them."""

ARDUPILOT_NUMBERS = frozenset(
    {
        mav_cmd.DO_DIGICAM_CONFIGURE,
        mav_cmd.DO_DIGICAM_CONTROL,
        mav_cmd.DO_GIMBAL_MANAGER_PITCHYAW,
        mav_cmd.NAV_SCRIPT_TIME,
        mav_cmd.NAV_ATTITUDE_TIME,
    }
)
"""Commands without a position of which an ArduPilot keeps param5 to param7, or some of them."""

ARDUPILOT_ALTERS: Mapping[int, str] = {
    mav_cmd.NAV_WAYPOINT: "iww-",
    mav_cmd.NAV_LOITER_UNLIM: "--i-",
    mav_cmd.NAV_LOITER_TURNS: "t-rb",
    mav_cmd.NAV_LOITER_TIME: "i-sb",
    mav_cmd.NAV_RETURN_TO_LAUNCH: "----",
    mav_cmd.NAV_LAND: "i--s",
    mav_cmd.NAV_TAKEOFF: "i---",
    mav_cmd.NAV_CONTINUE_AND_CHANGE_ALT: "i---",
    mav_cmd.NAV_LOITER_TO_ALT: "-i-b",
    mav_cmd.NAV_SPLINE_WAYPOINT: "i---",
    mav_cmd.NAV_VTOL_TAKEOFF: "----",
    mav_cmd.NAV_VTOL_LAND: "i---",
    mav_cmd.DO_CHANGE_SPEED: "i==-",
    mav_cmd.DO_SET_HOME: "i---",
    mav_cmd.DO_RETURN_PATH_START: "----",
    mav_cmd.DO_LAND_START: "----",
    mav_cmd.DO_GO_AROUND: "----",
    mav_cmd.DO_SET_ROI: "i---",
    mav_cmd.DO_MOUNT_CONTROL: "===-",
    mav_cmd.DO_SET_CAM_TRIGG_DIST: "=-i-",
    mav_cmd.DO_VTOL_TRANSITION: "i---",
    mav_cmd.VIDEO_START_CAPTURE: "i---",
    mav_cmd.VIDEO_STOP_CAPTURE: "i---",
}
"""Report of param1 to param4 by an ArduPilot, where it may differ from what was sent; see `_ALTERED`. Any parameter of
another command, except of fences and rally points, may be dropped or rounded ("~"). An ArduPlane keeps other parameters
of a waypoint than a copter, as bytes; each drops those of the other."""

PX4_ALTERS: Mapping[int, str] = {
    mav_cmd.NAV_WAYPOINT: "==-y",
    mav_cmd.NAV_LOITER_UNLIM: "--=y",
    mav_cmd.NAV_LOITER_TIME: "=b=b",
    mav_cmd.NAV_LAND: "-i-y",
    mav_cmd.NAV_TAKEOFF: "---y",
    mav_cmd.NAV_LOITER_TO_ALT: "b=-b",
    mav_cmd.NAV_ROI: "----",
    mav_cmd.NAV_VTOL_TAKEOFF: "---y",
    mav_cmd.NAV_VTOL_LAND: "---y",
    mav_cmd.DO_SET_ROI_LOCATION: "----",
    mav_cmd.DO_SET_ROI: "----",
    mav_cmd.CONDITION_GATE: "----",
}
"""The same of a PX4, for items with a position; it keeps the parameters of the others as they are, but for jumps."""

PX4_RENAMES: Mapping[int, int] = {mav_cmd.NAV_ROI: mav_cmd.DO_SET_ROI}
"""Commands that a PX4 reports by another number."""

ROUNDED = 1e-3
"""Relative error that "~" allows: twice that of a half-precision float."""

_ALTERED: Mapping[str, Callable[[float], float]] = {
    "-": lambda value: 0.0,
    "i": lambda value: float(int(value)),
    "b": lambda value: float(value > 0),
    "s": lambda value: -1.0 if value < 0 else 1.0,
    "t": lambda value: int(256 * value) / 256 if 0 < value < 1 else min(255.0, float(int(value))),
    "r": lambda value: float(int(value)) if abs(value) <= 255 else 10.0 * max(-255, min(255, int(value / 10))),
}
"""Forms of a parameter: dropped, whole, yes or no, direction, turns (a byte), radius (a byte). Besides: "=" as it was
sent, "y" a heading, in degrees from 0 to 360, "j" 16 bits, "w" dropped, or whole, and then perhaps a byte, "~" also
rounded."""

HEADING_GRID_DEG = 0.01
"""A PX4 keeps headings in radians."""

ALTITUDE_GRID_M = 0.011
"""An ArduPilot keeps altitudes in centimetres, and those of rally points in whole metres."""

ARDUPILOT_FRAMES = frozenset({GLOBAL, RELATIVE_ALT, TERRAIN_ALT, MISSION_FRAME})
MAX_ALTITUDE_M = 83000.0
"""LOCATION_ALT_MAX_M."""


@dataclass(frozen=True, slots=True)
class ItemChange:
    """The change to one item of the plan; ``item``: its number, from 1."""

    item: int
    text: str


@dataclass(frozen=True, slots=True)
class Converted:
    """A mission in the form a firmware accepts, and the changes to report to the user."""

    items: tuple[MissionItem, ...]
    changes: tuple[ItemChange, ...] = ()


def for_firmware(items: tuple[MissionItem, ...], family: Family | None, names: Mapping[int, str]) -> Converted:
    """The mission in this firmware's form, jumps included. ``family`` None: unchanged. ``names``: MAV_CMD names."""
    if family is None:
        return Converted(items)
    kept: list[MissionItem] = []
    changes: list[ItemChange] = []
    numbers: list[int] = []
    """Number in ``kept`` of each item of the plan; an omitted item has the number of the next one."""
    for number, item in enumerate(items, 1):
        numbers.append(len(kept) + 1)
        converted, texts = convert(item, family, names)
        changes += [ItemChange(number, text) for text in texts]
        if converted is not None:
            kept.append(converted)
    if len(kept) < len(items):
        kept = [_renumbered(item, numbers) for item in kept]
    return Converted(tuple(kept), tuple(changes))


def grouped(changes: tuple[ItemChange, ...]) -> list[str]:
    """The changes as lines, items with the same change in one line."""
    items: dict[str, list[int]] = {}
    for change in changes:
        items.setdefault(change.text, []).append(change.item)
    return [f"item{'s' if len(at) > 1 else ''} {enumerated(at, 8)}: {text}" for text, at in items.items()]


def convert(item: MissionItem, family: Family, names: Mapping[int, str]) -> tuple[MissionItem | None, list[str]]:
    """(the item in this firmware's form, the change). None: it is omitted. An item that cannot be converted stays
    unchanged, and `refusals` names it."""
    return _for_px4(item, names) if family == "px4" else _for_ardupilot(item, names)


def refusals(item: MissionItem, family: Family, names: Mapping[int, str]) -> Iterator[tuple[bool, str]]:
    """Reasons why this firmware refuses (True) or skips (False) a converted item."""
    return _px4_refusals(item, names) if family == "px4" else _ardupilot_refusals(item, names)


def same_item(sent: MissionItem, kept: MissionItem, family: Family | None) -> bool:
    """True if the item ``kept``, which the vehicle reports, is the one that was sent, as this firmware keeps it."""
    command = PX4_RENAMES.get(sent.command, sent.command) if family == "px4" else sent.command
    if kept.command not in (sent.command, command):
        return False
    fence = command in FENCE_COMMANDS
    alters, same_place = "====", _same_place(sent, kept)
    params: Sequence[Sequence[float | None]] = (sent.params, kept.params)
    if family == "px4":
        if sent.frame != MISSION_FRAME:
            alters = PX4_ALTERS.get(sent.command, alters)
        elif command == mav_cmd.DO_JUMP:
            alters = "=j=="
        if fence:  # it forgets which altitude that is
            same_place = same_place or _same_place(replace(sent, frame=GLOBAL), kept)
        if not fence and sent.autocontinue != kept.autocontinue:
            return False
    else:
        if not fence and command != mav_cmd.NAV_RALLY_POINT:
            alters = ARDUPILOT_ALTERS.get(command, "~~~~") if family == "ardupilot" else "~~~~"
        same_place = _same_place_of_ardupilot(sent, kept) if family == "ardupilot" else same_place
        params = [[value or 0.0 for value in item.params] for item in (sent, kept)]
    return same_place and all(map(_same_param, alters, *params))


def same_start(sent: tuple[MissionItem, ...], kept: tuple[MissionItem, ...], family: Family | None) -> int:
    """Number of equal items from the first on; see `same_item`."""
    pairs = enumerate(zip(sent, kept, strict=False))
    return next((n for n, (a, b) in pairs if not same_item(a, b, family)), min(len(sent), len(kept)))


def _same_param(alters: str, sent: float | None, kept: float | None) -> bool:
    if sent == kept:
        return True
    if kept is None or alters == "=":
        return False
    if alters == "y":
        return sent is not None and abs((kept - sent + 180) % 360 - 180) <= HEADING_GRID_DEG
    value = sent or 0.0
    if alters == "j":
        return kept == value % 65536
    if alters in "w~":
        rounded = alters == "~" and abs(kept - value) <= max(ALTITUDE_GRID_M, ROUNDED * abs(value))
        return rounded or kept in (0.0, float(int(value)), min(255.0, float(int(value))))
    return kept == _ALTERED[alters](value)


def _same_place(sent: MissionItem, kept: MissionItem) -> bool:
    near = abs((sent.z or 0.0) - (kept.z or 0.0)) <= ALTITUDE_GRID_M
    return (sent.frame, sent.x, sent.y) == (kept.frame, kept.x, kept.y) and near


def _same_place_of_ardupilot(sent: MissionItem, kept: MissionItem) -> bool:
    """An ArduPilot keeps no frame of commands without a position, and no altitude of fence items."""
    if sent.command == mav_cmd.NAV_RALLY_POINT:
        return _same_place(sent, kept) or _same_place(replace(sent, z=float(int(sent.z or 0.0))), kept)
    if sent.command in FENCE_COMMANDS:
        return (sent.x, sent.y) == (kept.x, kept.y)
    if sent.command in ARDUPILOT_PLACED:
        without_frame = sent.frame == MISSION_FRAME and _same_place(replace(sent, frame=GLOBAL), kept)
        return without_frame or _same_place(sent, kept)
    numbers = replace(sent, frame=kept.frame)
    return sent.command not in ARDUPILOT_NUMBERS or any(_same_place(replace(numbers, z=z), kept) for z in (sent.z, 0.0))


def px4_order(items: tuple[MissionItem, ...]) -> Iterator[tuple[int, str]]:
    """(number, reason) of items of a converted mission whose order makes a PX4 reject it."""
    before = False
    for number, item in enumerate(items, 1):
        if item.command in (mav_cmd.NAV_TAKEOFF, mav_cmd.NAV_VTOL_TAKEOFF) and before:
            yield number, "PX4 rejects the mission: a take-off must come before all other positions and returns"
        before = before or item.command not in PX4_NO_PLACE_YET


def _for_px4(item: MissionItem, names: Mapping[int, str]) -> tuple[MissionItem, list[str]]:
    name = _name(item.command, names)
    texts = []
    if item.command == mav_cmd.DO_SET_ROI and item.params[0] == ROI_LOCATION and item.position is not None:
        item = replace(item, command=mav_cmd.DO_SET_ROI_LOCATION, params=(0.0, 0.0, 0.0, 0.0))
        texts.append(f"{name} becomes {_name(mav_cmd.DO_SET_ROI_LOCATION, names)}, whose position a PX4 reads")
    placed = item.frame in GLOBAL_FRAMES and item.command in PX4_PLACED
    if (
        item.command in PX4_PLACELESS
        and not placed
        and not (item.command == mav_cmd.DO_SET_HOME and item.params[0] != 1)
    ):
        item, dropped = _without_place(item)
        if dropped:
            texts.append(f"the position of {name}, which a PX4 does not use, is left out: it would be refused")
    used = PX4_PARAMS.get(item.command)
    unused = [n for n, value in enumerate(item.params, 1) if used is not None and n not in used and value]
    if unused:
        p1, p2, p3, p4 = (0.0 if n in unused else value for n, value in enumerate(item.params, 1))
        item = replace(item, params=(p1, p2, p3, p4))
        texts.append(f"{_params(unused)} of {name}, which a PX4 does not use, is left out: 1.18 would refuse it")
    return item, texts


def _without_place(item: MissionItem) -> tuple[MissionItem, bool]:
    """A command without a position, in the frame in which a PX4 accepts it, and whether a position was removed.
    Fractions in param5 and param6 cannot be sent in that frame: such an item stays unchanged."""
    x, y, z = item.seven[4:]
    if item.command not in PX4_NUMBERS:
        return replace(item, frame=MISSION_FRAME, x=0, y=0, z=0.0 if z else item.z), bool(x or y or z)
    if any(value is not None and value != int(value) for value in (x, y)):
        return item, False
    return MissionItem.from_params(item.command, MISSION_FRAME, item.seven, item.autocontinue), False


def _px4_refusals(item: MissionItem, names: Mapping[int, str]) -> Iterator[tuple[bool, str]]:
    # whether it knows the command at all
    command, name = item.command, _name(item.command, names)
    if command in PX4_SINCE_1_17:
        yield True, f"PX4 takes {name} from 1.17 on only; for such a version insist with --force"
    elif command not in PX4_PLACED | PX4_PLACELESS:
        yield True, f"PX4 takes no {name} in a mission"
        return
    # frames
    if item.frame == TERRAIN_ALT or item.frame not in GLOBAL_FRAMES | {MISSION_FRAME}:
        yield True, f"PX4 takes no item in frame {item.frame}, only in 0 (AMSL), 3 (above home) and 2 (no position)"
    elif item.frame == MISSION_FRAME and command in PX4_PLACED - PX4_PLACELESS:
        yield True, f"PX4 takes {name} with a position only: frame 0 or 3, not 2"
    elif item.frame != MISSION_FRAME and command in PX4_NUMBERS:
        yield True, f"PX4 takes {name} with whole numbers in param5 and param6 only"
    # parameters
    if command == mav_cmd.DO_SET_HOME and item.params[0] != 1:
        yield True, f"PX4 takes {name} in a mission with param1 = 1 (its position then) only"
    if command in (80, mav_cmd.DO_SET_ROI):
        allowed = (ROI_NONE, 1, 2) if item.frame == MISSION_FRAME else (ROI_NONE, ROI_LOCATION)
        if item.params[0] not in allowed:
            yield True, f"PX4 takes {name} in frame {item.frame} with param1 {' or '.join(map(str, allowed))} only"
        elif item.params[0] == ROI_NONE and item.position is not None:
            yield False, f"PX4 reads param1 = 0 of {name} as: no region of interest; 3 means the position"
    if command in PX4_NOT_FLOWN:
        yield True, f"PX4 takes {name} and then rejects the mission: {PX4_NOT_FLOWN[command]}"
    # what is taken and then not flown as written
    if command in PX4_VTOL:
        yield False, f"PX4 rejects a mission with {name} unless the vehicle is a VTOL"
    if command in PX4_FLOWN_PLACE and item.frame in GLOBAL_FRAMES and item.position is None:
        zero = (item.x, item.y) == (0, 0)
        yield True, "has no position" + (" (0, 0): a PX4 flies there" if zero else "")


def _for_ardupilot(item: MissionItem, names: Mapping[int, str]) -> tuple[MissionItem | None, list[str]]:
    name = _name(item.command, names)
    if item.command == mav_cmd.SET_CAMERA_MODE:
        text = "which an ArduPilot does not take, is left out: the following items have lower numbers on the vehicle"
        return None, [f"{name}, {text}"]
    if item.command == mav_cmd.DO_SET_ROI_LOCATION and item.frame in GLOBAL_FRAMES:
        text = f"{name} becomes {_name(mav_cmd.DO_SET_ROI, names)}: the same, and every ArduPilot takes it"
        return replace(item, command=mav_cmd.DO_SET_ROI, params=(float(ROI_LOCATION), 0.0, 0.0, 0.0)), [text]
    if item.command == mav_cmd.DO_SET_ROI_NONE:
        text = f"{name} becomes {_name(mav_cmd.DO_SET_ROI, names)} without a position: every ArduPilot takes it"
        return MissionItem(mav_cmd.DO_SET_ROI, GLOBAL, autocontinue=item.autocontinue), [text]
    if item.command in ARDUPILOT_HERE and UNSET_INT in (item.x, item.y):
        item = replace(item, x=0, y=0)
    if item.command in ARDUPILOT_ANY_HEIGHT and item.z is None:
        item = replace(item, z=0.0)
    return item, []


def _ardupilot_refusals(item: MissionItem, names: Mapping[int, str]) -> Iterator[tuple[bool, str]]:
    name = _name(item.command, names)
    if item.command not in ARDUPILOT_TAKEN:
        yield True, f"ArduPilot takes no {name} in a mission"
        return
    if item.command in COPTER_SKIPS:
        yield False, f"an ArduCopter takes {name} and skips it"
    if item.command not in ARDUPILOT_PLACED:
        return
    if item.frame not in ARDUPILOT_FRAMES:
        yield True, f"ArduPilot takes {name} in frames 0 (AMSL), 3 (above home) and 10 (above terrain) only"
    elif item.frame == MISSION_FRAME and item.command in ARDUPILOT_PLACED - ARDUPILOT_ANY_HEIGHT - {
        mav_cmd.DO_SET_ROI,
        16,
        82,
    }:
        yield True, f"ArduPilot reads the altitude of {name} in frame 2 as AMSL, and no position"
    elif UNSET_INT in (item.x, item.y) and item.command not in (16, 82):  # reported for waypoints in any case
        yield True, f"ArduPilot takes no {name} without a position"
    if item.z is not None and abs(item.z) >= MAX_ALTITUDE_M:
        yield True, f"ArduPilot takes no altitude of {item.z:g} m"
    elif item.z is None and item.command in (mav_cmd.DO_SET_ROI, 30, 31):
        yield True, f"ArduPilot takes no {name} whose altitude is not set"


def _renumbered(item: MissionItem, numbers: list[int]) -> MissionItem:
    target = item.params[0]
    if item.command != mav_cmd.DO_JUMP or target is None or not target.is_integer() or not 1 <= target <= len(numbers):
        return item
    return replace(item, params=(float(numbers[int(target) - 1]), *item.params[1:]))


def _name(command: int, names: Mapping[int, str]) -> str:
    """A command's name as editors of plans show it."""
    return names.get(command, f"command {command}").removeprefix("MAV_CMD_")


def _params(numbers: list[int]) -> str:
    return " and ".join(f"param{n}" for n in numbers)
