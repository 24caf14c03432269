"""The class of a vehicle, by what its heartbeat, its boot banner and its parameters show.

    firmware    evidence, the first that is there counts          class
    ---------   -----------------------------------------------   --------------------------------------------------
    PX4         MAV_TYPE                                           copter, plane, vtol, rover, boat, sub, other
    ArduPilot   the program in its banner ("ArduPlane V4.6.3")     that of the program, below
                a parameter Q_ENABLE, which ArduPlane alone has    plane or vtol
                MAV_TYPE                                           that of the program that shows such a type

    ArduPlane   Q_ENABLE is not 0, it shows a VTOL's or a          vtol (a QuadPlane), else plane
                multirotor's MAV_TYPE, or is in a Q mode
    Rover       MAV_TYPE 11                                        boat, else rover

The MAV_TYPE alone does not do for ArduPilot: a QuadPlane shows a fixed wing (1) unless Q_MAV_TYPE says otherwise, and
with Q_MAV_TYPE = 2 it shows a quadrotor (QuadPlane::get_mav_type), whose mode 17 is BRAKE while its own is QSTABILIZE.
"""

from __future__ import annotations

from enum import StrEnum

from skygcs.core.mavlink.modes import AUTOPILOT_ARDUPILOT, AUTOPILOT_PX4, COPTER_TYPES, PLANE_TYPES


class VehicleClass(StrEnum):
    """The kind of motion a vehicle is made for, which decides the modes that hold, stop and land it."""

    COPTER = "copter"
    PLANE = "plane"
    VTOL = "vtol"
    ROVER = "rover"
    BOAT = "boat"
    SUB = "sub"
    BLIMP = "blimp"
    TRACKER = "tracker"
    OTHER = "other"


Program = str
"""Name of an ArduPilot program, one of `PROGRAM_TYPES`."""

PROGRAM_TYPES: dict[Program, int] = {
    "ArduCopter": 2,
    "ArduPlane": 1,
    "Rover": 10,
    "ArduSub": 12,
    "AntennaTracker": 5,
    "Blimp": 7,
}
"""ArduPilot's programs, and the MAV_TYPE that stands for each in the tables of modes."""

_BANNER_NAMES = {
    **{name: name for name in PROGRAM_TYPES},
    "ArduRover": "Rover",
    "APM:Copter": "ArduCopter",
    "APM:Plane": "ArduPlane",
    "APM:Rover": "Rover",
}

_VTOL_TYPES = frozenset(range(19, 26))
"""MAV_TYPE_VTOL_*, of tail-sitters, tilt-rotors, tilt-wings and others."""

_CLASS_TYPES = {
    VehicleClass.COPTER: 2,
    VehicleClass.PLANE: 1,
    VehicleClass.VTOL: 20,
    VehicleClass.ROVER: 10,
    VehicleClass.BOAT: 11,
    VehicleClass.SUB: 12,
    VehicleClass.BLIMP: 7,
    VehicleClass.TRACKER: 5,
}

Q_MODES = frozenset({*range(17, 24), 25})
"""ArduPlane's QSTABILIZE to QACRO and LOITER to QLAND: only a QuadPlane enters them (ArduPlane/mode.h)."""

_TYPES: dict[int, VehicleClass] = {
    **dict.fromkeys(COPTER_TYPES, VehicleClass.COPTER),
    **dict.fromkeys(PLANE_TYPES, VehicleClass.PLANE),
    **dict.fromkeys(_VTOL_TYPES, VehicleClass.VTOL),
    5: VehicleClass.TRACKER,
    7: VehicleClass.BLIMP,
    10: VehicleClass.ROVER,
    11: VehicleClass.BOAT,
    12: VehicleClass.SUB,
}


def program_of_banner(name: str) -> Program | None:
    """The program that names itself so in its banner (`firmware.banner_program`); None: not one of ArduPilot's."""
    return _BANNER_NAMES.get(name)


def mode_type(autopilot: int, vehicle_type: int, program: Program | None, q_enable: float | None) -> int:
    """The MAV_TYPE whose table of modes a vehicle uses: that of its program, where that is known."""
    if autopilot != AUTOPILOT_ARDUPILOT:
        return vehicle_type
    if program is None and q_enable is not None:
        program = "ArduPlane"
    if program is None:
        return vehicle_type
    own = PROGRAM_TYPES[program]
    return vehicle_type if _program_class(vehicle_type) is _program_class(own) else own


def class_type(kind: VehicleClass) -> int:
    """A MAV_TYPE whose table of ArduPilot modes vehicles of this class have."""
    return _CLASS_TYPES.get(kind, 0)


def vehicle_class(
    autopilot: int, vehicle_type: int, custom_mode: int, program: Program | None, q_enable: float | None
) -> VehicleClass:
    """The class. ``q_enable``: ArduPlane's parameter Q_ENABLE; None: not known, or there is none."""
    if autopilot not in (AUTOPILOT_ARDUPILOT, AUTOPILOT_PX4):
        return _TYPES.get(vehicle_type, VehicleClass.OTHER)
    by_type = _TYPES.get(vehicle_type, VehicleClass.OTHER)
    if autopilot == AUTOPILOT_PX4:
        return by_type
    by_program = _TYPES.get(mode_type(autopilot, vehicle_type, program, q_enable), VehicleClass.OTHER)
    if by_program is not VehicleClass.PLANE:
        return by_program
    lifts = bool(q_enable) or custom_mode in Q_MODES or by_type in (VehicleClass.VTOL, VehicleClass.COPTER)
    return VehicleClass.VTOL if lifts else VehicleClass.PLANE


def _program_class(vehicle_type: int) -> VehicleClass:
    """The class of types that one ArduPilot program shows: a boat is a Rover's, a VTOL an ArduPlane's."""
    kind = _TYPES.get(vehicle_type, VehicleClass.OTHER)
    return {VehicleClass.BOAT: VehicleClass.ROVER, VehicleClass.VTOL: VehicleClass.PLANE}.get(kind, kind)
