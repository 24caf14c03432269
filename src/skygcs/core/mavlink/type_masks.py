"""type_mask of the setpoint messages, made from what a message gives: the bits say what the autopilot must *ignore*.

A mask written by hand is one digit short sooner or later, and the field it forgets is then flown: latitude 0, or nine
radians a second of yaw. Here a bit is cleared by nothing but a value that is there.
POSITION_TARGET_TYPEMASK and ATTITUDE_TARGET_TYPEMASK: https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

Axes = tuple[bool, bool, bool]

ALL: Axes = (True, True, True)
NONE: Axes = (False, False, False)

YAW_IGNORE = 1 << 10
YAW_RATE_IGNORE = 1 << 11
"""Bit 9, FORCE_SET, turns accelerations into forces. No autopilot takes it, and it is never set here."""

ATTITUDE_AND_THRUST = 0b0000_0111
"""Attitude and thrust given, the three body rates ignored. ArduCopter wants all of the rates or none (it stops where it
is for a mask in between); PX4 takes roll and pitch rate, where they are not ignored, for another setpoint, of rates."""

BODY_RATES_AND_THRUST = 0b1000_0000
"""The three body rates and thrust given, the attitude ignored."""


def position_target_mask(
    *, pos: Axes = NONE, vel: Axes = NONE, acc: Axes = NONE, yaw: bool = False, yaw_rate: bool = False
) -> int:
    """type_mask of SET_POSITION_TARGET_LOCAL_NED and _GLOBAL_INT that give these fields, in the order of the wire.

    Raises ValueError for one that gives no field at all: autopilots take that for an order to stop, or for nothing.
    """
    given = (*pos, *vel, *acc)
    if not any(given):
        raise ValueError("a position target gives at least one of position, velocity and acceleration")
    mask = sum(1 << bit for bit, is_given in enumerate(given) if not is_given)
    return mask | (0 if yaw else YAW_IGNORE) | (0 if yaw_rate else YAW_RATE_IGNORE)
