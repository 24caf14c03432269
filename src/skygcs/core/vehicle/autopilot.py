"""Orders as PX4 and ArduPilot take them: all differences between the two are here. Pure: state in, plan out.

The messages of each order to a multirotor, and why:

    order     PX4                                          ArduCopter
    -------   ------------------------------------------   -------------------------------------------------------------
    mode      DO_SET_MODE 1, main, sub                     DO_SET_MODE 1, number
    takeoff   AUTO.LOITER, arm, NAV_TAKEOFF to AMSL,       GUIDED, arm, a position, NAV_TAKEOFF to a height above
              NaN yaw and place                            home, 0/0 (`takeoff_watch`)
    land      NAV_LAND                                     NAV_LAND
    rtl       NAV_RETURN_TO_LAUNCH                         NAV_RETURN_TO_LAUNCH
    hold      DO_REPOSITION without a position: pause      mode BRAKE, then GUIDED
    stop      the same                                     mode BRAKE
    goto      DO_REPOSITION as COMMAND_INT, AMSL,          the same, height above home; older than 4.1: GUIDED and
              changing the mode itself                     SET_POSITION_TARGET_GLOBAL_INT; a yaw is CONDITION_YAW

- PX4 refuses to arm in a manual mode without RC, and if it is armed in AUTO.MISSION or AUTO.TAKEOFF it flies off: a
  takeoff first sets AUTO.LOITER, from any other mode. Arming comes before NAV_TAKEOFF (PX4 accepts them in any order):
  a refused arming must not leave it in AUTO.TAKEOFF, where the next arming, from any station, would lift it off.
- ArduCopter's LOITER reads the throttle stick as climb rate: without RC it sinks. BRAKE stops as fast as possible and
  holds, in any flight mode, with or without RC, and ignores setpoints. But it counts as a piloted mode
  (ModeBrake::is_autopilot is false), in which the failsafe for a lost ground station does nothing while FS_OPTIONS has
  bit 4, as it has by default (events.cpp, failsafe_gcs_on_event; seen in flight). So `hold` goes on to GUIDED, which
  from another mode begins with velocity 0 and holds where it stops (ModeGuided::init). BRAKE comes first: a vehicle
  that is in GUIDED already ignores the mode change (Copter::set_mode) and would fly on to its target. A position target
  is not used: the position known here may be a second old, or be that of another vehicle with the same id.
  If telemetry is lost while orders still arrive, no answer to BRAKE comes and the vehicle would stay in it (seen in
  flight): SET_MODE GUIDED follows each repeat of BRAKE.
  `stop` stays in BRAKE, where no setpoints move the vehicle.
- PX4 holds in AUTO.LOITER; NAV_DLL_ACT acts there after COM_DL_LOSS_T unless COM_DLL_EXCEPT names that mode.
- PX4 flies a goto in AUTO.LOITER, and setting that mode again changes nothing: it would fly on (1.16.1, seen in
  flight: 25 m). DO_REPOSITION without position, height and yaw is its "pause vehicle" (navigator_main.cpp): it enters
  AUTO.LOITER from any mode, brakes, and stays where it stops. QGroundControl pauses with the same command.
- DO_REPOSITION is acknowledged by both; ArduCopter ignores its yaw (GCS_MAVLink_Copter.cpp, 4.1 to 4.7).
- A setpoint that was sent before a goto and arrives after it takes the goto's place in GUIDED, while PX4 ignores it in
  AUTO.LOITER: the target of an ArduCopter is requested after the acknowledgement (`order_plan.TargetProof`).
- land and rtl are the same command for both, so that one broadcast frame serves a mixed fleet.

Other classes have the modes and commands that `mavlink.vehicle_class` declares for them; refused: with the reason, see
`_why_not`:

    class            hold             stop             land             rtl              take-off      goto
    ---------------  ---------------  ---------------  ---------------  ---------------  ------------  ------------
    PX4 VTOL         as a multirotor  as a multirotor  as a multirotor  as a multirotor  as a m.       as a m.
    PX4 plane        AUTO.LOITER      AUTO.LOITER      as a multirotor  as a multirotor  as a m.       as a m.
    PX4 rover, boat  AUTO.LOITER      AUTO.LOITER      refused          as a multirotor  refused       as a m.
    ArduPlane        LOITER           LOITER           DO_LAND_START    RETURN_TO_LAUNCH TAKEOFF, arm  GUIDED
    QuadPlane        LOITER; hovering QLOITER          QLAND            the same;        as a m.       GUIDED; refused
                                                                        hovering QRTL                  while hovering
    Rover            HOLD             HOLD             refused          RETURN_TO_LAUNCH refused       GUIDED
    boat             LOITER           HOLD             refused          RETURN_TO_LAUNCH refused       GUIDED
    ArduSub          POSHOLD          POSHOLD          NAV_LAND         refused          refused       GUIDED
    Blimp            LOITER           LOITER           LAND             RTL              refused       refused
    AntennaTracker   STOP             STOP             refused          refused          refused       refused
    other, of PX4    AUTO.LOITER      AUTO.LOITER      as a multirotor  as a multirotor  refused       refused
    other            refused          refused          refused          RETURN_TO_LAUNCH refused       refused

- A fixed wing cannot stop: LOITER circles. A stop with the action "land" of a vehicle that cannot land stops it; one of
  a class that is not known gets NAV_LAND, which does nothing where it is not known.
- An ArduPlane of which neither Q_ENABLE nor a vtol_state is known yet is not sent off along the ground: it may be a
  QuadPlane. A build without QuadPlanes has no Q_ENABLE and answers no request for it; its vtol_state is undefined, as
  that of a QuadPlane never is (GCS_MAVLINK_Plane::vtol_state).
- ArduPlane has no command that takes off to a height (NAV_TAKEOFF is a QuadPlane's): its TAKEOFF mode climbs to
  TKOFF_ALT above where it stands and circles there (mode_takeoff.cpp). So a take-off to another height is refused. The
  mode comes first, as in no other one its throttle waits for the take-off (servos.cpp, Plane::suppress_throttle). If
  the arming fails it gets LOITER, but only once a heartbeat shows it disarmed (`gate.clear_undo`).
- A QuadPlane takes off by NAV_TAKEOFF in GUIDED to a height above where it stands
  (handle_command_MAV_CMD_NAV_TAKEOFF, QuadPlane::do_user_takeoff).
- A PX4 plane takes off to where its nose points, whatever place NAV_TAKEOFF names (control_auto_takeoff).
- ArduPlane has no NAV_LAND: DO_LAND_START goes to the landing of its mission, and is denied without one
  (GCS_MAVLINK_Plane::handle_command_int_packet, 4.7-dev). LOITER and RTL of a hovering QuadPlane fly on as a plane;
  QLOITER, QLAND and QRTL do not. Without sticks QLOITER sinks at 0.5 m/s (get_pilot_desired_climb_rate_cms). With
  Q_GUIDED_MODE 1 it holds in GUIDED, after QLOITER as an ArduCopter after BRAKE, and needs none (ModeGuided::_enter).
- What RTL of an ArduPlane does at its home, RTL_AUTOLAND and of a QuadPlane Q_RTL_MODE say
  (`vehicle_class.plane_return`); the outcome of the order says it.
- HOLD of a boat stops its motors, so that it drifts; LOITER keeps it where it is.
- Blimp accepts DO_REPOSITION and does nothing; ArduSub's NAV_LAND is its SURFACE (GCS_MAVLINK_Sub).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from skygcs.core.mavlink import mav_cmd, modes
from skygcs.core.mavlink.msgids import GLOBAL_POSITION_INT, POSITION_TARGET_GLOBAL_INT
from skygcs.core.mavlink.vehicle_class import TAKEOFF_HEIGHT, Landing, ReturnEnd, TakeOff, VehicleClass
from skygcs.core.protocols.command import CommandSpec, Location
from skygcs.core.vehicle.order_plan import (
    LIFT_OFF_S,
    RUN_S,
    ArmedIs,
    HasPosition,
    LiftedOff,
    ModeIn,
    Plan,
    Step,
    TargetProof,
)
from skygcs.core.vehicle.setpoint import ALL, position_target_mask
from skygcs.core.vehicle.stick_modes import hazard
from skygcs.core.vehicle.takeoff_watch import ClimbTo, StandsSinceArming
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import model_of
from skygcs.errors import NotReadyError, RefusedError
from skygcs.spelling import rounded

FORCE_ARM_MAGIC = 21196.0
"""param2 of COMPONENT_ARM_DISARM: arms without checks, disarms in the air."""

FORCE_REBOOT_MAGIC = 20190226.0
"""param6 of PREFLIGHT_REBOOT_SHUTDOWN: ArduPilot reboots even when armed. PX4 refuses it."""

FRAME_GLOBAL = 0
FRAME_GLOBAL_RELATIVE_ALT = 3
FRAME_GLOBAL_RELATIVE_ALT_INT = 6

ESTIMATE_S = 1.0
"""Time for the answer to one request for its estimator status; the next attempt requests it again."""

CHANGE_MODE = 1.0
"""MAV_DO_REPOSITION_FLAGS_CHANGE_MODE."""

NAN = math.nan


@dataclass(frozen=True, slots=True)
class Destination:
    """A position to fly to, with the height in both references: PX4 takes AMSL, ArduCopter the height above home."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    height_m: float
    yaw_deg: float | None = None


def set_mode(vehicle: Vehicle, name: str) -> Plan:
    """Raises RefusedError for a mode the vehicle's firmware does not have, naming near ones."""
    try:
        number = modes.mode_number(vehicle.autopilot, vehicle.mode_type, name)
    except KeyError as error:
        raise RefusedError(str(error.args[0])) from None
    step = mode_step(vehicle, number)
    return Plan("mode", (step,), f"mode {mode_name(vehicle, number)}")


def copter_mode(vehicle: Vehicle, name: str) -> str | None:
    """The mode of a copter that goes by this name, by the name under which it is reported; None: it has none."""
    if vehicle.kind is not VehicleClass.COPTER:
        return None
    try:
        return mode_name(vehicle, modes.mode_number(vehicle.autopilot, vehicle.mode_type, name))
    except KeyError:
        return None


def arm(*, force: bool = False) -> Plan:
    return Plan("arm", (_arm_step(force=force),), "armed")


def arm_to_fly(vehicle: Vehicle, now: float, estimate_msgid: int) -> Plan:
    """`arm`, once the estimator has a position: an ArduCopter arms in STABILIZE without one, and then refuses the
    takeoff. PX4's own checks cover this. ``estimate_msgid``: msgid of EKF_STATUS_REPORT."""
    copter = vehicle.family == "ardupilot" and vehicle.kind is VehicleClass.COPTER
    if not copter or vehicle.armed or HasPosition().met(vehicle, now):
        return arm()
    ask = CommandSpec(mav_cmd.REQUEST_MESSAGE, (float(estimate_msgid),))
    known = Step("position", ask, expect=HasPosition(), expect_s=ESTIMATE_S, skip_if_met=True)
    return Plan("arm", (known, _arm_step()), "armed")


def disarm(*, force: bool = False) -> Plan:
    """Disarm; with a duplicate system id only once that is confirmed (`orders.require_confirmed`)."""
    spec = CommandSpec(mav_cmd.COMPONENT_ARM_DISARM, (0.0, FORCE_ARM_MAGIC if force else 0.0))
    step = Step("disarm", spec, expect=ArmedIs(False))
    return Plan("disarm", (step,), "disarmed", emergency=force, final=force, despite_duplicate=True)


def takeoff(vehicle: Vehicle, height_m: float, alt_amsl_m: float | None) -> Plan:
    """``alt_amsl_m``: altitude of the ground the vehicle stands on. Raises RefusedError for a class without this order,
    and for an ArduPlane whose own height of take-off is another one."""
    how = vehicle.abilities.takeoff
    if how is TakeOff.NONE:
        raise RefusedError(_why_not(vehicle, "take off"))
    if alt_amsl_m is None:
        raise NotReadyError("its position is not known yet, and a height counts from the ground it stands on")
    if how is TakeOff.OWN_HEIGHT:
        steps = _plane_takeoff(vehicle, height_m, alt_amsl_m)
    elif how is TakeOff.BY_ROTORS:
        steps = _quadplane_takeoff(vehicle, height_m, alt_amsl_m)
    else:
        climb = _copter_takeoff if vehicle.family == "ardupilot" else _px4_takeoff
        steps = climb(vehicle, height_m, alt_amsl_m)
    return Plan("takeoff", steps, f"taking off to {rounded(height_m)} m")


TAKEOFF_MODES: Mapping[str, str] = {"px4": "AUTO.LOITER", "ardupilot": "GUIDED"}
"""The mode that a take-off sets before it arms, from any other one; a plan does the same."""


def takes_off_from(family: str, mode: str) -> str | None:
    """The mode that a take-off changes to first, where a vehicle that is to take off would not arm in its present mode;
    None: it would arm, as far as the mode is concerned. A PX4 in OFFBOARD arms only while somebody sends setpoints."""
    not_armable = modes.PX4_NOT_ARMABLE | {"OFFBOARD"} if family == "px4" else modes.COPTER_NOT_ARMABLE | {"AUTO"}
    return TAKEOFF_MODES.get(family) if mode in not_armable else None


def can_land(vehicle: Vehicle) -> bool:
    """False for a class that is known to have no landing; of another one NAV_LAND is worth an attempt."""
    return vehicle.abilities.landing is not Landing.NONE


def land(vehicle: Vehicle, now: float) -> Plan:
    """Land where it is. Raises RefusedError for a class that cannot."""
    able = vehicle.abilities
    if not able.lands:
        raise RefusedError(_why_not(vehicle, "land"))
    if able.landing is Landing.MISSION:
        start = CommandSpec(mav_cmd.DO_LAND_START)
        step = Step("land", start, expect=_any_mode(vehicle, ("AUTO",)), refused=NO_LANDING_IN_MISSION)
        return Plan("land", (step,), "landing by its mission", despite_duplicate=True)
    if able.landing is Landing.MODE:
        return Plan(
            "land", (_named_mode(vehicle, able.land_mode),), f"landing in {able.land_mode}", despite_duplicate=True
        )
    return land_by_command(vehicle)


def land_by_command(vehicle: Vehicle) -> Plan:
    """NAV_LAND, whatever its class is."""
    wanted = {"px4": ("AUTO.LAND", "AUTO.PRECLAND"), "ardupilot": ("LAND", "SURFACE")}
    expect = _any_mode(vehicle, wanted.get(vehicle.family, ()))
    step = Step("land", CommandSpec(mav_cmd.NAV_LAND, (0.0,) * 7), expect=expect)
    return Plan("land", (step,), "landing", despite_duplicate=True)


NO_LANDING_IN_MISSION = "ArduPlane lands by its mission, and that has no DO_LAND_START; rtl circles over its home"


def rtl(vehicle: Vehicle, now: float) -> Plan:
    """Return to its home. Raises RefusedError for a class that cannot."""
    able = vehicle.abilities_now(now)
    if not able.returns:
        raise RefusedError(_why_not(vehicle, "return"))
    ends = vehicle.return_rule(now)
    then = "" if ends.end is ReturnEnd.LANDS or vehicle.family == "generic" else f"; {ends}"
    if able.return_mode:
        step = _named_mode(vehicle, able.return_mode)
        return Plan("rtl", (step,), f"returning in {able.return_mode}{then}", despite_duplicate=True)
    wanted = {"px4": ("AUTO.RTL",), "ardupilot": ("RTL", "SMART_RTL", "QRTL", "AUTO_RTL")}
    expect = _any_mode(vehicle, wanted.get(vehicle.family, ()))
    step = Step("rtl", CommandSpec(mav_cmd.NAV_RETURN_TO_LAUNCH), expect=expect)
    return Plan("rtl", (step,), f"returning to launch{then}", despite_duplicate=True)


def hold(vehicle: Vehicle, now: float) -> Plan:
    """Stop and hold, in a mode in which the failsafe for a lost ground station still acts. Raises RefusedError if the
    firmware has no such mode."""
    mode = vehicle.abilities.hold_mode
    if mode and vehicle.kind is not VehicleClass.COPTER:
        step = _named_mode(vehicle, mode, refused="it needs a position to keep; stop switches its motors off")
        return Plan("hold", (step,), f"holding in {mode}", despite_duplicate=True)
    braked = brake(vehicle, now)
    by_rotors = stays_on_rotors(vehicle, now)
    if not mode and not by_rotors:
        return braked
    (first,) = braked.steps
    guided = modes.mode_number(vehicle.autopilot, vehicle.mode_type, "GUIDED")
    stays = mode_step(vehicle, guided, or_disarmed=True)
    unheard = ("SET_MODE", {"base_mode": modes.CUSTOM_MODE_ENABLED, "custom_mode": guided})
    steps = (
        replace(first, expect_s=0, refused=NO_HOLD, with_repeats=unheard),
        replace(stays, refused=braked.done if by_rotors else f"{IN_BRAKE}: {BRAKE_NOTE}"),
    )
    return Plan("hold", steps, "holding in GUIDED", despite_duplicate=True)


def stays_on_rotors(vehicle: Vehicle, now: float) -> bool:
    """True for a hovering QuadPlane that is known to stay on its rotors in GUIDED."""
    return vehicle.hovers(now) and vehicle.on_rotors_in_guided


NO_HOLD = "it needs a position to hold, and it does nothing else instead: land it, or fly it by transmitter"
BRAKE_NOTE = "its failsafe for a lost ground station does nothing in BRAKE while FS_OPTIONS has bit 4 (16)"
IN_BRAKE = "it holds in BRAKE"


def brake(vehicle: Vehicle, now: float) -> Plan:
    """Stop, hold and ignore setpoints; a fixed wing circles. Raises RefusedError if the firmware has no such mode."""
    able = vehicle.abilities_now(now)
    wanted = able.stop_mode
    if not wanted:
        raise RefusedError(_why_not(vehicle, "hold its position"))
    number = modes.mode_number(vehicle.autopilot, vehicle.mode_type, wanted)
    step = mode_step(vehicle, number, or_disarmed=True)
    if vehicle.family == "px4":
        pause = CommandSpec(mav_cmd.DO_REPOSITION, (-1.0, CHANGE_MODE, 0.0, NAN, NAN, NAN, NAN))
        # AUTO.LOITER is also the mode of a goto: then only the acknowledgement shows that the goto has ended.
        expect = None if vehicle.custom_mode == number else step.expect
        step = Step("pause", pause, expect=expect, instead=(step,))
    radius_m = vehicle.hold_radius_m(now)
    done = f"holding in {wanted}"
    if able.circles and radius_m and vehicle.under_way(now):
        done = f"circling in {wanted}, {rounded(radius_m)} m about where it was"
    elif (danger := hazard(model_of(vehicle, now), number)) is not None:
        done = f"stopped; {danger}" + ("; land or rtl needs no sticks" if able.lands and able.returns else "")
    return Plan("hold", (step,), done, despite_duplicate=True)


def _why_not(vehicle: Vehicle, what: str) -> str:
    """The refusal of an order that its class has not, or that skygcs does not know of it, and what to do instead."""
    firmware, kind, able = firmware_name(vehicle), vehicle.kind, vehicle.abilities
    if kind is VehicleClass.OTHER:
        shown = vehicle.enum_name("MAV_TYPE", vehicle.type).lower().replace("_", " ")
        return f"skygcs does not know how a {shown} of {firmware} is to {what}; use a raw command"
    if vehicle.family == "generic":
        return f"skygcs knows only PX4 and ArduPilot, not how {firmware} is to {what}; use a raw command"
    moves = "goto or mission start moves it" if able.goes else "mission start moves it"
    instead = {"take off": moves, "land": "hold or stop it", "return": "goto its home, or hold it" if able.goes else ""}
    hint = instead.get(what, "")
    return f"a {kind} of {firmware} does not {what}" + (f"; {hint}" if hint else "")


def goto(vehicle: Vehicle, to: Destination) -> Plan:
    """Go to a place and hold there. Raises RefusedError for a class that cannot."""
    done = f"going to {to.lat_deg:.7f}, {to.lon_deg:.7f}, {to.height_m:.1f} m"
    if not vehicle.abilities.goes:
        raise RefusedError(_why_not(vehicle, "go to a place"))
    if vehicle.family == "px4":
        yaw = NAN if to.yaw_deg is None else math.radians(to.yaw_deg)
        spec = CommandSpec(
            mav_cmd.DO_REPOSITION, (-1.0, CHANGE_MODE, 0.0, yaw), _location(FRAME_GLOBAL, to, to.alt_amsl_m)
        )
        expect = _any_mode(vehicle, ("AUTO.LOITER",), or_disarmed=False)
        return Plan("goto", (Step("goto", spec, expect=expect),), done)
    guided = modes.mode_number(vehicle.autopilot, vehicle.mode_type, "GUIDED")
    location = _location(FRAME_GLOBAL_RELATIVE_ALT, to, to.height_m)
    reposition = Step(
        "goto",
        CommandSpec(mav_cmd.DO_REPOSITION, (-1.0, CHANGE_MODE, 0.0, NAN), location),
        expect=ModeIn(frozenset({guided})),
        instead=_guided_target(vehicle, guided, to),
        proof=_target_proof(guided, to, location) if vehicle.abilities.setpoints else None,
    )
    if to.yaw_deg is None:
        return Plan("goto", (reposition,), done)
    turn = Step("yaw", CommandSpec(mav_cmd.CONDITION_YAW, (to.yaw_deg % 360.0, 0.0, 0.0, 0.0)), expect_s=0)
    return Plan("goto", (reposition, turn), done)


def reboot(vehicle: Vehicle, *, force: bool = False) -> Plan:
    magic = FORCE_REBOOT_MAGIC if force and vehicle.family == "ardupilot" else 0.0
    spec = CommandSpec(mav_cmd.PREFLIGHT_REBOOT_SHUTDOWN, (1.0, 0.0, 0.0, 0.0, 0.0, magic, 0.0))
    return Plan("reboot", (Step("reboot", spec),), "rebooting")


def set_home(place: Destination | None) -> Plan:
    """The plan that sets home to a place; None: to the vehicle's present position."""
    if place is None:
        spec = CommandSpec(mav_cmd.DO_SET_HOME, (1.0,))
    else:
        spec = CommandSpec(mav_cmd.DO_SET_HOME, (0.0, 0.0, 0.0, 0.0), _location(FRAME_GLOBAL, place, place.alt_amsl_m))
    return Plan("home", (Step("set home", spec),), "home set")


def message_interval(msgid: int, rate_hz: float | None, *, refused: str = "") -> Plan:
    """``rate_hz``: 0 turns the message off, None restores the vehicle's default."""
    interval_us = 0.0 if rate_hz is None else -1.0 if rate_hz == 0 else round(1e6 / rate_hz)
    done = "default rate" if rate_hz is None else f"{rate_hz:g} Hz" if rate_hz else "off"
    step = Step("interval", CommandSpec(mav_cmd.SET_MESSAGE_INTERVAL, (float(msgid), interval_us)), refused=refused)
    return Plan("interval", (step,), done)


def firmware_name(vehicle: Vehicle) -> str:
    """The firmware's name in messages to the user."""
    return {"px4": "PX4", "ardupilot": "ArduPilot"}.get(vehicle.family, "its autopilot")


def arms(spec: CommandSpec) -> bool:
    """True for the command that arms."""
    return spec.command == mav_cmd.COMPONENT_ARM_DISARM and spec.params[:1] != (0.0,)


def _arm_step(*, force: bool = False, skip_if_met: bool = False) -> Step:
    spec = CommandSpec(mav_cmd.COMPONENT_ARM_DISARM, (1.0, FORCE_ARM_MAGIC if force else 0.0))
    undo = Step("disarm again", CommandSpec(mav_cmd.COMPONENT_ARM_DISARM, (0.0, 0.0)), expect=ArmedIs(False))
    return Step("arm", spec, expect=ArmedIs(True), skip_if_met=skip_if_met, undo=undo)


def mode_step(vehicle: Vehicle, number: int, *, or_disarmed: bool = False, skip_if_met: bool = False) -> Step:
    """DO_SET_MODE to a custom_mode; the heartbeat confirms it."""
    if vehicle.family == "px4":
        params = (float(modes.CUSTOM_MODE_ENABLED), float(number >> 16 & 0xFF), float(number >> 24 & 0xFF))
    else:
        params = (float(modes.CUSTOM_MODE_ENABLED), float(number), 0.0)
    expect = ModeIn(frozenset({number}), or_disarmed)
    name = f"mode {mode_name(vehicle, number)}"
    spec = CommandSpec(mav_cmd.DO_SET_MODE, params, answers_twice=vehicle.family == "px4")
    return Step(name, spec, expect=expect, skip_if_met=skip_if_met)


def with_undo(vehicle: Vehicle, mode: Step) -> Step:
    """The step to a mode in which an armed vehicle moves off, with its undo: the mode that stops its class. It is never
    the mode before: that may be one flown by sticks, and what moved off all the same would fly in it."""
    stops = vehicle.abilities.stop_mode
    if not stops:
        return mode
    number = modes.mode_number(vehicle.autopilot, vehicle.mode_type, stops)
    return replace(mode, undo=replace(mode_step(vehicle, number), name=f"put it in {stops}"))


def mode_name(vehicle: Vehicle, number: int) -> str:
    """Name of a custom_mode in this vehicle's firmware."""
    return modes.mode_name(vehicle.autopilot, vehicle.mode_type, modes.CUSTOM_MODE_ENABLED, number)


def _named_mode(vehicle: Vehicle, name: str, *, refused: str = "") -> Step:
    """The step to a mode of its class, by its name; shown by a heartbeat, or by its disarming."""
    number = modes.mode_number(vehicle.autopilot, vehicle.mode_type, name)
    return replace(mode_step(vehicle, number, or_disarmed=True), refused=refused)


def _any_mode(vehicle: Vehicle, names: tuple[str, ...], *, or_disarmed: bool = True) -> ModeIn | None:
    known = set(modes.mode_names(vehicle.autopilot, vehicle.mode_type))
    numbers = {modes.mode_number(vehicle.autopilot, vehicle.mode_type, n) for n in names if n in known}
    return ModeIn(frozenset(numbers), or_disarmed) if numbers else None


def _location(frame: int, to: Destination, alt_m: float) -> Location:
    return Location(frame, round(to.lat_deg * 1e7), round(to.lon_deg * 1e7), alt_m)


def _px4_takeoff(vehicle: Vehicle, height_m: float, from_amsl_m: float) -> tuple[Step, ...]:
    rise_s = RUN_S if vehicle.abilities.takeoff is TakeOff.CLIMB_OUT else LIFT_OFF_S
    steps = (_arm_step(skip_if_met=True), _climb_step(from_amsl_m, ClimbTo(height_m), rise_s))
    if vehicle.armed:
        return steps
    return (mode_step(vehicle, modes.px4_custom_mode(TAKEOFF_MODES["px4"]), skip_if_met=True), *steps)


def _copter_takeoff(vehicle: Vehicle, height_m: float, from_amsl_m: float) -> tuple[Step, ...]:
    request = CommandSpec(mav_cmd.REQUEST_MESSAGE, (float(GLOBAL_POSITION_INT),))
    return (
        mode_step(vehicle, modes.copter_mode_number(TAKEOFF_MODES["ardupilot"]), skip_if_met=True),
        _arm_step(skip_if_met=True),
        Step("position", request, expect=StandsSinceArming(), skip_if_met=True),
        _climb_step(from_amsl_m, ClimbTo(height_m)),
    )


def _plane_takeoff(vehicle: Vehicle, height_m: float, from_amsl_m: float) -> tuple[Step, ...]:
    if not vehicle.rotors_known:
        raise NotReadyError(
            "it is not known yet whether it is a QuadPlane, which would be run along the ground: neither Q_ENABLE nor "
            "EXTENDED_SYS_STATE has come since it started"
        )
    own_m = vehicle.param(TAKEOFF_HEIGHT)
    if own_m is None:
        raise NotReadyError(f"its {TAKEOFF_HEIGHT}, the height to which it takes off, is not known yet")
    if abs(own_m - height_m) > SAME_HEIGHT_M:
        raise RefusedError(
            f"a plane of ArduPilot takes off to its {TAKEOFF_HEIGHT} ({rounded(own_m)} m), not to "
            f"{rounded(height_m)} m: order that height, or set the parameter"
        )
    mode = _named_mode(vehicle, "TAKEOFF")
    off = LiftedOff(from_amsl_m)
    if vehicle.armed:
        return (replace(mode, expect=off, expect_s=RUN_S),)
    rises = Step("takeoff", CommandSpec(mav_cmd.REQUEST_MESSAGE, (float(GLOBAL_POSITION_INT),)), expect=off)
    return (with_undo(vehicle, mode), _arm_step(), replace(rises, expect_s=RUN_S))


def _quadplane_takeoff(vehicle: Vehicle, height_m: float, from_amsl_m: float) -> tuple[Step, ...]:
    guided = modes.mode_number(vehicle.autopilot, vehicle.mode_type, "GUIDED")
    rise = CommandSpec(mav_cmd.NAV_TAKEOFF, (*(0.0,) * 6, height_m))
    return (
        mode_step(vehicle, guided, skip_if_met=True),
        _arm_step(skip_if_met=True),
        Step("takeoff", rise, expect=LiftedOff(from_amsl_m), expect_s=LIFT_OFF_S),
    )


SAME_HEIGHT_M = 0.5
"""Heights of a take-off this near are one."""


def _climb_step(from_amsl_m: float, climb: ClimbTo, expect_s: float = LIFT_OFF_S) -> Step:
    anyhow = CommandSpec(mav_cmd.NAV_TAKEOFF)
    return Step("takeoff", anyhow, late=climb, expect=LiftedOff(from_amsl_m), expect_s=expect_s)


def _target_proof(guided: int, to: Destination, location: Location | None = None) -> TargetProof:
    """``location``: of a DO_REPOSITION. It is repeated without CHANGE_MODE: in another mode than GUIDED, which its
    pilot may have chosen a moment ago, an ArduCopter denies that (GCS_MAVLINK_Copter,
    handle_command_int_do_reposition).
    """
    request = CommandSpec(mav_cmd.REQUEST_MESSAGE, (float(POSITION_TARGET_GLOBAL_INT),))
    again = None if location is None else CommandSpec(mav_cmd.DO_REPOSITION, (-1.0, 0.0, 0.0, NAN), location)
    return TargetProof(to.lat_deg, to.lon_deg, to.alt_amsl_m, guided, request, again)


def _guided_target(vehicle: Vehicle, guided: int, to: Destination) -> tuple[Step, ...]:
    """Target for firmware without DO_REPOSITION. The message has no acknowledgement."""
    yaw = to.yaw_deg
    values = {
        "coordinate_frame": FRAME_GLOBAL_RELATIVE_ALT_INT,
        "type_mask": position_target_mask(pos=ALL, yaw=yaw is not None),
        "lat_int": round(to.lat_deg * 1e7),
        "lon_int": round(to.lon_deg * 1e7),
        "alt": to.height_m,
        "yaw": 0.0 if yaw is None else math.radians(yaw),
    }
    message = ("SET_POSITION_TARGET_GLOBAL_INT", values)
    return (
        mode_step(vehicle, guided, skip_if_met=True),
        Step("goto", message=message, expect_s=0, proof=_target_proof(guided, to)),
    )
