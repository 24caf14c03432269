"""The flight modes of PX4 and ArduCopter: their numbers, and what each needs and allows.

The places in the firmwares' sources that the rules were read from stand beside them in `skygcs.sim.behaviours`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final


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


def px4_mode(main: int, sub: int = 0) -> int:
    """custom_mode of a main and a sub mode."""
    return main << 16 | sub << 24


class Px4Mode(IntEnum):
    """HEARTBEAT.custom_mode (src/modules/commander/px4_custom_mode.h)."""

    MANUAL = px4_mode(1)
    ALTCTL = px4_mode(2)
    POSCTL = px4_mode(3)
    ORBIT = px4_mode(3, 1)
    POSCTL_SLOW = px4_mode(3, 2)
    TAKEOFF = px4_mode(4, 2)
    LOITER = px4_mode(4, 3)
    MISSION = px4_mode(4, 4)
    RTL = px4_mode(4, 5)
    LAND = px4_mode(4, 6)
    FOLLOW_TARGET = px4_mode(4, 8)
    PRECLAND = px4_mode(4, 9)
    ACRO = px4_mode(5)
    OFFBOARD = px4_mode(6)
    STABILIZED = px4_mode(7)


@dataclass(frozen=True, slots=True)
class ModeRule:
    """One mode: what it needs, and what may be done in it."""

    number: int
    arms: bool = True
    """A ground station may arm in it."""
    position: bool = False
    """Needs a position estimate: with the motors on it is not entered without, and nothing arms in it."""
    sticks: bool = False
    """Needs manual control, which no simulated vehicle has."""
    autopilot: bool = False
    """ArduCopter's is_autopilot(): a lost ground station means something in it, whatever FS_OPTIONS says."""
    guided: bool = False
    """HEARTBEAT.base_mode has MAV_MODE_FLAG_GUIDED_ENABLED (and PX4's AUTO_ENABLED)."""
    lands: bool = False
    """is_landing(), or PX4's modes in which a lost ground station is ignored."""
    by_command: bool = True
    """DO_SET_MODE enters it while disarmed."""


def _copter(mode: CopterMode, words: str) -> ModeRule:
    return ModeRule(
        mode,
        arms="arms" in words,
        position="position" in words,
        autopilot="autopilot" in words,
        guided="guided" in words,
        lands="lands" in words,
        by_command="never" not in words,
    )


def _px4(mode: Px4Mode, words: str) -> ModeRule:
    return ModeRule(
        mode,
        arms="arms" in words,
        position="position" in words,
        sticks="sticks" in words,
        guided=mode >> 16 & 0xFF == Px4Mode.LOITER >> 16 & 0xFF,
        lands="lands" in words,
        by_command="never" not in words,
    )


COPTER_RULES: Final = {
    rule.number: rule
    for rule in (
        _copter(CopterMode.STABILIZE, "arms"),
        _copter(CopterMode.ACRO, "arms"),
        _copter(CopterMode.ALT_HOLD, "arms"),
        _copter(CopterMode.AUTO, "position autopilot guided"),
        _copter(CopterMode.GUIDED, "arms position autopilot guided"),
        _copter(CopterMode.LOITER, "arms position guided"),
        _copter(CopterMode.RTL, "position autopilot guided"),
        _copter(CopterMode.CIRCLE, "position autopilot guided"),
        _copter(CopterMode.LAND, "autopilot guided lands"),
        _copter(CopterMode.DRIFT, "arms position"),
        _copter(CopterMode.SPORT, "arms never"),
        _copter(CopterMode.FLIP, "never"),
        _copter(CopterMode.AUTOTUNE, "never"),
        _copter(CopterMode.POSHOLD, "arms position guided"),
        _copter(CopterMode.BRAKE, "position guided"),
        _copter(CopterMode.THROW, "arms position"),
        _copter(CopterMode.AVOID_ADSB, "position autopilot"),
        _copter(CopterMode.GUIDED_NOGPS, "arms autopilot"),
        _copter(CopterMode.SMART_RTL, "position autopilot guided"),
        _copter(CopterMode.FLOWHOLD, "arms never"),
        _copter(CopterMode.FOLLOW, "position autopilot guided never"),
        _copter(CopterMode.ZIGZAG, "arms position autopilot"),
        _copter(CopterMode.SYSTEMID, "never"),
        _copter(CopterMode.AUTOROTATE, "autopilot never"),
        _copter(CopterMode.AUTO_RTL, "position autopilot never"),
        _copter(CopterMode.TURTLE, "arms never"),
    )
}

PX4_RULES: Final = {
    rule.number: rule
    for rule in (
        _px4(Px4Mode.MANUAL, "sticks"),
        _px4(Px4Mode.ALTCTL, "sticks"),
        _px4(Px4Mode.POSCTL, "sticks position"),
        _px4(Px4Mode.POSCTL_SLOW, "sticks position"),
        _px4(Px4Mode.ORBIT, "position never"),
        _px4(Px4Mode.TAKEOFF, "arms position"),
        _px4(Px4Mode.LOITER, "arms position"),
        _px4(Px4Mode.MISSION, "arms position"),
        _px4(Px4Mode.RTL, "position"),
        _px4(Px4Mode.LAND, "lands"),
        _px4(Px4Mode.FOLLOW_TARGET, "position"),
        _px4(Px4Mode.PRECLAND, "position lands"),
        _px4(Px4Mode.ACRO, "sticks"),
        _px4(Px4Mode.OFFBOARD, "arms"),
        _px4(Px4Mode.STABILIZED, "sticks"),
    )
}
