"""Entering and leaving control by setpoints: which vehicles allow it, in which mode, and with which parameters.

    PX4         OFFBOARD. It enters only if setpoints have come for more than a second, more than 2 a second
                (offboardCheck.cpp: one within COM_OF_LOSS_T). When they stop it leaves, to the mode of COM_OBL_RC_ACT.
    ArduCopter  GUIDED. It needs a position to enter; without setpoints of velocity or attitude for GUID_TIMEOUT (3 s)
                it levels and stops. Thrust of SET_ATTITUDE_TARGET is a climb rate unless GUID_OPTIONS has bit 3.

Sequence: `entry_refusal`; for attitude `ask_parameters` and `attitude_refusal`; start streaming; `enter`; and if that
fails, or when control ends, `leave`.
"""

from __future__ import annotations

from skygcs.core.control.control_fence import COPTER_BRAKING, PX4_BRAKING, BrakingLimits, LossReach
from skygcs.core.control.velocity_loop import within
from skygcs.core.mavlink import modes
from skygcs.core.mavlink.vehicle_class import cannot_hover
from skygcs.core.vehicle import autopilot, orders
from skygcs.core.vehicle.order_plan import ParamKnown, Plan, Step
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import SEEN_AT_ALL, Sticks, sticks_of
from skygcs.errors import RefusedError

THRUST_AS_THRUST = 1 << 3
"""Bit of ArduCopter's GUID_OPTIONS (mode.h, ModeGuided::Options::SetAttitudeTarget_ThrustAsThrust)."""

PX4_THRUST_TYPES = frozenset({2, 3, 4, 13, 14, 15})
"""Quadrotor, coaxial, helicopter, hexa-, octo- and tricopter: PX4 1.14's fill_thrust knows these MAV_TYPEs; any other
rotorcraft, a generic one too, it would fly with no thrust at all. (skygcs' control law is not for VTOLs.)"""

PILOT_GOES_ON = 1 << 4
"""Bit of ArduCopter's FS_OPTIONS (Copter.h, GCS_CONTINUE_IF_PILOT_CONTROL), set by default: the failsafe for a lost
ground station does nothing in piloted modes, and BRAKE counts as one."""

PARAM_WAIT_S = 3.0
"""Six requests: ArduPilot answers from a background task, within 0.1 s; the rest is the radio."""

OPTIONAL_WAIT_S = 1.0

COPTER_PARAMETERS = (
    ("GUID_OPTIONS", False),
    ("GUID_TIMEOUT", True),
    ("ATC_ANGLE_BOOST", True),
    ("MOT_THST_HOVER", True),
    ("FS_GCS_ENABLE", True),
    ("FS_OPTIONS", True),
)
PX4_PARAMETERS = (("MPC_THR_HOVER", True), ("COM_OF_LOSS_T", True), ("COM_OBL_RC_ACT", True))
"""Parameters read before control by attitude, and whether each is required."""

LONGEST_LEAN_S = 1.0
"""Longest time for which a vehicle may keep the last attitude after the setpoints stop. With ArduCopter's default
GUID_TIMEOUT of 3 s a vehicle that had just begun an 8 m step drifted 45 m (ArduCopter 4.6.2 SITL, daemon killed)."""

COPTER_LOSS_TIMEOUT_S = 3.0
PX4_LOSS_TIMEOUT_S = 1.0
"""Defaults of GUID_TIMEOUT (ArduCopter 4.6, Parameters.cpp) and COM_OF_LOSS_T (PX4 1.16, commander_params.c)."""

PX4_RESPONSE_S = 0.1
"""By how much PX4 1.16 flies behind a setpoint with position, velocity and acceleration: its attitude follows with
1/MC_ROLL_P = 0.15 s. Measured on a circle of 5 m at 2 m/s: 0.05 s (F450, simulated), 0.5 s (its own simulator SIH, with
a drag of 1/s). ArduCopter 4.6 has nothing to make up for: 0.18 m of error without it."""

LONGEST_LOSS_TIMEOUT_S = 60.0
"""COM_OF_LOSS_T's own bound; a longer GUID_TIMEOUT leaves a fence nothing to fly in anyway."""

BY_STICKS = {0: "Position", 1: "Altitude", 2: "Manual"}
"""Values of PX4's COM_OBL_RC_ACT that lead to a mode flown by transmitter."""

PX4_LOSS_ACTS = {
    **{action: f"changes to {mode} mode, and its pilot has it" for action, mode in BY_STICKS.items()},
    **{3: "returns", 4: "lands", 5: "holds", 6: "ends its flight (Terminate)", 7: "stops its motors (Disarm)"},
}
"""Values of COM_OBL_RC_ACT (PX4 1.16, commander_params.c)."""

FALLS = (6, 7)
"""Those after which it falls."""

NO_STICKS = {
    Sticks.ABSENT: "no sticks are seen",
    Sticks.LOW: "the throttle of its sticks is down",
    Sticks.UNKNOWN: "whether a pilot's sticks reach it is not known",
}
"""Text about the sticks where a mode that flies by them would need them."""

FLIES_ITSELF = frozenset(
    {
        *("AUTO.LOITER", "AUTO.MISSION", "AUTO.RTL", "AUTO.LAND", "AUTO.PRECLAND", "AUTO.FOLLOW_TARGET"),
        *("AUTO", "RTL", "SMART_RTL", "AUTO_RTL", "LAND", "BRAKE", "CIRCLE", "FOLLOW"),
    }
)
"""Modes that may be restored when control ends: they need no transmitter. Not AUTO.TAKEOFF, which would climb."""


def guided_mode(vehicle: Vehicle) -> int:
    """custom_mode in which it follows setpoints. Raises RefusedError for an autopilot without a known one."""
    if vehicle.family == "px4":
        return modes.px4_custom_mode("OFFBOARD")
    if vehicle.family == "ardupilot" and "GUIDED" in modes.mode_names(vehicle.autopilot, vehicle.mode_type):
        return modes.mode_number(vehicle.autopilot, vehicle.mode_type, "GUIDED")
    raise RefusedError("skygcs knows the setpoints of PX4 and ArduPilot only")


def is_following(vehicle: Vehicle) -> bool:
    """True if its last heartbeat shows the mode that follows setpoints."""
    try:
        return vehicle.custom_mode == guided_mode(vehicle)
    except RefusedError:
        return False


def settled_mode(vehicle: Vehicle) -> int:
    """Its custom_mode; of a PX4 that takes off the one that it enters by itself when it is up."""
    if vehicle.family == "px4" and vehicle.mode == "AUTO.TAKEOFF":
        return modes.px4_custom_mode("AUTO.LOITER")
    return vehicle.custom_mode


def entry_refusal(vehicle: Vehicle, now: float) -> str | None:
    """Why control by setpoints cannot begin now; None if it can.

    A mode flown by transmitter is allowed: many flights begin that way, and the remote pilot takes the vehicle back
    with the mode switch. An active failsafe is not: it must not be interrupted without an order of its own.
    """
    if vehicle.duplicate:
        return f"two vehicles with system id {vehicle.sysid} are on the air; give one of them another"
    try:
        if (why := cannot_hover(vehicle.family, vehicle.kind)) is not None:
            raise RefusedError(why)
        guided_mode(vehicle)
        orders.require_going(vehicle, now)
    except RefusedError as error:
        return str(error)
    if vehicle.failsafe:
        return "its own failsafe is active: see its status texts, then let it land, or order hold first"
    return None


def attitude_refusal(vehicle: Vehicle) -> str | None:
    """Why attitude and thrust must not be sent to it; None if they may.

    For an ArduCopter it must be known (`ask_parameters`) that it reads the field as thrust: if it read the controller's
    thrust as a climb rate, it would climb or sink without end.
    """
    if vehicle.family == "px4":
        if vehicle.type in PX4_THRUST_TYPES:
            return None
        kind = vehicle.enum_name("MAV_TYPE", vehicle.type).lower().replace("_", " ")
        return f"PX4 takes the thrust of attitude setpoints for multirotors only, and its type is {kind}; set MAV_TYPE"
    if vehicle.family != "ardupilot" or not vehicle.abilities.setpoints:
        return "skygcs knows the attitude setpoints of PX4 and ArduCopter only"
    options = vehicle.param("GUID_OPTIONS")
    if options is None:
        return (
            "its GUID_OPTIONS is not known, and without bit 3 thrust would mean climb rate; the vehicle did not answer "
            "(ArduCopter has had the option since 4.1)"
        )
    if not int(options) & THRUST_AS_THRUST:
        wanted = int(options) | THRUST_AS_THRUST
        return f"its GUID_OPTIONS is {options:g}: thrust would mean climb rate; set bit 3 (GUID_OPTIONS to {wanted})"
    return None


def loss_refusal(vehicle: Vehicle) -> str | None:
    """Why its parameters advise against control by attitude: its behaviour if the setpoints stopped. The operator may
    insist."""
    name = "GUID_TIMEOUT" if vehicle.family == "ardupilot" else "COM_OF_LOSS_T"
    timeout_s = vehicle.param(name)
    if timeout_s is None or timeout_s <= LONGEST_LEAN_S:
        return None
    return (
        f"its {name} is {timeout_s:g} s: if the setpoints stop, it would keep its last tilt for that time; "
        f"set {name} to {LONGEST_LEAN_S:g} or less, or {orders.FORCE_HINT}"
    )


def moves_setpoints_on(vehicle: Vehicle) -> bool:
    """True if the autopilot moves a position on by its velocity until the next setpoint comes. ArduCopter does
    (AC_PosControl::input_pos_vel_accel_xy hands it on by a step in each run), PX4 holds it (trajectory_setpoint)."""
    return vehicle.family == "ardupilot"


def loss_timeout_s(vehicle: Vehicle) -> float:
    """How long it goes on with the last setpoint after they have ceased: its own parameter, or the firmware's default
    (ArduCopter 3 s, PX4 1 s)."""
    if vehicle.family == "px4":
        timeout_s = vehicle.param("COM_OF_LOSS_T")
        return PX4_LOSS_TIMEOUT_S if timeout_s is None else within(timeout_s, 0.0, LONGEST_LOSS_TIMEOUT_S)
    timeout_s = vehicle.param("GUID_TIMEOUT")
    # ModeGuided::get_timeout_ms takes no less than 0.1 s
    return COPTER_LOSS_TIMEOUT_S if timeout_s is None else within(timeout_s, 0.1, LONGEST_LOSS_TIMEOUT_S)


def braking_limits(vehicle: Vehicle) -> BrakingLimits:
    """The decelerations with which its firmware stops it."""
    return PX4_BRAKING if vehicle.family == "px4" else COPTER_BRAKING


def loss_reach(vehicle: Vehicle) -> LossReach:
    """How far it goes when its setpoints cease."""
    return LossReach(loss_timeout_s(vehicle), braking_limits(vehicle))


def loss_note(vehicle: Vehicle, now: float) -> str | None:
    """A warning about the vehicle's own reaction when setpoints stop, as when this computer dies. Whether a pilot has
    the sticks is decided by the telemetry."""
    if vehicle.family == "ardupilot" and vehicle.param("FS_GCS_ENABLE") == 0:
        return (
            "its FS_GCS_ENABLE is 0: if the setpoints stop, it levels and drifts with the wind, and nothing "
            "brings it back; set FS_GCS_ENABLE to 1 (return) or 5 (land)"
        )
    if vehicle.family == "ardupilot" and int(vehicle.param("FS_OPTIONS") or 0) & PILOT_GOES_ON:
        options = int(vehicle.param("FS_OPTIONS") or 0)
        return (
            f"its FS_OPTIONS is {options}: in GUIDED, where setpoints and hold leave it, a lost ground station brings "
            "it back, but in BRAKE, where stop leaves it, and in a pilot's modes it stays until its battery is empty; "
            f"set FS_OPTIONS to {options & ~PILOT_GOES_ON}"
        )
    action = vehicle.param("COM_OBL_RC_ACT")
    if vehicle.family == "px4" and action in FALLS:
        does = PX4_LOSS_ACTS[int(action or 0)]
        return f"its COM_OBL_RC_ACT is {action:g}: if the setpoints stop, it {does} and falls; set it to 5 (Hold)"
    if vehicle.family != "px4" or action not in BY_STICKS or sticks_of(vehicle, now) in SEEN_AT_ALL:
        return None
    return (
        f"its COM_OBL_RC_ACT is {action:g}: if the setpoints stop, it changes to {BY_STICKS[int(action)]} mode, "
        f"and {NO_STICKS[sticks_of(vehicle, now)]}: it sinks or drifts; set it to 5 (Hold) or 3 (Return)"
    )


def loss_text(vehicle: Vehicle, now: float) -> str:
    """The vehicle's own reaction when setpoints stop, as when this computer dies; dangerous or not."""
    if (note := loss_note(vehicle, now)) is not None:
        return note
    name = "COM_OBL_RC_ACT" if vehicle.family == "px4" else "FS_GCS_ENABLE"
    action = vehicle.param(name)
    if action is None:
        return f"its {name} is not known, which decides what it does if the setpoints stop"
    if vehicle.family != "px4":
        return f"if the setpoints stop, it levels, and its failsafe ({name} {action:g}) acts 5 s later"
    does = PX4_LOSS_ACTS.get(int(action), "does what the parameter says")
    return f"if the setpoints stop, it {does} ({name} {action:g})"


def refuses_setpoint(text: str) -> bool:
    """True if a status text reports that a setpoint was rejected: PX4 names the message, as in
    "SET_POSITION_TARGET_GLOBAL_INT invalid coordinate frame 99". ArduCopter rejects silently."""
    return text.startswith(("SET_POSITION_TARGET_", "SET_ATTITUDE_TARGET"))


def boosts_thrust(vehicle: Vehicle) -> bool:
    """True if it divides the commanded thrust by the cosine of the tilt (`setpoint.attitude_target`, angle_boost).

    ArduCopter does unless ATC_ANGLE_BOOST, 1 by default, is known to be 0; PX4 does not.
    """
    return vehicle.family == "ardupilot" and vehicle.param("ATC_ANGLE_BOOST") != 0


def reported_hover_thrust(vehicle: Vehicle) -> float | None:
    """The vehicle's own value of its hover thrust, 0 to 1; None if it is not known."""
    return vehicle.param("MPC_THR_HOVER" if vehicle.family == "px4" else "MOT_THST_HOVER")


def ask_parameters(vehicle: Vehicle, now: float) -> Plan:
    """Read the parameters needed for control by attitude; always anew, because any station may have changed them."""
    wanted = PX4_PARAMETERS if vehicle.family == "px4" else COPTER_PARAMETERS
    steps = tuple(ask_parameter(name, after=now, optional=optional) for name, optional in wanted)
    return Plan("parameters", steps, "parameters read")


def ask_loss_parameters(vehicle: Vehicle, now: float) -> Plan:
    """Read those parameters of the vehicle's own reaction to the end of setpoints that are not known."""
    wanted = ("COM_OBL_RC_ACT",) if vehicle.family == "px4" else ("FS_GCS_ENABLE", "FS_OPTIONS")
    steps = tuple(ask_parameter(name, after=now, optional=True) for name in wanted if vehicle.param(name) is None)
    return Plan("parameters", steps, "parameters read")


def ask_parameter(name: str, *, after: float, optional: bool = False) -> Step:
    """PARAM_REQUEST_READ by name, one of `message_cache.WATCHED`, until PARAM_VALUE comes. A name that the firmware
    does not know gets no answer."""
    return Step(
        f"read {name}",
        message=("PARAM_REQUEST_READ", {"param_id": name, "param_index": -1}),
        expect=ParamKnown(name, after),
        expect_s=OPTIONAL_WAIT_S if optional else PARAM_WAIT_S,
        optional=optional,
    )


def enter(vehicle: Vehicle) -> Plan:
    """Enter the mode that follows setpoints; they must be streaming already. Raises RefusedError."""
    number = guided_mode(vehicle)
    step = autopilot.mode_step(vehicle, number, skip_if_met=True)
    return Plan("control", (step,), f"following setpoints in {autopilot.mode_name(vehicle, number)}")


def leave(vehicle: Vehicle, back_to: int | None, now: float) -> Plan:
    """Restore the custom_mode from before. If that needs a transmitter, is the mode of setpoints itself, or is not
    known (None), hold instead: it is not known here whether a remote pilot is ready.

    If the vehicle has left the mode that follows setpoints, the plan has no steps: its mode was chosen by somebody
    else. Raises RefusedError if it has no mode that holds.
    """
    if not is_following(vehicle):
        return Plan("release", (), f"in {vehicle.mode}")
    if back_to is not None and autopilot.mode_name(vehicle, back_to) in FLIES_ITSELF:
        step = autopilot.mode_step(vehicle, back_to, or_disarmed=True)
        return Plan("release", (step,), f"back in {autopilot.mode_name(vehicle, back_to)}", despite_duplicate=True)
    hold = autopilot.hold(vehicle, now)
    return Plan("release", hold.steps, hold.done, despite_duplicate=True)
