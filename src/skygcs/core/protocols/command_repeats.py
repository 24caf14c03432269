"""Which commands may be repeated, and over which link: a table with the reason for each.

An order goes over the chosen link. When its answer does not come, either the order or the answer was lost, and the
sender cannot know which. A repeat is harmless where doing it twice leaves what doing it once leaves. Elsewhere it is
sent only once the vehicle's state, newer than the last transmission, shows that it was not done, or never. Autopilots
do not recognise a repeat: neither PX4 1.16 nor ArduPilot 4.6 looks at COMMAND_LONG.confirmation.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, auto
from typing import NamedTuple

from skygcs.core.mavlink import mav_cmd
from skygcs.core.protocols.command import CommandSpec


class Repeat(Enum):
    """Choices when no answer came."""

    ANY_LINK = auto()
    """Harmless: repeated over every link that leads to the vehicle."""
    SAME_LINK = auto()
    """It concerns the link it came over, or what it does is not known: repeated while that is the chosen link."""
    IF_NOT_DONE = auto()
    """Repeated over every link, once the vehicle's state shows that it was not done."""
    NEVER = auto()
    """Sent once."""


class RepeatRule(NamedTuple):
    """``reason``: why, as the end of "... because". ``shows_after_s``: a heartbeat that came so long after the command
    reached the vehicle shows whether it was done."""

    repeat: Repeat
    reason: str
    shows_after_s: float = 0.0


SHOWS_AFTER_S = 0.5
"""Mode and armed state change within some tenths of a second. A vehicle that restarts is silent by then."""

LIFTS_OFF_AFTER_S = 3.0
"""A copter's motors spin up for one or two seconds before it lifts off."""

ITEM_SHOWS_AFTER_S = 5.0
"""MISSION_CURRENT comes at 0.2 to 1 Hz."""


def _any(reason: str, *commands: int) -> dict[int, RepeatRule]:
    return dict.fromkeys(commands, RepeatRule(Repeat.ANY_LINK, reason))


def _never(reason: str, *commands: int) -> dict[int, RepeatRule]:
    return dict.fromkeys(commands, RepeatRule(Repeat.NEVER, reason))


def _if_not_done(reason: str, *commands: int, shows_after_s: float = SHOWS_AFTER_S) -> dict[int, RepeatRule]:
    return dict.fromkeys(commands, RepeatRule(Repeat.IF_NOT_DONE, reason, shows_after_s))


def _same(reason: str, *commands: int) -> dict[int, RepeatRule]:
    return dict.fromkeys(commands, RepeatRule(Repeat.SAME_LINK, reason))


COMMANDS: Mapping[int, RepeatRule] = {
    # flight
    **_any(
        "the vehicle is in that mode already, and a newer order ends the repeats",
        mav_cmd.DO_SET_MODE,
        mav_cmd.NAV_RETURN_TO_LAUNCH,
        mav_cmd.NAV_LAND,
        mav_cmd.NAV_LAND_LOCAL,
        mav_cmd.NAV_VTOL_LAND,
        mav_cmd.NAV_LOITER_UNLIM,
        mav_cmd.NAV_GUIDED_ENABLE,
        mav_cmd.DO_PAUSE_CONTINUE,
        mav_cmd.OVERRIDE_GOTO,
        mav_cmd.DO_VTOL_TRANSITION,
    ),
    **_any("it is the same place", mav_cmd.DO_REPOSITION),
    **_any(
        "it is the same value",
        mav_cmd.DO_CHANGE_SPEED,
        mav_cmd.DO_CHANGE_ALTITUDE,
        mav_cmd.CONDITION_YAW,
        mav_cmd.GUIDED_CHANGE_SPEED,
        mav_cmd.GUIDED_CHANGE_ALTITUDE,
        mav_cmd.GUIDED_CHANGE_HEADING,
        mav_cmd.DO_GUIDED_LIMITS,
        mav_cmd.EXTERNAL_POSITION_ESTIMATE,
        mav_cmd.DO_SET_HOME,
    ),
    **_if_not_done(
        "a second one would climb again from the height reached by then",
        mav_cmd.NAV_TAKEOFF,
        mav_cmd.NAV_TAKEOFF_LOCAL,
        mav_cmd.NAV_VTOL_TAKEOFF,
        shows_after_s=LIFTS_OFF_AFTER_S,
    ),
    **_if_not_done("a second one would begin the mission again at its first item", mav_cmd.MISSION_START),
    **_if_not_done(
        "an item that was flown meanwhile would be flown again",
        mav_cmd.DO_SET_MISSION_CURRENT,
        shows_after_s=ITEM_SHOWS_AFTER_S,
    ),
    **_if_not_done("a vehicle that was disarmed meanwhile would be armed again", mav_cmd.COMPONENT_ARM_DISARM),
    **_if_not_done("a second one would restart it again as soon as it is up", mav_cmd.PREFLIGHT_REBOOT_SHUTDOWN),
    **_never("it would jump again", mav_cmd.DO_JUMP, mav_cmd.DO_JUMP_TAG),
    **_never("it would climb again", mav_cmd.DO_GO_AROUND),
    # safety: late is better than never
    **_any("there is nothing left to stop", mav_cmd.DO_FLIGHTTERMINATION, mav_cmd.DO_PARACHUTE),
    **_any("the fence is on, or off, already", mav_cmd.DO_FENCE_ENABLE),
    # payload
    **_any(
        "it is the same position, rate or state",
        mav_cmd.DO_SET_RELAY,
        mav_cmd.DO_SET_SERVO,
        mav_cmd.DO_SET_ACTUATOR,
        mav_cmd.DO_GRIPPER,
        mav_cmd.DO_SPRAYER,
        mav_cmd.DO_AUX_FUNCTION,
        mav_cmd.DO_ENGINE_CONTROL,
        mav_cmd.DO_MOUNT_CONFIGURE,
        mav_cmd.DO_MOUNT_CONTROL,
        mav_cmd.DO_GIMBAL_MANAGER_PITCHYAW,
        mav_cmd.DO_GIMBAL_MANAGER_CONFIGURE,
        mav_cmd.DO_SET_ROI,
        mav_cmd.DO_SET_ROI_LOCATION,
        mav_cmd.DO_SET_ROI_WPNEXT_OFFSET,
        mav_cmd.DO_SET_ROI_NONE,
        mav_cmd.DO_SET_CAM_TRIGG_DIST,
        mav_cmd.DO_SET_CAM_TRIGG_INTERVAL,
        mav_cmd.DO_TRIGGER_CONTROL,
        mav_cmd.SET_CAMERA_MODE,
        mav_cmd.SET_CAMERA_SOURCE,
        mav_cmd.IMAGE_STOP_CAPTURE,
        mav_cmd.VIDEO_STOP_CAPTURE,
    ),
    **_never(
        "it would be done again",
        mav_cmd.DO_REPEAT_RELAY,
        mav_cmd.DO_REPEAT_SERVO,
        mav_cmd.DO_DIGICAM_CONTROL,
        mav_cmd.IMAGE_START_CAPTURE,
        mav_cmd.VIDEO_START_CAPTURE,
        mav_cmd.SET_CAMERA_ZOOM,
        mav_cmd.SET_CAMERA_FOCUS,
        mav_cmd.DO_WINCH,
        mav_cmd.PAYLOAD_PREPARE_DEPLOY,
        mav_cmd.DO_SEND_SCRIPT_MESSAGE,
    ),
    **_never("the motors would run again", mav_cmd.DO_MOTOR_TEST, mav_cmd.ACTUATOR_TEST),
    **_never(
        "a button would be pressed again",
        mav_cmd.SOLO_BTN_FLY_CLICK,
        mav_cmd.SOLO_BTN_FLY_HOLD,
        mav_cmd.SOLO_BTN_PAUSE_CLICK,
    ),
    # set-up
    **_never("it would begin again", mav_cmd.PREFLIGHT_CALIBRATION, mav_cmd.DO_START_MAG_CAL),
    **_never("the pose that is asked for next would count as confirmed", mav_cmd.ACCELCAL_VEHICLE_POS),
    **_any("it is cancelled already", mav_cmd.DO_CANCEL_MAG_CAL),
    **_any("the same values are stored again", mav_cmd.PREFLIGHT_STORAGE, mav_cmd.PREFLIGHT_SET_SENSOR_OFFSETS),
    # questions
    **_any("it is only answered twice", *mav_cmd.QUESTIONS),
    **_same(
        "an autopilot has rates of its own for each of its ports",
        mav_cmd.SET_MESSAGE_INTERVAL,
        mav_cmd.GET_MESSAGE_INTERVAL,
    ),
}
"""Commands by id."""

UNLISTED = RepeatRule(Repeat.SAME_LINK, "it is not known what doing it twice does; MAVLink has it repeated")
"""Any other: vendors' commands, and those of other dialects."""

DISARM = RepeatRule(Repeat.ANY_LINK, "it is disarmed already")
RELATIVE_YAW = RepeatRule(Repeat.NEVER, "it would turn again")
HOME_HERE = RepeatRule(Repeat.NEVER, "its home would be where it is by then")


def repeat_rule(spec: CommandSpec) -> RepeatRule:
    """The rule for a command with these parameters."""
    params = (*spec.params, 0.0, 0.0, 0.0, 0.0)
    if spec.command == mav_cmd.COMPONENT_ARM_DISARM and params[0] == 0.0:
        return DISARM
    if spec.command == mav_cmd.CONDITION_YAW and params[3] == 1.0:
        return RELATIVE_YAW
    if spec.command == mav_cmd.DO_SET_HOME and params[0] == 1.0:
        return HOME_HERE
    return COMMANDS.get(spec.command, UNLISTED)
