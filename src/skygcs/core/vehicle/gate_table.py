"""The outgoing gate as a table: for each firmware and class what an order sends, or why it is refused. Pure.

Nothing of it is written down: each cell is made by planning the order for a vehicle of that class, in the air or on the
ground, and by asking the gate about the plan. Heights and places of the cells are those of one example.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from skygcs.core.mavlink import mav_cmd, modes
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame, check, encode
from skygcs.core.mavlink.vehicle_class import TAKEOFF_HEIGHT, VehicleClass, abilities_of, class_type
from skygcs.core.params.names import ParamRole
from skygcs.core.protocols.command import CommandSpec
from skygcs.core.vehicle import mission_orders, offboard_entry, orders
from skygcs.core.vehicle.gate import (
    COMMAND_MESSAGES,
    Level,
    clear_plan,
    command_rule,
    message_rule,
)
from skygcs.core.vehicle.order_plan import Plan, Step
from skygcs.core.vehicle.stick_modes import WEARS_NO_FORCE, Without, mode_name, without_sticks
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import model_of
from skygcs.errors import NotReadyError, RefusedError

NOW = 100.0
PLACE = {"lat": 472000000, "lon": 85000000, "alt": 420_000, "relative_alt": 20_000}
WHERE = {"lat_deg": 47.2, "lon_deg": 8.5, "height_m": 20.0}
REACH_M = 500.0
TAKEOFF_M = 50.0
"""Default of the height to which an ArduPlane takes off."""

PX4, ARDUPILOT = modes.AUTOPILOT_PX4, modes.AUTOPILOT_ARDUPILOT


@dataclass(frozen=True, slots=True)
class Example:
    """One row: a firmware, a class and the mode it is in, in the air and without sticks."""

    firmware: str
    autopilot: int
    kind: VehicleClass
    mode: str
    state: str = ""
    """Further state that distinguishes it from another row of its class."""

    @property
    def title(self) -> str:
        """Its name in the table."""
        return f"{self.firmware} {self.kind}" + (f", {self.state}" if self.state else "")


_C = VehicleClass
EXAMPLES = (
    *(Example("PX4", PX4, kind, "AUTO.LOITER") for kind in (_C.COPTER, _C.VTOL, _C.PLANE, _C.ROVER, _C.BOAT)),
    Example("ArduPilot", ARDUPILOT, _C.COPTER, "GUIDED"),
    Example("ArduPilot", ARDUPILOT, _C.PLANE, "AUTO"),
    Example("ArduPilot", ARDUPILOT, _C.VTOL, "QLOITER", "hovering"),
    Example("ArduPilot", ARDUPILOT, _C.VTOL, "AUTO", "on its wing"),
    Example("ArduPilot", ARDUPILOT, _C.ROVER, "AUTO"),
    Example("ArduPilot", ARDUPILOT, _C.BOAT, "AUTO"),
    Example("ArduPilot", ARDUPILOT, _C.SUB, "GUIDED"),
    Example("ArduPilot", ARDUPILOT, _C.BLIMP, "AUTO"),
    Example("ArduPilot", ARDUPILOT, _C.TRACKER, "AUTO"),
    Example("PX4", PX4, _C.OTHER, "AUTO.LOITER"),
)

Planner = Callable[[Vehicle, float], Plan]

IN_THE_AIR: Mapping[str, Planner] = {
    "hold": orders.hold,
    "stop": lambda vehicle, now: orders.stop(vehicle, now, "hold"),
    "stop land": lambda vehicle, now: orders.stop(vehicle, now, "land"),
    "stop kill": lambda vehicle, now: orders.stop(vehicle, now, "kill"),
    "land": orders.land,
    "rtl": orders.rtl,
    "goto": lambda vehicle, now: orders.goto(vehicle, now, limit_m=REACH_M, **WHERE),  # type: ignore[arg-type]
    "control set": lambda vehicle, now: _control(vehicle, now),
    "disarm": orders.disarm,
    "reboot": orders.reboot,
    "home": orders.set_home,
}
ON_THE_GROUND: Mapping[str, Planner] = {
    "arm": orders.arm,
    "takeoff": lambda vehicle, now: orders.takeoff(vehicle, now, TAKEOFF_M),
    "mission start": mission_orders.start,
}
STICKS = "modes by sticks"
"""The column of modes that are flown by sticks, in the air and without any."""


@dataclass(frozen=True, slots=True)
class Cell:
    """``sends``: the messages of an order, in their order; ``refused``: why it is not sent, "" if it is."""

    firmware: str
    kind: str
    state: str
    order: str
    sends: tuple[str, ...]
    refused: str

    def as_dict(self) -> dict[str, Any]:
        """Row for JSON."""
        return {
            "firmware": self.firmware,
            "class": self.kind,
            "state": self.state,
            "order": self.order,
            "sends": list(self.sends),
            "refused": self.refused or None,
        }


def cells(dialect: Dialect) -> Iterator[Cell]:
    """All cells, row by row."""
    names = dialect.enums.get("MAV_CMD", {})
    for example in EXAMPLES:
        for on_ground, planners in ((True, ON_THE_GROUND), (False, IN_THE_AIR)):
            vehicle = _vehicle(example, dialect, on_ground=on_ground)
            for order, planner in planners.items():
                sends, refused = _planned(vehicle, planner, names)
                yield Cell(example.firmware, example.kind, example.state, order, sends, refused)
        flies = _vehicle(example, dialect, on_ground=False)
        yield Cell(example.firmware, example.kind, example.state, STICKS, (), _stick_modes(flies))


@dataclass(frozen=True, slots=True)
class Passing:
    """How many messages, or commands, of a dialect pass at each level, and the names of the harmless ones."""

    all: int
    levels: Mapping[Level, int]
    harmless: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Row for JSON."""
        counts = {level.value: count for level, count in self.levels.items()}
        return {"all": self.all, "levels": counts, "harmless": list(self.harmless)}


def messages_passing(dialect: Dialect) -> Passing:
    """Counts of the messages, as raw messages; COMMAND_LONG and COMMAND_INT are judged by their command."""
    names = sorted(set(dialect.by_name) - COMMAND_MESSAGES)
    return _count({name: message_rule(name, {}).level for name in names})


def commands_passing(dialect: Dialect) -> Passing:
    """Counts of the commands, as raw commands with a first parameter of 1."""
    names = {n: name.removeprefix("MAV_CMD_") for n, name in dialect.enums.get("MAV_CMD", {}).items()}
    return _count({name: command_rule(n, 1.0, name).level for n, name in names.items() if name != "ENUM_END"})


def params_passing() -> Mapping[str, str]:
    """The level of a parameter of each role."""
    harmless = {ParamRole.HARMLESS}
    return {role.value: (Level.HARMLESS if role in harmless else Level.DISARMED).value for role in ParamRole}


def _count(levels: Mapping[str, Level]) -> Passing:
    counts = {level: sum(found is level for found in levels.values()) for level in Level}
    return Passing(len(levels), counts, tuple(sorted(n for n, level in levels.items() if level is Level.HARMLESS)))


# -- examples


def _vehicle(example: Example, dialect: Dialect, *, on_ground: bool) -> Vehicle:
    """A vehicle of this class that has said all that orders ask for."""
    vehicle = Vehicle(1, 1, dialect, name="v1")
    mav_type = class_type(example.kind)
    able = abilities_of(modes.family(example.autopilot), example.kind)
    mode = able.stop_mode if on_ground and example.mode in able.moves_off else example.mode
    custom_mode = modes.mode_number(example.autopilot, mav_type, mode)
    beat = {"type": mav_type, "autopilot": example.autopilot, "custom_mode": custom_mode, "mavlink_version": 3}
    beat |= {"base_mode": modes.CUSTOM_MODE_ENABLED | (0 if on_ground else modes.SAFETY_ARMED)}
    height = {"relative_alt": 0, "alt": 400_000} if on_ground else {}
    params = {TAKEOFF_HEIGHT: TAKEOFF_M} | ({"Q_ENABLE": 0.0} if example.kind is VehicleClass.PLANE else {})
    said: list[tuple[str, Mapping[str, Any]]] = [
        ("HEARTBEAT", beat | {"system_status": 3 if on_ground else 4}),
        ("EXTENDED_SYS_STATE", {"landed_state": 1 if on_ground else 2}),
        ("GLOBAL_POSITION_INT", PLACE | height),
        ("SYS_STATUS", {}),
        *(("PARAM_VALUE", {"param_id": n.encode(), "param_value": v, "param_type": 9}) for n, v in params.items()),
    ]
    for name, values in said:
        vehicle.on_frame(_frame(dialect, name, values), NOW)
    return vehicle


def _frame(dialect: Dialect, name: str, values: Mapping[str, Any]) -> Frame:
    frame, _ = check(encode(dialect.by_name[name], values, sysid=1, compid=1, seq=0), dialect.messages)
    assert frame is not None
    return frame


def _control(vehicle: Vehicle, now: float) -> Plan:
    """Control by setpoints: the mode, while setpoints stream."""
    if (why := offboard_entry.entry_refusal(vehicle, now)) is not None:
        raise RefusedError(why)
    return offboard_entry.enter(vehicle)


# -- cells


def _planned(vehicle: Vehicle, planner: Planner, names: Mapping[int, str]) -> tuple[tuple[str, ...], str]:
    try:
        plan = planner(vehicle, NOW)
        clear_plan(model_of(vehicle, NOW), plan)
    except (RefusedError, NotReadyError) as error:
        return (), str(error)
    return tuple(_sent(vehicle, plan.steps, names)), ""


def _sent(vehicle: Vehicle, steps: Iterable[Step], names: Mapping[int, str]) -> Iterator[str]:
    for step in steps:
        spec = step.command
        if step.late is not None:
            spec = step.late.command(vehicle, NOW)
        if spec is not None:
            yield _command(vehicle, spec, names)
        elif step.message is not None:
            yield step.message[0]


def _command(vehicle: Vehicle, spec: CommandSpec, names: Mapping[int, str]) -> str:
    name = names.get(spec.command, str(spec.command)).removeprefix("MAV_CMD_")
    if spec.command == mav_cmd.COMPONENT_ARM_DISARM:
        return ("arm" if spec.params[0] else "disarm") + (" forced" if len(spec.params) > 1 and spec.params[1] else "")
    if spec.command != mav_cmd.DO_SET_MODE:
        return name
    main, sub = int(spec.params[1]), int(spec.params[2]) if len(spec.params) > 2 else 0
    number = main << 16 | sub << 24 if vehicle.family == "px4" else main
    return f"mode {mode_name(model_of(vehicle, NOW), number)}"


def _stick_modes(vehicle: Vehicle) -> str:
    """The modes flown by sticks, by what the gate does in the air without any."""
    model = replace(model_of(vehicle, NOW), custom_mode=-1)
    refused: list[str] = []
    forced: list[str] = []
    for name in modes.mode_names(vehicle.autopilot, vehicle.mode_type):
        number = modes.mode_number(vehicle.autopilot, vehicle.mode_type, name)
        effect: Without | None = without_sticks(model, number)
        if effect is not None:
            (refused if effect in WEARS_NO_FORCE else forced).append(name)
    parts = [f"refused: {', '.join(refused)}"] * bool(refused) + [f"need force: {', '.join(forced)}"] * bool(forced)
    return "; ".join(parts) or "none"
