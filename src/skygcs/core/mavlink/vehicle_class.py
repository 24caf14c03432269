"""The class of a vehicle, by what its heartbeat, its boot banner and its parameters show, and what each class can do.

    firmware    evidence, the first that is there counts          class
    ---------   -----------------------------------------------   --------------------------------------------------
    PX4         MAV_TYPE                                           copter, plane, vtol, rover, boat, sub, other
    ArduPilot   the program in its banner ("ArduPlane V4.6.3")     that of the program, below
                a parameter Q_ENABLE, which ArduPlane alone has    plane or vtol
                MAV_TYPE                                           that of the program that shows such a type

    ArduPlane   Q_ENABLE is not 0, it shows a VTOL's or a          vtol (a QuadPlane), else plane
                multirotor's MAV_TYPE, is in a Q mode, or its
                EXTENDED_SYS_STATE has a vtol_state
    Rover       MAV_TYPE 11                                        boat, else rover

The MAV_TYPE alone does not do for ArduPilot: a QuadPlane shows a fixed wing (1) unless Q_MAV_TYPE says otherwise, and
with Q_MAV_TYPE = 2 it shows a quadrotor (QuadPlane::get_mav_type), whose mode 17 is BRAKE while its own is QSTABILIZE.

Abilities of the classes (`abilities_of`): the one declaration from which orders, checks and margins are derived.

    ability     copter   plane          vtol                rover, boat   sub     blimp   tracker   other
    ---------   ------   ------------   -----------------   -----------   -----   -----   -------   -----
    flies       yes      yes            yes                 no            no      yes     no        taken to
    hovers      yes      no             on its rotors       no            no      yes     no        no
    circles     no       always         on its wing         no            no      no      no        taken to
    setpoints   yes      no             no                  no            no      no      no        no
    turns to a  yes      no             PX4 on its rotors   no            yes     no      no        no
    heading
    moves off   PX4      yes            yes                 ArduPilot,    PX4     no      no        PX4
    when armed                                              PX4
    return      lands    circles, or    circles, or on      stands (PX4   -       stands  -         taken to
    ends        (PX4 or  by its         its rotors (PX4     disarms)                                land
                holds)   mission        lands)

What cannot stop holds by a circle: `hold_radius` names the parameter with its radius and the firmware's default. The
modes and commands of each order are fields, of which `autopilot` makes plans.

Read from ArduPilot 4.6 (ArduPlane/mode.h, GCS_Mavlink.cpp: handle_command_int_packet; Rover/mode.h, GCS_Mavlink.cpp)
and PX4 1.16 (navigator: loiter.cpp, takeoff.cpp, land.cpp; fw_pos_control: control_auto_takeoff).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.modes import AUTOPILOT_ARDUPILOT, AUTOPILOT_PX4, COPTER_TYPES, PLANE_TYPES, Family


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
    """The program that names itself so in its banner (`decoding.banner_program`); None: not one of ArduPilot's."""
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


# asked for several times in each tick of each vehicle: 0.3 us instead of 2 with ArduPilot
@functools.lru_cache(maxsize=1024)
def vehicle_class(
    autopilot: int,
    vehicle_type: int,
    custom_mode: int,
    program: Program | None,
    q_enable: float | None,
    vtol_state: int = 0,
) -> VehicleClass:
    """The class. ``q_enable``: ArduPlane's parameter Q_ENABLE; None: not known, or there is none. ``vtol_state``:
    MAV_VTOL_STATE; 0: undefined, which a QuadPlane never shows (GCS_MAVLINK_Plane::vtol_state), or not known."""
    if autopilot not in (AUTOPILOT_ARDUPILOT, AUTOPILOT_PX4):
        return _TYPES.get(vehicle_type, VehicleClass.OTHER)
    by_type = _TYPES.get(vehicle_type, VehicleClass.OTHER)
    if autopilot == AUTOPILOT_PX4:
        return by_type
    by_program = _TYPES.get(mode_type(autopilot, vehicle_type, program, q_enable), VehicleClass.OTHER)
    if by_program is not VehicleClass.PLANE:
        return by_program
    shows_rotors = by_type in (VehicleClass.VTOL, VehicleClass.COPTER) or vtol_state != 0
    lifts = bool(q_enable) or custom_mode in Q_MODES or shows_rotors
    return VehicleClass.VTOL if lifts else VehicleClass.PLANE


def _program_class(vehicle_type: int) -> VehicleClass:
    """The class of types that one ArduPilot program shows: a boat is a Rover's, a VTOL an ArduPlane's."""
    kind = _TYPES.get(vehicle_type, VehicleClass.OTHER)
    return {VehicleClass.BOAT: VehicleClass.ROVER, VehicleClass.VTOL: VehicleClass.PLANE}.get(kind, kind)


# -- abilities


class TakeOff(StrEnum):
    """How a vehicle leaves the ground."""

    NONE = "none"
    CLIMB = "straight up, to the height that is asked for"
    CLIMB_OUT = "ahead, where its nose points, to the height that is asked for"
    OWN_HEIGHT = "ahead, where its nose points, to the height of a parameter"
    BY_ROTORS = "straight up on its rotors, by a height above where it stands"

    @property
    def is_ahead(self) -> bool:
        """True for a plane's: along the ground and up ahead."""
        return self in (TakeOff.CLIMB_OUT, TakeOff.OWN_HEIGHT)


class Landing(StrEnum):
    """How a vehicle comes down."""

    NONE = "none"
    UNKNOWN = "not known: NAV_LAND is worth an attempt"
    HERE = "NAV_LAND"
    MISSION = "the landing of its mission (DO_LAND_START)"
    MODE = "a mode of its own"


class ReturnEnd(StrEnum):
    """How a return ends, at its home."""

    LANDS = "it lands and disarms"
    LANDS_ON_ROTORS = "it flies home as a plane, and lands there on its rotors"
    BY_MISSION = "it lands by the landing of its mission"
    HOLDS = "it holds above its home"
    CIRCLES = "it circles above its home"
    LANDS_AS_PLANE = "it circles above its home, and comes down there as a plane"
    NOT_KNOWN = "it stays above its home, or lands: that is not known"
    STANDS = "it stops and stays armed"
    STANDS_DISARMED = "it stops at its home and disarms"
    """A PX4 that drives counts as landed there (RoverLandDetector::_get_landed_state), and Commander disarms it after
    COM_DISARM_LAND. Known from the source only."""


HeightParam = tuple[tuple[str, float], ...]
"""A height in metres above home: the names of its parameter in different versions, each with its units per metre."""

Q_RTL_MODE, RTL_AUTOLAND, Q_OPTIONS = "Q_RTL_MODE", "RTL_AUTOLAND", "Q_OPTIONS"
RTL_TYPE, RTL_LAND_DELAY = "RTL_TYPE", "RTL_LAND_DELAY"
"""PX4. By default 0 and 0 (rtl_params.c), of planes 1 and -1 (init.d/rc.fw_defaults)."""


MISSION_LANDINGS = frozenset({mav_cmd.NAV_LAND, mav_cmd.NAV_VTOL_LAND})


@dataclass(frozen=True, slots=True)
class ReturnRule:
    """How returns end by the parameters of a vehicle, for any mission."""

    end: ReturnEnd
    """Without a landing in its mission."""
    markers: frozenset[int] = frozenset()
    """With one of these commands (MAV_CMD) in its mission it lands by that instead; empty: it does not look for one."""
    known: bool = True
    """False: a parameter that decides it is not known, and counts as the firmware's default."""

    def __str__(self) -> str:
        if not self.markers:
            return str(self.end)
        named = " or ".join(MARKER_NAMES[marker] for marker in sorted(self.markers))
        return f"{ReturnEnd.BY_MISSION} ({named}); without one {self.end}"

    def with_mission(self, commands: Collection[int]) -> ReturnEnd:
        """How the returns of a mission of these commands end. A marker that no landing follows leaves it unknown."""
        if not self.known:
            return ReturnEnd.NOT_KNOWN
        if self.markers.isdisjoint(commands):
            return self.end
        return ReturnEnd.NOT_KNOWN if MISSION_LANDINGS.isdisjoint(commands) else ReturnEnd.BY_MISSION


MARKER_NAMES = {
    mav_cmd.NAV_LAND: "NAV_LAND",
    mav_cmd.NAV_VTOL_LAND: "NAV_VTOL_LAND",
    mav_cmd.DO_RETURN_PATH_START: "DO_RETURN_PATH_START",
    mav_cmd.DO_LAND_START: "DO_LAND_START",
}


def plane_return(rotors: int, autoland: int) -> ReturnRule:
    """Rule of an ArduPlane by Q_RTL_MODE (0 of a fixed wing) and RTL_AUTOLAND. ArduPlane/mode_rtl.cpp: _enter,
    navigate, switch_QRTL; AP_Mission.cpp: get_landing_sequence_start, jump_to_closest_mission_leg."""
    lands = ReturnEnd.LANDS_ON_ROTORS
    if rotors in (2, 3):  # VTOL_APPROACH_QRTL, QRTL_ALWAYS: RTL_AUTOLAND is not looked at
        return ReturnRule(lands)
    # before it is near its home; without the marker it flies on to there
    end = lands if rotors == 1 else ReturnEnd.CIRCLES
    if autoland == 2:  # RTL_IMMEDIATE_DO_LAND_START
        return ReturnRule(end, frozenset({mav_cmd.DO_LAND_START}))
    if autoland == 4:  # DO_RETURN_PATH_START
        return ReturnRule(end, frozenset({mav_cmd.DO_RETURN_PATH_START}))
    if rotors == 1:  # SWITCH_QRTL: within RTL_RADIUS, before RTL_THEN_DO_LAND_START
        return ReturnRule(lands)
    return ReturnRule(end, frozenset({mav_cmd.DO_LAND_START}) if autoland == 1 else frozenset())


def px4_return(rtl_type: float | None, land_delay_s: float | None, *, circles: bool) -> ReturnRule:
    """Rule of a PX4 fixed wing (``circles``) or copter by RTL_TYPE and RTL_LAND_DELAY (s; below 0: it waits without
    end); None: by default. navigator/rtl.cpp: findRtlDestination, init_rtl_mission_type; rtl_direct.cpp: LOITER_HOLD.
    Rally points are not looked at."""
    if circles:
        delay_s = -1.0 if land_delay_s is None else land_delay_s
        at_home = ReturnEnd.CIRCLES if delay_s < 0.0 else ReturnEnd.LANDS_AS_PLANE
    else:
        at_home = ReturnEnd.HOLDS if (land_delay_s or 0.0) < 0.0 else ReturnEnd.LANDS
    match int(circles) if rtl_type is None else int(rtl_type):
        case 0:
            return ReturnRule(at_home)
        case 1:
            return ReturnRule(at_home, MISSION_LANDINGS)
        case _:  # the nearer one, or back along its mission
            return ReturnRule(ReturnEnd.NOT_KNOWN)


@dataclass(frozen=True, slots=True)
class HoldRadius:
    """Radius of the circle that is flown as a hold: a parameter, whose sign is the direction, and its default (m)."""

    param: str
    default_m: float
    least_m: float = 1.0
    """A value that is not above it counts as the default (ArduPlane: Plane::update_loiter)."""

    def value_m(self, known: float | None) -> float:
        """The radius by the parameter's value, m; without a usable one the default."""
        return self.default_m if known is None or abs(known) <= self.least_m else abs(known)


HOLD_REACH = 1.25
"""Radius that is kept clear, over the parameter's. ArduPlane 4.6.3 flew 93 m with 80 m at 22 m/s in its own simulator,
PX4 1.16.1 79 to 82 m with 80 m at 15 m/s, both without wind."""

PX4_HOLD = HoldRadius("NAV_LOITER_RAD", 80.0, 0.0)
"""navigator_params.c."""
ARDUPLANE_HOLD = HoldRadius("WP_LOITER_RAD", 60.0)
"""ArduPlane/config.h: LOITER_RADIUS_DEFAULT."""

PX4_RETURN = HoldRadius("RTL_LOITER_RAD", 80.0, 0.0)
"""rtl_params.c."""
ARDUPLANE_RETURN = HoldRadius("RTL_RADIUS", 0.0)
"""mode_rtl.cpp: navigate; Plane::update_loiter."""

TAKEOFF_HEIGHT = "TKOFF_ALT"
"""Height (m) above where it stands to which ArduPlane's TAKEOFF mode climbs (mode_takeoff.cpp)."""


@dataclass(frozen=True, slots=True)
class Abilities:
    """Abilities of one class with one firmware."""

    flies: bool = True
    """It is carried by the air: it falls without its motors, and a place to go to needs a height."""
    hovers: bool = False
    """It can stand still in the air."""
    circles: bool = False
    """It cannot stop, at least at times: it holds by a circle."""
    setpoints: bool = False
    """It follows positions, velocities and attitudes as skygcs streams them, and so flies plans and formations."""
    goes: bool = True
    """It goes to a place by one order."""
    turns: bool = False
    """It takes the heading of a goto."""
    moves_off: frozenset[str] = frozenset()
    """Modes in which it may go on its way as soon as it is armed."""
    returns: bool = True
    return_mode: str = ""
    """Mode of a return; "": NAV_RETURN_TO_LAUNCH."""
    return_end: ReturnEnd = ReturnEnd.LANDS
    """PX4: rtl_direct.cpp (a fixed wing loiters); ArduPilot: ModeRTL of each program (an ArduPlane's with its default
    parameters, see `return_rule`)."""
    return_params: tuple[str, ...] = ()
    """Parameters that change how its return ends."""
    failsafe_params: tuple[str, ...] = ()
    """Further ones that change what a failsafe does."""
    return_heights: tuple[HeightParam, ...] = ()
    """It returns in the highest of these, if it is not higher."""
    return_climb: HeightParam = ()
    """By so much it climbs at least before it turns home."""
    order_params: tuple[str, ...] = ()
    """Further parameters that decide what its orders do."""
    stop_mode: str = ""
    """Mode that stops it, or circles, and ignores setpoints; "": skygcs knows none."""
    hold_mode: str = ""
    """Mode in which it holds; "": that which stops it."""
    takeoff: TakeOff = TakeOff.NONE
    landing: Landing = Landing.NONE
    land_mode: str = ""
    """Mode of `Landing.MODE`."""
    hold_radius: HoldRadius | None = None
    """Radius of the hold of what circles."""
    return_radius: HoldRadius | None = None
    """Radius of the circle above home, where that is another parameter's; its default 0: that of the hold."""
    brake_mps2: float = 0.0
    """Deceleration on which the monitor counts when it orders a hold, m/s²; 0: it counts on none."""

    @property
    def height_params(self) -> tuple[tuple[str, ...], ...]:
        """Names of the parameters of its return height; of several in one, any will do."""
        return tuple(tuple(name for name, _ in height) for height in self.return_heights)

    @property
    def asked_params(self) -> tuple[str, ...]:
        """Parameters without which an order or a margin is not known."""
        circle = tuple(radius.param for radius in (self.hold_radius, self.return_radius) if radius is not None)
        height = (TAKEOFF_HEIGHT,) if self.takeoff is TakeOff.OWN_HEIGHT else ()
        return (*circle, *height, *self.return_params, *self.order_params)

    def return_rule(self, param: Callable[[str], float | None]) -> ReturnRule:
        """How its return ends, by its parameters; of one that is not known the firmware's default counts. Only those of
        its class are looked at: a fixed wing may have kept the Q_RTL_MODE of a QuadPlane."""
        if not self.return_params:
            return ReturnRule(self.return_end)
        values = {name: param(name) for name in self.return_params}
        if RTL_TYPE in values:
            rule = px4_return(values[RTL_TYPE], values[RTL_LAND_DELAY], circles=self.circles)
        else:
            rule = plane_return(int(values.get(Q_RTL_MODE) or 0), int(values[RTL_AUTOLAND] or 0))
        return replace(rule, known=None not in values.values())

    def may_move(self, in_air: bool | None) -> bool:
        """True unless it is known to stand while its motors may turn: what flies stands while it is on the ground (not
        ``in_air``), and what drives may be under way whatever that says. The one rule of what is under way."""
        return not self.flies or in_air is not False

    @property
    def lands(self) -> bool:
        """False for what has no landing, and for what skygcs knows none of."""
        return self.landing not in (Landing.NONE, Landing.UNKNOWN)


_COPTER_RETURN: tuple[HeightParam, ...] = ((("RTL_ALT", 100.0), ("RTL_ALT_M", 1.0)),)
"""ArduCopter: in centimetres up to 4.6."""
_COPTER_CLIMB: HeightParam = (("RTL_CLIMB_MIN", 100.0), ("RTL_CLIMB_MIN_M", 1.0))
_PLANE_RETURN: tuple[HeightParam, ...] = ((("RTL_ALTITUDE", 1.0),),)
"""ArduPlane; below 0: as high as it is (Plane::get_RTL_altitude_cm)."""
_QUADPLANE_RETURN: tuple[HeightParam, ...] = (*_PLANE_RETURN, (("Q_RTL_ALT", 1.0),))
"""QRTL approaches at the higher one of the two (ModeQRTL::update_target_altitude)."""
_PLANE_CLIMB: HeightParam = (("RTL_CLIMB_MIN", 1.0),)
_PX4_RETURN: tuple[HeightParam, ...] = ((("RTL_RETURN_ALT", 1.0),),)

_C = VehicleClass
_ON_THE_GROUND = Abilities(flies=False, return_end=ReturnEnd.STANDS)

_PX4_GOES = frozenset({"AUTO.MISSION", "AUTO.TAKEOFF"})
_PLANE_GOES = frozenset({"AUTO", "TAKEOFF"})
"""ArduPlane/servos.cpp: Plane::suppress_throttle."""
_ROVER_GOES = frozenset({"AUTO", "CIRCLE", "DOCK", "FOLLOW", "GUIDED"})
"""In GUIDED a Rover that was disarmed on its way drives on to its place (mode_guided.cpp: update; Rover::set_mode to
the same mode changes nothing), and stands if it has none. Armed in CIRCLE, Rover 4.6.3 was at 4 m/s after 4 s."""

_PX4 = Abilities(stop_mode="AUTO.LOITER", landing=Landing.HERE, return_heights=_PX4_RETURN, moves_off=_PX4_GOES)
_PX4_DRIVES = replace(_PX4, flies=False, landing=Landing.NONE, return_end=ReturnEnd.STANDS_DISARMED, return_heights=())

TABLE: Mapping[tuple[Family, VehicleClass], Abilities] = {
    ("px4", _C.COPTER): replace(
        _PX4,
        hovers=True,
        setpoints=True,
        turns=True,
        takeoff=TakeOff.CLIMB,
        brake_mps2=2.0,
        return_params=(RTL_TYPE, RTL_LAND_DELAY),
    ),
    ("px4", _C.PLANE): replace(
        _PX4,
        circles=True,
        takeoff=TakeOff.CLIMB_OUT,
        hold_radius=PX4_HOLD,
        return_radius=PX4_RETURN,
        return_end=ReturnEnd.CIRCLES,
        return_params=(RTL_TYPE, RTL_LAND_DELAY),
    ),
    ("px4", _C.VTOL): replace(_PX4, hovers=True, circles=True, takeoff=TakeOff.CLIMB, hold_radius=PX4_HOLD),
    ("px4", _C.ROVER): replace(_PX4_DRIVES, brake_mps2=1.0),
    ("px4", _C.BOAT): _PX4_DRIVES,
    ("px4", _C.SUB): replace(_PX4_DRIVES, returns=False, turns=True),
    ("ardupilot", _C.COPTER): Abilities(
        hovers=True,
        setpoints=True,
        turns=True,
        stop_mode="BRAKE",
        hold_mode="GUIDED",
        takeoff=TakeOff.CLIMB,
        landing=Landing.HERE,
        brake_mps2=2.0,
        return_heights=_COPTER_RETURN,
        return_climb=_COPTER_CLIMB,
    ),
    ("ardupilot", _C.PLANE): Abilities(
        circles=True,
        moves_off=_PLANE_GOES,
        stop_mode="LOITER",
        takeoff=TakeOff.OWN_HEIGHT,
        landing=Landing.MISSION,
        hold_radius=ARDUPLANE_HOLD,
        return_radius=ARDUPLANE_RETURN,
        return_end=ReturnEnd.CIRCLES,
        return_params=(RTL_AUTOLAND,),
        return_heights=_PLANE_RETURN,
        return_climb=_PLANE_CLIMB,
        order_params=("Q_ENABLE",),
    ),
    ("ardupilot", _C.VTOL): Abilities(
        hovers=True,
        circles=True,
        moves_off=_PLANE_GOES,
        stop_mode="LOITER",
        takeoff=TakeOff.BY_ROTORS,
        landing=Landing.MODE,
        land_mode="QLAND",
        hold_radius=ARDUPLANE_HOLD,
        return_radius=ARDUPLANE_RETURN,
        return_end=ReturnEnd.CIRCLES,
        return_params=(Q_RTL_MODE, RTL_AUTOLAND),
        failsafe_params=(Q_OPTIONS,),
        return_heights=_QUADPLANE_RETURN,
        return_climb=_PLANE_CLIMB,
        order_params=("Q_ENABLE", "Q_GUIDED_MODE"),
    ),
    ("ardupilot", _C.ROVER): replace(_ON_THE_GROUND, stop_mode="HOLD", brake_mps2=1.0, moves_off=_ROVER_GOES),
    ("ardupilot", _C.BOAT): replace(_ON_THE_GROUND, stop_mode="HOLD", hold_mode="LOITER", moves_off=_ROVER_GOES),
    ("ardupilot", _C.SUB): replace(
        _ON_THE_GROUND, stop_mode="POSHOLD", landing=Landing.HERE, returns=False, turns=True
    ),
    ("ardupilot", _C.BLIMP): Abilities(
        hovers=True,
        stop_mode="LOITER",
        goes=False,
        landing=Landing.MODE,
        land_mode="LAND",
        return_mode="RTL",
        return_end=ReturnEnd.STANDS,
    ),
    ("ardupilot", _C.TRACKER): replace(_ON_THE_GROUND, stop_mode="STOP", goes=False, returns=False),
    ("generic", _C.COPTER): Abilities(hovers=True, goes=False, landing=Landing.HERE),
}
"""A pair that is not here (an autopilot that skygcs does not know, a class that a firmware has not, such as the airship
of PX4) has the abilities of its family in `UNKNOWN`. NAV_LAND is MAVLink's own landing, which any copter has."""

ON_ROTORS: Mapping[tuple[Family, VehicleClass], Abilities] = {
    ("px4", _C.VTOL): replace(TABLE["px4", _C.VTOL], circles=False, turns=True),
    ("ardupilot", _C.VTOL): replace(
        TABLE["ardupilot", _C.VTOL],
        circles=False,
        stop_mode="QLOITER",
        return_mode="QRTL",
        return_end=ReturnEnd.LANDS,
        return_params=(),
    ),
}
"""A VTOL while it is known to be carried by its rotors."""

_FLIES_SOMEHOW = Abilities(goes=False, circles=True, landing=Landing.UNKNOWN)
UNKNOWN: Mapping[Family, Abilities] = {
    "px4": replace(_PX4, goes=False, circles=True),
    "ardupilot": _FLIES_SOMEHOW,
    "generic": _FLIES_SOMEHOW,
}
"""A thing that flies, cannot stop, and of which no order is known but those that all firmware shares (arm, disarm,
return, reboot, home, parameters), and on PX4, whose modes all its vehicles share, hold and land."""


def abilities_of(family: Family, kind: VehicleClass, *, hovers: bool = False) -> Abilities:
    """The abilities of a class with a firmware. ``hovers``: it is a VTOL that is known to be on its rotors now."""
    return (ON_ROTORS if hovers else TABLE).get((family, kind), UNKNOWN[family])


def cannot_hover(family: Family, kind: VehicleClass) -> str | None:
    """Why vehicles of this class fly no setpoints, and so no plan and no formation, as a sentence for a person; None:
    they do."""
    if family == "generic":
        return "skygcs knows the setpoints of PX4 and ArduPilot only"
    able = abilities_of(family, kind)
    if able.setpoints:
        return None
    named = f"a {kind}" if kind is not VehicleClass.OTHER else "of a class that skygcs does not know"
    return f"it is {named}, and only copters hover at setpoints; {instead_of_setpoints(able)}"


def instead_of_setpoints(able: Abilities) -> str:
    """Return what moves a vehicle that follows no setpoints, for a person."""
    words = ["goto"] * able.goes + ["hold"] * bool(able.stop_mode) + ["rtl"] * able.returns
    return f"orders ({', '.join(words)}) and missions move it" if words else "its missions move it"


def declared_params() -> frozenset[str]:
    """Every parameter that decides what an order or a return of some class does."""
    names: set[str] = set()
    for able in (*TABLE.values(), *ON_ROTORS.values(), *UNKNOWN.values()):
        names.update(able.asked_params)
        names.update(name for height in (*able.return_heights, able.return_climb) for name, _ in height)
    return frozenset(names)
