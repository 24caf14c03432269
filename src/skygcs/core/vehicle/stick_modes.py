"""Modes that are flown by a pilot's sticks, and what becomes of a flying vehicle in them without any. Pure.

    without sticks   modes of ArduCopter                           what it does in the air
    --------------   -------------------------------------------   --------------------------------------------------
    falls            STABILIZE, ACRO, DRIFT, TURTLE, FLIP, THROW,  the throttle stick is the throttle: motors at idle
                     SYSTEMID, AUTOROTATE, RATE_ACRO               (Mode::get_pilot_desired_throttle)
    drifts           ALT_HOLD, SPORT, GUIDED_NOGPS, FLOWHOLD,      level, with the wind; a transmitter with the
                     AUTOTUNE                                      throttle down sinks at PILOT_SPD_DN
    stays            LOITER, POSHOLD, ZIGZAG, POSITION, OF_LOITER  stays, until a transmitter with the throttle down
                                                                   sinks at PILOT_SPD_DN

What "without sticks" means to ArduCopter 4.6 and 4.7: while no receiver was ever seen, or in the radio failsafe, the
climb rate is 0 (Copter::get_pilot_desired_climb_rate), but the throttle of STABILIZE is that
of an input that never came: 0. A transmitter that lies on the table with the throttle down is input, and sinks; so does
SITL's simulated one. In none of these modes its failsafe for a lost ground station acts while FS_OPTIONS has bit 4.
PX4 enters a mode for sticks without manual control only as the failsafe of lost setpoints (COM_OBL_RC_ACT), and sinks.

A mode that falls is refused in the air where sticks are known to be absent or down, whoever insists: that is a kill,
which has a confirmation of its own. The others need force. On the ground, or disarmed, each mode may be set.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple

from skygcs.core.mavlink import modes
from skygcs.core.mavlink.vehicle_class import VehicleClass, abilities_of, class_type
from skygcs.core.vehicle.flight_evidence import is_being_armed
from skygcs.core.vehicle.order_plan import FORCE_HINT
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import SEEN_AT_ALL, Sticks, VehicleModel, model_of


class Without(StrEnum):
    """Behaviour of a flying vehicle in a mode that needs sticks, when there are none."""

    FALLS = "its motors would idle or stop, and it would fall"
    GLIDES = "it would glide down with neutral controls"
    SINKS = "it would sink"
    DRIFTS = "it would drift with the wind, and no failsafe for a lost ground station would bring it back"
    STAYS = "nothing would move it, and no failsafe for a lost ground station would bring it back"
    COASTS = "it would coast, or drift, without steering"
    KILLS = "it is the termination of the flight: its motors stop"


_COPTER: Mapping[str, Without] = {
    **dict.fromkeys(("STABILIZE", "ACRO", "DRIFT", "TURTLE", "FLIP", "THROW"), Without.FALLS),
    **dict.fromkeys(("SYSTEMID", "AUTOROTATE", "RATE_ACRO"), Without.FALLS),
    **dict.fromkeys(("ALT_HOLD", "SPORT", "GUIDED_NOGPS", "FLOWHOLD", "AUTOTUNE"), Without.DRIFTS),
    **dict.fromkeys(("LOITER", "POSHOLD", "ZIGZAG", "POSITION", "OF_LOITER"), Without.STAYS),
}
_PLANE: Mapping[str, Without] = {
    **dict.fromkeys(("MANUAL", "ACRO", "STABILIZE", "TRAINING", "QSTABILIZE", "QACRO"), Without.FALLS),
    **dict.fromkeys(("FBWA", "FBWB", "CRUISE", "AUTOTUNE"), Without.GLIDES),
    **dict.fromkeys(("QHOVER", "QLOITER", "QAUTOTUNE"), Without.SINKS),
}
_ROVER = dict.fromkeys(("MANUAL", "ACRO", "LEARNING", "STEERING", "SIMPLE"), Without.COASTS)
_SUB: Mapping[str, Without] = {
    **dict.fromkeys(("MANUAL", "STABILIZE", "ACRO"), Without.COASTS),
    "MOTORDETECT": Without.FALLS,
}
_BLIMP = dict.fromkeys(("MANUAL", "VELOCITY"), Without.COASTS)
_ARDUPILOT: Mapping[VehicleClass, Mapping[str, Without]] = {
    VehicleClass.COPTER: _COPTER,
    VehicleClass.PLANE: _PLANE,
    VehicleClass.VTOL: _PLANE,
    VehicleClass.ROVER: _ROVER,
    VehicleClass.BOAT: _ROVER,
    VehicleClass.SUB: _SUB,
    VehicleClass.BLIMP: _BLIMP,
}
PX4_STICK_MODES: Mapping[str, Without] = {
    **dict.fromkeys(("MANUAL", "ACRO", "STABILIZED", "RATTITUDE"), Without.FALLS),
    **dict.fromkeys(("ALTCTL", "POSCTL", "POSCTL.SLOW", "SIMPLE", "ALTITUDE_CRUISE"), Without.SINKS),
    "TERMINATION": Without.KILLS,
}

WEARS_NO_FORCE = frozenset({Without.FALLS, Without.KILLS})
"""Refused in the air without sticks, whoever insists."""


def without_sticks(model: VehicleModel, custom_mode: int) -> Without | None:
    """The behaviour of this vehicle in a mode, in the air and without sticks; None: the mode needs none there."""
    name = mode_name(model, custom_mode)
    if model.family != "px4":
        return _ARDUPILOT.get(model.kind, {}).get(name)
    effect = PX4_STICK_MODES.get(name)
    falls_not = not abilities_of(model.family, model.kind).flies and effect is not None and effect is not Without.KILLS
    return Without.COASTS if falls_not else effect  # a PX4 that does not fly


def needs_sticks(model: VehicleModel, vehicle: Vehicle, name: str) -> bool:
    """True if a mode, by a name that its firmware may have, is flown by sticks."""
    try:
        number = modes.mode_number(vehicle.autopilot, vehicle.mode_type, name)
    except KeyError:
        return False
    return without_sticks(model, number) is not None


class Hands(NamedTuple):
    """Whose hands a vehicle is in: the mode, if that is flown by sticks, and whether it is armed or we arm it."""

    stick_mode: str
    """"": none that is flown by sticks."""
    armed: bool
    at: float
    """The time of this look."""


def hands(vehicle: Vehicle, now: float) -> Hands:
    """The hands in which it is now."""
    by_sticks = vehicle.family != "generic" and without_sticks(model_of(vehicle, now), vehicle.custom_mode) is not None
    return Hands(vehicle.mode if by_sticks else "", vehicle.armed or is_being_armed(vehicle, now), now)


def taken_since(vehicle: Vehicle, now: float, before: Hands) -> str | None:
    """Return why what began when the vehicle was in the hands ``before`` is left to its pilot, who has switched it to
    another mode that is flown by sticks, or armed it in one, since. None: he has not. In failsafe, and without sticks
    that are seen with the throttle up, its own failsafe has switched it, and it sinks."""
    mode, armed = hands(vehicle, now).stick_mode, vehicle.armed
    if not mode or failsafe_without_sticks(vehicle, now):
        return None
    if mode != before.stick_mode:
        return f"it was switched to {mode} since, which its pilot flies"
    return f"it was armed in {mode} since, which its pilot flies" if armed and not before.armed else None


def failsafe_without_sticks(vehicle: Vehicle, now: float) -> bool:
    """True if the mode in which it is may be that of its own failsafe, and nobody is seen to have sticks."""
    return vehicle.failsafe and model_of(vehicle, now).sticks not in SEEN_AT_ALL


def mode_name(model: VehicleModel, custom_mode: int) -> str:
    """Name of a custom_mode in this vehicle's firmware."""
    if model.family == "px4":
        return modes.px4_mode_name(custom_mode)
    return modes.ardupilot_mode_name(class_type(model.kind), custom_mode)


def mode_refusal(model: VehicleModel, custom_mode: int, *, force: bool) -> str | None:
    """Why this vehicle must not be brought into a mode now; None: it may be."""
    if not model.may_fly or model.family == "generic" or custom_mode == model.custom_mode:
        return None
    effect = without_sticks(model, custom_mode)
    if effect is None:
        return None
    if effect is Without.KILLS:
        return f"{mode_name(model, custom_mode)}: {effect}; stop kill does that, with a confirmation"
    text = hazard(model, custom_mode)
    if text is None:
        return None
    if effect in WEARS_NO_FORCE and model.sticks not in (Sticks.UNKNOWN, Sticks.SEEN):
        return f"{text}; land or hold it instead"
    return None if force else f"{text}; {FORCE_HINT}"


def hazard(model: VehicleModel, custom_mode: int) -> str | None:
    """The danger to a flying vehicle in a mode that is flown by sticks, as a sentence for a person; None: the
    mode needs none, or they are seen with the throttle up."""
    effect = without_sticks(model, custom_mode)
    if effect is None or model.sticks is Sticks.READY:
        return None
    low = model.sticks is Sticks.LOW
    seen = "its throttle stick is down" if low else "no sticks are seen in its telemetry"
    if model.sticks is Sticks.SEEN:
        seen = "where its throttle stick is is not known (no RC_CHANNELS)"
    if low and effect in (Without.DRIFTS, Without.STAYS):
        effect = Without.SINKS
    return f"{mode_name(model, custom_mode)} is flown by sticks, and {seen}: {effect}"
