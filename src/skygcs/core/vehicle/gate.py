"""The outgoing gate: what of our own may be sent to which vehicle. Pure.

Everything of our own passes it before it becomes bytes. It is an allow list:

    level       a vehicle known to be disarmed   any other vehicle            nothing is known of the target
    ---------   ------------------------------   --------------------------   ------------------------------
    harmless    passes                           passes                       passes
    disarmed    passes                           passes if somebody insists   passes if somebody insists
    force       passes if somebody insists       passes if somebody insists   passes if somebody insists
    never       refused                          refused                      refused

A message or a command that no table here names is of the level "disarmed": what skygcs does not know to be harmless,
a flying vehicle does not get. "Known to be disarmed" is `VehicleModel.not_disarmed`.

An order is a row of `ORDERS`: its own checks decide for which vehicle it is planned (`orders`, `autopilot`), and the
row says which messages and commands it may send. The gate gives it a `Clearance` for exactly these; no other module can
make one, and what is sent without one is judged as a raw message (`OutgoingGate`). A step that undoes another one
passes again when it is sent (`clear_undo`). Modes that are flown by sticks have rules of their own (`stick_modes`),
whatever sends them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from skygcs.core.mavlink import mav_cmd, modes
from skygcs.core.params.names import EFFECTS, ParamRole, role_of
from skygcs.core.vehicle.order_plan import Plan, Step
from skygcs.core.vehicle.orders import FORCE_HINT
from skygcs.core.vehicle.stick_modes import mode_name, mode_refusal, without_sticks
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import VehicleModel, model_of
from skygcs.errors import RefusedError
from skygcs.events import Event


class Level(StrEnum):
    """Level of a message: which vehicles may get it; see the table."""

    HARMLESS = "harmless"
    DISARMED = "only disarmed"
    FORCE = "needs force"
    NEVER = "refused"


COMMAND_MESSAGES = frozenset({"COMMAND_LONG", "COMMAND_INT"})
PARAM_MESSAGES = frozenset({"PARAM_SET", "PARAM_EXT_SET"})

HARMLESS_MESSAGES = frozenset(
    {
        # reading, and questions
        *("PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "PARAM_EXT_REQUEST_READ", "PARAM_EXT_REQUEST_LIST"),
        *("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_REQUEST_LIST", "MISSION_REQUEST_PARTIAL_LIST"),
        *("MISSION_ACK", "FENCE_FETCH_POINT", "RALLY_FETCH_POINT", "AUTOPILOT_VERSION_REQUEST", "TERRAIN_CHECK"),
        *("LOG_REQUEST_LIST", "LOG_REQUEST_END", "GOPRO_GET_REQUEST", "UAVIONIX_ADSB_GET"),
        *("PING", "TIMESYNC", "REQUEST_DATA_STREAM"),
        # texts, lights, sounds, cameras and gimbals
        *("STATUSTEXT", "LED_CONTROL", "PLAY_TUNE", "DIGICAM_CONTROL", "MOUNT_CONTROL", "GIMBAL_CONTROL"),
        *("GIMBAL_MANAGER_SET_ATTITUDE", "GIMBAL_MANAGER_SET_PITCHYAW", "GIMBAL_MANAGER_SET_MANUAL_CONTROL"),
        *("GIMBAL_DEVICE_SET_ATTITUDE", "GOPRO_SET_REQUEST", "CAMERA_TRIGGER"),
        # who and where the operator is
        *("OPEN_DRONE_ID_OPERATOR_ID", "OPEN_DRONE_ID_SELF_ID", "OPEN_DRONE_ID_SYSTEM"),
        "OPEN_DRONE_ID_SYSTEM_UPDATE",
    }
)
"""Messages that change nothing that is flown, whatever they say. Not HEARTBEAT: one that somebody else times keeps the
failsafe for a lost ground station from acting. Not ADSB_VEHICLE: it makes a vehicle evade."""

HARMLESS_COMMANDS = frozenset(
    {
        # reading, and questions
        *(*mav_cmd.QUESTIONS, mav_cmd.GET_MESSAGE_INTERVAL, mav_cmd.SET_MESSAGE_INTERVAL),
        *(mav_cmd.DO_SEND_BANNER, mav_cmd.RUN_PREARM_CHECKS),
        # cameras, gimbals, lights
        *(mav_cmd.DO_CONTROL_VIDEO, mav_cmd.DO_DIGICAM_CONFIGURE, mav_cmd.DO_DIGICAM_CONTROL),
        *(mav_cmd.DO_MOUNT_CONFIGURE, mav_cmd.DO_MOUNT_CONTROL, mav_cmd.DO_SET_CAM_TRIGG_DIST),
        *(mav_cmd.DO_SET_CAM_TRIGG_INTERVAL, mav_cmd.DO_TRIGGER_CONTROL, mav_cmd.DO_GIMBAL_MANAGER_PITCHYAW),
        *(mav_cmd.DO_GIMBAL_MANAGER_CONFIGURE, mav_cmd.SET_CAMERA_MODE, mav_cmd.SET_CAMERA_ZOOM),
        *(mav_cmd.SET_CAMERA_FOCUS, mav_cmd.SET_CAMERA_SOURCE, mav_cmd.IMAGE_START_CAPTURE),
        *(mav_cmd.IMAGE_STOP_CAPTURE, mav_cmd.VIDEO_START_CAPTURE, mav_cmd.VIDEO_STOP_CAPTURE),
        *(mav_cmd.VIDEO_START_STREAMING, mav_cmd.VIDEO_STOP_STREAMING, mav_cmd.ILLUMINATOR_ON_OFF),
        # they bring a vehicle down or home safely
        *(mav_cmd.NAV_RETURN_TO_LAUNCH, mav_cmd.NAV_LAND, mav_cmd.NAV_LAND_LOCAL, mav_cmd.NAV_VTOL_LAND),
    }
)

TURNS_MOTORS: Mapping[int, str] = {
    mav_cmd.NAV_TAKEOFF: "takeoff",  # a disarmed PX4 keeps it and lifts off with the next arming
    mav_cmd.NAV_TAKEOFF_LOCAL: "takeoff",
    mav_cmd.NAV_VTOL_TAKEOFF: "takeoff",
    mav_cmd.DO_MOTOR_TEST: "",
    mav_cmd.DO_AUX_FUNCTION: "arm, disarm and mode",  # its functions arm, stop motors and change modes
    mav_cmd.MISSION_START: "mission start",
    mav_cmd.ACTUATOR_TEST: "",
    mav_cmd.SOLO_BTN_FLY_CLICK: "arm and takeoff",
    mav_cmd.SOLO_BTN_FLY_HOLD: "takeoff",
    mav_cmd.SOLO_BTN_PAUSE_CLICK: "hold",
}
"""Commands of the level "force", and the checked order. Arming and a mode with the arming bit belong to them, see
`command_rule` and `message_rule`."""

_SIMULATORS = "it belongs between a simulator and its autopilot"
NEVER_MESSAGES: Mapping[str, str] = {
    **dict.fromkeys(("HIL_ACTUATOR_CONTROLS", "HIL_CONTROLS", "HIL_STATE", "HIL_STATE_QUATERNION"), _SIMULATORS),
    **dict.fromkeys(("HIL_SENSOR", "HIL_GPS", "HIL_OPTICAL_FLOW", "HIL_RC_INPUTS_RAW"), _SIMULATORS),
    "SETUP_SIGNING": "a signing key is not sent as a message: use signing.setup (skygcs-cli signing setup)",
}

_CONTROL = "control set and setpoint (control set raw for attitude, body rates and accelerations)"
MESSAGE_ORDERS: Mapping[str, str] = {
    **dict.fromkeys(("SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED"), _CONTROL),
    **dict.fromkeys(("SET_POSITION_TARGET_GLOBAL_INT", "SET_ACTUATOR_CONTROL_TARGET", "MANUAL_CONTROL"), _CONTROL),
    **dict.fromkeys(("RC_CHANNELS_OVERRIDE", "FOLLOW_TARGET", "TRAJECTORY_REPRESENTATION_WAYPOINTS"), _CONTROL),
    "TRAJECTORY_REPRESENTATION_BEZIER": _CONTROL,
    "SET_MODE": "mode",
    "SET_GPS_GLOBAL_ORIGIN": "origin push",
    "SET_HOME_POSITION": "home",
    **dict.fromkeys(("MISSION_ITEM", "MISSION_ITEM_INT", "MISSION_COUNT"), "mission upload"),
    "MISSION_WRITE_PARTIAL_LIST": "mission upload",
    "MISSION_CLEAR_ALL": "mission clear",
    "MISSION_SET_CURRENT": "mission item",
    **dict.fromkeys(("SAFETY_SET_ALLOWED_AREA", "FENCE_POINT"), "fence set"),
    "PARAM_SET": "param set",
    "GPS_RTCM_DATA": "corrections",
    **dict.fromkeys(("LOG_REQUEST_DATA", "LOG_ERASE"), "logs"),
    "SERIAL_CONTROL": "shell",
    "HEARTBEAT": "the daemon's own heartbeat",
}
"""The checked order beside a raw message, for the refusal."""

COMMAND_ORDERS: Mapping[int, str] = {
    **dict.fromkeys((mav_cmd.DO_FOLLOW, mav_cmd.DO_FOLLOW_REPOSITION, mav_cmd.DO_ORBIT, mav_cmd.DO_REPOSITION), "goto"),
    **dict.fromkeys((mav_cmd.CONDITION_CHANGE_ALT, mav_cmd.CONDITION_YAW, mav_cmd.DO_CHANGE_ALTITUDE), "goto"),
    **dict.fromkeys((mav_cmd.DO_FIGURE_EIGHT, mav_cmd.DO_GO_AROUND, mav_cmd.OVERRIDE_GOTO), "goto"),
    **dict.fromkeys((mav_cmd.GUIDED_CHANGE_SPEED, mav_cmd.GUIDED_CHANGE_ALTITUDE), "goto"),
    **dict.fromkeys((mav_cmd.GUIDED_CHANGE_HEADING, mav_cmd.PAYLOAD_PREPARE_DEPLOY), "goto"),
    **dict.fromkeys((mav_cmd.DO_SET_MODE, mav_cmd.NAV_GUIDED_ENABLE, mav_cmd.DO_AUTOTUNE_ENABLE), "mode"),
    mav_cmd.DO_PAUSE_CONTINUE: "hold",
    mav_cmd.DO_SET_HOME: "home",
    **dict.fromkeys((mav_cmd.DO_FLIGHTTERMINATION, mav_cmd.DO_PARACHUTE), "stop kill"),
    mav_cmd.DO_LAND_START: "land",
    mav_cmd.DO_FENCE_ENABLE: "fence set",
    mav_cmd.PREFLIGHT_STORAGE: "param set",  # also resets all parameters
    mav_cmd.PREFLIGHT_CALIBRATION: "calibrate",
    mav_cmd.DO_START_MAG_CAL: "calibrate",
    mav_cmd.PREFLIGHT_REBOOT_SHUTDOWN: "reboot",
    mav_cmd.COMPONENT_ARM_DISARM: "disarm",
    mav_cmd.DO_SET_MISSION_CURRENT: "mission item",
}
"""The checked order beside a raw command."""

MISSION_ITEMS = range(mav_cmd.NAV_WAYPOINT, mav_cmd.NAV_LAST + 1)

FTP_READS = frozenset({0, 1, 2, 3, 4, 5, 14, 15})
"""Operations of FILE_TRANSFER_PROTOCOL that change no file: none, terminate, reset, list, open to read, read, checksum,
burst read (MAVLink FTP, opcodes)."""
FTP_OPCODE_AT = 3
"""Offset of the opcode in its payload."""


@dataclass(frozen=True, slots=True)
class Rule:
    """The level of one thing. ``what``: the thing; ``instead``: the checked order, "" for none; ``why``: of "never"."""

    level: Level
    what: str
    instead: str = ""
    why: str = ""

    def refusal(self, models: Iterable[VehicleModel], *, force: bool) -> str | None:
        """Why it is not sent to these vehicles (possibly none is known); None: it may be."""
        if self.level is Level.HARMLESS:
            return None
        if self.level is Level.NEVER:
            return f"{self.what} is never sent: {self.why}"
        if force:
            return None
        if self.level is Level.FORCE:
            return self._text("can turn motors")
        found = list(models)
        if not found:
            return self._text("would reach a system that is not known to be disarmed")
        for model in found:
            if model.not_disarmed is not None:
                return self._text(f"would reach {model.name}, which {model.not_disarmed},")
        return None

    def _text(self, why: str) -> str:
        remedy = f"the checked order is {self.instead}" if self.instead else "no order does this"
        return f"{self.what} {why} without the checks of an order: {remedy}; {FORCE_HINT}"


def message_rule(name: str, fields: Mapping[str, Any], family: str = "") -> Rule:
    """The rule for a raw message. ``family``: of the vehicle that gets it, for parameters; "": any."""
    if name in COMMAND_MESSAGES:
        number = _whole(fields.get("command", 0))
        return command_rule(number, _number(fields.get("param1", 0.0)), f"{name} {number}")
    if name in HARMLESS_MESSAGES:
        return Rule(Level.HARMLESS, name)
    if name in NEVER_MESSAGES:
        return Rule(Level.NEVER, name, why=NEVER_MESSAGES[name])
    if name in PARAM_MESSAGES:
        return param_rule(family, _text(fields.get("param_id", "")), name)
    if name == "SET_MODE" and _whole(fields.get("base_mode", 0)) & modes.SAFETY_ARMED:
        return Rule(Level.FORCE, f"{name} with the arming bit", "arm")
    if name == "FILE_TRANSFER_PROTOCOL" and _opcode(fields.get("payload")) in FTP_READS:
        return Rule(Level.HARMLESS, name)
    return Rule(Level.DISARMED, name, MESSAGE_ORDERS.get(name, ""))


def command_rule(number: int, param1: float, what: str) -> Rule:
    """The rule for a raw command."""
    if number == mav_cmd.COMPONENT_ARM_DISARM and param1 != 0.0:  # also NaN: an autopilot's reaction to it is not known
        return Rule(Level.FORCE, what, "arm")
    if number in TURNS_MOTORS:
        return Rule(Level.FORCE, what, TURNS_MOTORS[number])
    if number in HARMLESS_COMMANDS:
        return Rule(Level.HARMLESS, what)
    instead = COMMAND_ORDERS.get(number, "goto and mission" if number in MISSION_ITEMS else "")
    return Rule(Level.DISARMED, what, instead)


def param_rule(family: str, name: str, what: str = "param set") -> Rule:
    """The rule for a parameter, by its role: harmless ones pass; of an unknown firmware none is."""
    families = (family,) if family else ("px4", "ardupilot")
    harmless = all(role_of(one, name) is ParamRole.HARMLESS for one in families)
    return Rule(Level.HARMLESS if harmless else Level.DISARMED, f"{what} {name}", "param set")


# -- orders


@dataclass(frozen=True, slots=True)
class OrderRule:
    """Rule about what an order may send: names of messages, and numbers of commands."""

    messages: frozenset[str] = frozenset()
    commands: frozenset[int] = frozenset()


def _sends(*things: str | int) -> OrderRule:
    messages = frozenset(thing for thing in things if isinstance(thing, str))
    return OrderRule(messages, frozenset(thing for thing in things if isinstance(thing, int)))


_ARM, _MODE = mav_cmd.COMPONENT_ARM_DISARM, mav_cmd.DO_SET_MODE
_TARGETS = ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET")
_LIST = ("MISSION_COUNT", "MISSION_ITEM", "MISSION_ITEM_INT", "MISSION_CLEAR_ALL", "MISSION_WRITE_PARTIAL_LIST")
_POSES = ("VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE", "ODOMETRY", "ATT_POS_MOCAP", "VICON_POSITION_ESTIMATE")

ORDERS: Mapping[str, OrderRule] = {
    "arm": _sends(_ARM),
    "disarm": _sends(_ARM),
    "mode": _sends(_MODE),
    "takeoff": _sends(_MODE, _ARM, mav_cmd.NAV_TAKEOFF),
    "land": _sends(mav_cmd.NAV_LAND, mav_cmd.DO_LAND_START, _MODE),
    "rtl": _sends(mav_cmd.NAV_RETURN_TO_LAUNCH, _MODE, mav_cmd.DO_REPOSITION),
    "hold": _sends(_MODE, mav_cmd.DO_REPOSITION, "SET_MODE"),
    "stop": _sends(_MODE, mav_cmd.DO_REPOSITION, mav_cmd.NAV_LAND, mav_cmd.DO_LAND_START, _ARM),
    "goto": _sends(_MODE, mav_cmd.DO_REPOSITION, mav_cmd.CONDITION_YAW, "SET_POSITION_TARGET_GLOBAL_INT"),
    "control": _sends(_MODE),
    "release": _sends(_MODE, mav_cmd.DO_REPOSITION, "SET_MODE"),
    "setpoints": _sends(*_TARGETS),
    "mission": _sends(_MODE, _ARM, mav_cmd.MISSION_START, mav_cmd.DO_SET_MISSION_CURRENT, "MISSION_SET_CURRENT"),
    "mission item": _sends(mav_cmd.DO_SET_MISSION_CURRENT, "MISSION_SET_CURRENT"),
    "mission upload": _sends(*_LIST),
    "reboot": _sends(mav_cmd.PREFLIGHT_REBOOT_SHUTDOWN),
    "home": _sends(mav_cmd.DO_SET_HOME),
    "origin": _sends("SET_GPS_GLOBAL_ORIGIN"),
    "interval": _sends(),
    "request": _sends(),
    "stream": _sends(),
    "parameters": _sends(),
    "command": _sends(),
    "message": _sends(),
    "param set": _sends("PARAM_SET"),
    "calibrate": _sends(
        mav_cmd.PREFLIGHT_CALIBRATION,
        mav_cmd.DO_START_MAG_CAL,
        mav_cmd.DO_CANCEL_MAG_CAL,
        mav_cmd.ACCELCAL_VEHICLE_POS,
    ),
    "logs": _sends("LOG_REQUEST_DATA"),
    "poses": _sends(*_POSES),
    "corrections": _sends("GPS_RTCM_DATA"),
    "heartbeat": _sends("HEARTBEAT"),
    "signing": _sends("SETUP_SIGNING"),
}
"""Every order and stream of skygcs, and what it may send beside what is harmless. A command or message that somebody
names is cleared alone ("command", "message")."""


@dataclass(frozen=True, slots=True)
class Clearance:
    """Leave to send what an order may send. Only this module makes one."""

    order: str
    messages: frozenset[str]
    commands: frozenset[int]

    def covers(self, name: str, fields: Mapping[str, Any]) -> bool:
        """True if it allows this message."""
        if name in COMMAND_MESSAGES:
            return _whole(fields.get("command", -1)) in self.commands
        return name in self.messages


def is_exempt(clearance: Clearance | None) -> bool:
    """True if it is of vehicles.stop, which is sent without authority over the vehicle, too."""
    return clearance is not None and clearance.order == "stop"


def _row_clearance(order: str) -> Clearance:
    rule = ORDERS[order]
    return Clearance(order, rule.messages, rule.commands)


_STANDING = {
    name: _row_clearance(name)
    for name in (
        *("setpoints", "mission upload", "param set", "calibrate", "logs"),
        *("poses", "corrections", "heartbeat", "signing"),
    )
}


def standing(order: str) -> Clearance:
    """The clearance of a stream or transfer whose begin was checked. Raises KeyError for another order."""
    return _STANDING[order]


def clear_plan(model: VehicleModel, plan: Plan) -> Clearance:
    """The clearance of a plan for this vehicle. Raises RefusedError if the gate does not let it pass: an order that
    is in no row, a step that its row does not name, or a mode that the vehicle must not be in."""
    if plan.order not in ORDERS:
        raise RefusedError(f"the order {plan.order} is not in the table of the outgoing gate")
    clearance = _row_clearance(plan.order)
    if plan.order == "command":
        return _clear_command(model, plan)
    for step in _all_steps(plan.steps):
        for name, fields in _things(step):
            if message_rule(name, fields).level is not Level.HARMLESS and not clearance.covers(name, fields):
                raise RefusedError(f"the order {plan.order} may not send {step.name}: it is not in its row of the gate")
    if plan.order not in ("hold", "stop", "release"):  # what ends a motion is never asked for sticks
        _require_modes(model, plan)
    return clearance


def clear_undo(model: VehicleModel, order: str, step: Step) -> Clearance:
    """The clearance of a step that undoes one of an order, for the vehicle as it is when the step is sent. Raises
    RefusedError: for a mode unless the vehicle is known to be disarmed, for a mode that is flown by sticks, and for
    disarming in the air."""
    clearance = clear_plan(model, Plan(order, (step,), ""))
    for name, fields in _things(step):
        custom_mode = _custom_mode(name, fields)
        if custom_mode is None:
            if model.flying:
                raise RefusedError("it is in the air")
            continue
        wanted = custom_mode(model)
        if without_sticks(model, wanted) is not None:
            raise RefusedError(f"{mode_name(model, wanted)} is flown by sticks")
        if model.not_disarmed is not None:
            raise RefusedError(f"it {model.not_disarmed}")
    return clearance


def _clear_command(model: VehicleModel, plan: Plan) -> Clearance:
    (step,) = plan.steps
    assert step.command is not None
    spec = step.command
    rule = command_rule(spec.command, spec.params[0] if spec.params else 0.0, step.name)
    if (why := rule.refusal((model,), force=plan.force)) is not None:
        raise RefusedError(why)
    _require_modes(model, plan)
    return Clearance(plan.order, frozenset(), frozenset({spec.command}))


def clear_command(models: Iterable[VehicleModel], plan: Plan) -> Clearance:
    """The clearance of a plan with one raw command or request, to a component of the system of these vehicles (possibly
    none is known): an autopilot may act on commands to a component id that it does not know. Raises RefusedError."""
    found = list(models)
    for step in plan.steps:
        for name, fields in _things(step):
            rule = replace(message_rule(name, fields), what=step.name)
            if (why := rule.refusal(found, force=plan.force)) is not None:
                raise RefusedError(why)
    for model in found:
        _require_modes(model, plan)
    commands = frozenset(step.command.command for step in plan.steps if step.command is not None)
    return Clearance(plan.order, frozenset(), commands)


def clear_message(
    models: Iterable[VehicleModel],
    name: str,
    fields: Mapping[str, Any],
    command_names: Mapping[int, str],
    *,
    force: bool,
) -> Clearance:
    """The clearance of a raw message to these vehicles (possibly none is known). ``command_names``: MAV_CMD of the
    dialect. Raises RefusedError."""
    found = list(models)
    families = {model.family for model in found}
    rule = message_rule(name, fields, families.pop() if len(families) == 1 else "")
    if name in COMMAND_MESSAGES:
        number = _whole(fields.get("command", 0))
        named = command_names.get(number, f"MAV_CMD {number}").removeprefix("MAV_CMD_")
        rule = command_rule(number, _number(fields.get("param1", 0.0)), f"{name} {named}")
    if (why := rule.refusal(found, force=force)) is not None:
        raise RefusedError(why)
    custom_mode = _custom_mode(name, fields)
    for model in found:
        wanted = None if custom_mode is None else custom_mode(model)
        if wanted is not None and (why := mode_refusal(model, wanted, force=force)) is not None:
            raise RefusedError(why)
    commands = frozenset({_whole(fields.get("command", 0))}) if name in COMMAND_MESSAGES else frozenset()
    return Clearance("message", frozenset({name}), commands)


def clear_param(model: VehicleModel, name: str, *, force: bool) -> Clearance:
    """The clearance to set a parameter. Raises RefusedError."""
    rule = param_rule(model.family, name)
    if rule.level is Level.HARMLESS or force or model.not_disarmed is None:
        return _STANDING["param set"]
    effect = EFFECTS[role_of(model.family, name)]
    raise RefusedError(f"{name}: {effect}, and {model.name} {model.not_disarmed}; {FORCE_HINT}")


# -- parts


def _require_modes(model: VehicleModel, plan: Plan) -> None:
    """Raises RefusedError if a step of a plan would enter a mode that the vehicle must not be in."""
    for step in _all_steps(plan.steps):
        for name, fields in _things(step):
            custom_mode = _custom_mode(name, fields)
            wanted = None if custom_mode is None else custom_mode(model)
            if wanted is not None and (why := mode_refusal(model, wanted, force=plan.force)) is not None:
                raise RefusedError(why)


def _custom_mode(name: str, fields: Mapping[str, Any]) -> Any:
    """A function from a model to the custom_mode that a message sets; None: it sets none."""
    if name == "SET_MODE":
        return lambda model: _whole(fields.get("custom_mode", 0))
    if name not in COMMAND_MESSAGES or _whole(fields.get("command", 0)) != mav_cmd.DO_SET_MODE:
        return None
    main, sub = _whole(fields.get("param2", 0)), _whole(fields.get("param3", 0))
    return lambda model: main << 16 | sub << 24 if model.family == "px4" else main


def _all_steps(steps: Iterable[Step]) -> Iterable[Step]:
    """The steps, their alternatives and their undos."""
    for step in steps:
        yield step
        yield from _all_steps(step.instead)
        if step.undo is not None:
            yield step.undo


def _things(step: Step) -> Iterable[tuple[str, Mapping[str, Any]]]:
    """The messages that a step sends, as far as they are known before it begins."""
    specs = [step.command] if step.command is not None else []
    if step.proof is not None:
        specs += [step.proof.request] + ([step.proof.again] if step.proof.again is not None else [])
    for spec in specs:
        yield spec.message, spec.values(0, 0, 0)
    yield from (message for message in (step.message, step.with_repeats) if message is not None)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _whole(value: object) -> int:
    """A whole number; -1 for anything else, which no table has."""
    number = _number(value)
    return int(number) if math.isfinite(number) else -1


def _text(value: object) -> str:
    return value.rstrip(b"\0").decode("ascii", "replace") if isinstance(value, bytes) else str(value)


def _opcode(payload: object) -> int:
    """The opcode of a FILE_TRANSFER_PROTOCOL payload; -1 if it has none."""
    try:
        return int(payload[FTP_OPCODE_AT])  # type: ignore[index]
    except (TypeError, IndexError, ValueError):
        return -1


MAX_REPORTED = 64
"""Kinds of message that are reported once each; all are counted."""


class OutgoingGate:
    """The gate of one hub: the place that every message of ours passes before it becomes bytes. ``blocked`` counts the
    messages that it has kept back.

    What an order, a stream or a transfer sends carries the clearance that it was given. A message without one, or one
    that its clearance does not cover, is judged as a raw message to the vehicles that it would reach, and nobody
    insists on it here: a part of skygcs, or an extension, that asks for no clearance can send what is harmless.
    """

    def __init__(self, now: Callable[[], float], on_event: Callable[[Event], None]) -> None:
        self.blocked = 0
        self._now = now
        self._on_event = on_event
        self._reported: set[str] = set()

    def passes(
        self,
        name: str,
        fields: Mapping[str, Any],
        clearance: Clearance | None,
        reached: Callable[[], Iterable[Vehicle]],
    ) -> bool:
        """True if a message of ours may be sent. ``reached``: the vehicles that will accept it. One that may not is
        counted, and reported once per kind."""
        if clearance is not None and clearance.covers(name, fields):
            return True
        if name in HARMLESS_MESSAGES:
            return True
        now = self._now()
        rule = message_rule(name, fields)
        why = rule.refusal((model_of(vehicle, now) for vehicle in reached()), force=False)
        if why is None:
            return True
        self.blocked += 1
        if rule.what not in self._reported and len(self._reported) < MAX_REPORTED:
            self._reported.add(rule.what)
            self._on_event(
                Event("fault", None, None, f"the outgoing gate kept a message back: {why}", {"what": rule.what})
            )
        return False
