"""The outgoing gate: an allow list for raw messages, commands and parameters, and modes that need sticks."""

from __future__ import annotations

import ast
import contextlib
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink import modes
from skygcs.core.mavlink.frame import check, encode
from skygcs.core.mavlink.vehicle_class import VehicleClass
from skygcs.core.protocols.command import CommandSpec
from skygcs.core.vehicle import gate
from skygcs.core.vehicle.gate import (
    Clearance,
    Level,
    clear_command,
    clear_message,
    clear_param,
    clear_plan,
    clear_undo,
    command_rule,
    message_rule,
)
from skygcs.core.vehicle.order_plan import Plan, Step
from skygcs.core.vehicle.stick_modes import mode_refusal, needs_sticks
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import Sticks, VehicleModel
from skygcs.errors import RefusedError
from support.source_trees import SRC, source_files
from support.table import each

DIALECT = load_dialect("ardupilotmega")
COMMANDS = {n: name.removeprefix("MAV_CMD_") for n, name in DIALECT.enums["MAV_CMD"].items()}


def model(family: Any = "ardupilot", kind: VehicleClass = VehicleClass.COPTER, **changes: Any) -> VehicleModel:
    """A vehicle in the air without sticks."""
    flies = VehicleModel(
        name="alpha",
        family=family,
        version=None,
        program=None,
        kind=kind,
        mode="AUTO.LOITER",
        custom_mode=0xFFFFFFFF,
        hovers=False,
        not_disarmed="is armed",
        flying=True,
        sticks=Sticks.ABSENT,
        answers={},
    )
    return replace(flies, **changes)


FLYING, STANDING = model(), model(not_disarmed=None, flying=False)


def refusal(to: VehicleModel, name: str, *, force: bool = False, **fields: Any) -> str | None:
    try:
        clear_message((to,), name, fields, DIALECT.enums["MAV_CMD"], force=force)
    except RefusedError as error:
        return str(error)
    return None


def test_only_what_is_listed_as_harmless_passes_to_a_flying_vehicle() -> None:
    """The audit's figure was 276 of 301 messages and 143 of 200 commands."""
    messages = {name for name in DIALECT.by_name if refusal(FLYING, name, command=511) is None}
    assert messages == (gate.HARMLESS_MESSAGES & set(DIALECT.by_name)) | {"COMMAND_LONG", "COMMAND_INT"}
    commands = {n for n in COMMANDS if refusal(FLYING, "COMMAND_LONG", command=n) is None}
    assert commands == gate.HARMLESS_COMMANDS & set(COMMANDS)
    assert (len(messages), len(commands)) == (38, 40)
    disarmed = {n for n in COMMANDS if refusal(STANDING, "COMMAND_LONG", command=n, param1=1.0) is None}
    assert set(COMMANDS) - disarmed == {400, *gate.TURNS_MOTORS} & set(COMMANDS)


def test_each_example_of_the_audit_needs_force_in_the_air() -> None:
    examples: list[tuple[str, dict[str, Any]]] = [
        ("COMMAND_LONG", {"command": 5300, "param1": 0.0}),  # DO_SET_SAFETY_SWITCH_STATE
        ("SET_MODE", {"base_mode": 128, "custom_mode": 0xFFFFFFFF}),
        ("COMMAND_LONG", {"command": 42007, "param1": 2.0}),  # SET_EKF_SOURCE_SET
        ("COMMAND_LONG", {"command": 420}),  # INJECT_FAILURE
        ("PARAM_SET", {"param_id": "FENCE_ENABLE", "param_value": 0.0}),
        ("PARAM_SET", {"param_id": b"SYSID_THISMAV\0\0\0", "param_value": 9.0}),
        ("ODOMETRY", {}),
        ("VISION_POSITION_ESTIMATE", {}),
        ("GPS_INPUT", {}),
        ("HEARTBEAT", {}),
        ("NO_MESSAGE_OF_OURS", {}),
        ("COMMAND_LONG", {"command": 54321}),
        ("COMMAND_LONG", {"command": "no number"}),
        ("COMMAND_INT", {"command": math.inf}),
    ]
    for name, fields in examples:
        why = refusal(FLYING, name, **fields)
        assert why is not None and "--force" in why and "is armed" in why.replace("can turn motors", "is armed"), name
        assert refusal(FLYING, name, force=True, **fields) is None
    assert refusal(model(not_disarmed="is lost", flying=None), "ODOMETRY") is not None
    with pytest.raises(RefusedError, match="not known to be disarmed"):
        clear_message((), "ODOMETRY", {}, {}, force=False)


def test_the_checked_order_is_named_and_what_is_never_right_is_not_insisted_on() -> None:
    assert "the checked order is goto" in (refusal(FLYING, "COMMAND_INT", command=192) or "")
    assert "the checked order is param set" in (refusal(FLYING, "PARAM_SET", param_id="FENCE_ENABLE") or "")
    assert "no order does this" in (refusal(FLYING, "GPS_INPUT") or "")
    for name in ("HIL_SENSOR", "SETUP_SIGNING"):
        assert "never" in (refusal(STANDING, name, force=True) or "")


@each("param1", [1.0, 0.4, -1.0, 1e-40, math.nan, math.inf])
def test_whatever_is_not_plainly_a_disarming_counts_as_arming(param1: float) -> None:
    rule = command_rule(400, param1, "COMPONENT_ARM_DISARM")
    assert rule.level is Level.FORCE and rule.instead == "arm"
    assert refusal(STANDING, "SET_MODE", base_mode=0x80 | 1) is not None
    assert refusal(STANDING, "SET_MODE", base_mode=1) is None


def test_files_are_read_and_not_written_in_the_air() -> None:
    read, written = [0, 0, 0, 4] + [0] * 247, [0, 0, 0, 7] + [0] * 247
    assert refusal(FLYING, "FILE_TRANSFER_PROTOCOL", payload=read) is None
    for payload in (written, [], None, "x"):
        assert refusal(FLYING, "FILE_TRANSFER_PROTOCOL", payload=payload) is not None


def test_a_parameter_in_the_air_is_harmless_or_needs_force() -> None:
    assert clear_param(FLYING, "LOG_BITMASK", force=False).order == "param set"
    assert clear_param(STANDING, "FENCE_ENABLE", force=False).order == "param set"
    assert clear_param(FLYING, "ATC_RAT_RLL_P", force=True).order == "param set"
    for name in ("FENCE_ENABLE", "SYSID_THISMAV", "ATC_RAT_RLL_P", "NEVER_HEARD_OF"):
        with pytest.raises(RefusedError, match=rf"{name}: .*alpha is armed; .*--force"):
            clear_param(FLYING, name, force=False)


def test_a_raw_parameter_is_judged_by_the_firmware_of_its_vehicle() -> None:
    assert refusal(FLYING, "PARAM_SET", param_id=b"LOG_BITMASK") is None
    assert refusal(model("px4"), "PARAM_SET", param_id=b"LOG_BITMASK") is not None


def test_a_command_whose_number_is_none_is_no_command_of_a_table() -> None:
    for number in (math.nan, math.inf, "400"):
        assert "MAV_CMD -1" in str(refusal(FLYING, "COMMAND_LONG", command=number)), number


def mode(family: str, name: str, kind: VehicleClass = VehicleClass.COPTER) -> int:
    mav_type = {VehicleClass.COPTER: 2, VehicleClass.VTOL: 20, VehicleClass.ROVER: 10}[kind]
    return modes.mode_number(12 if family == "px4" else 3, mav_type, name)


def test_modes_flown_by_sticks_are_refused_in_the_air_without_any() -> None:
    """Name of a mode -> whether force insists."""
    table: dict[tuple[str, VehicleClass], dict[str, bool]] = {
        ("ardupilot", VehicleClass.COPTER): {
            **dict.fromkeys(("STABILIZE", "ACRO", "DRIFT", "TURTLE"), False),
            **dict.fromkeys(("ALT_HOLD", "LOITER", "POSHOLD", "GUIDED_NOGPS", "SPORT"), True),
        },
        ("px4", VehicleClass.COPTER): {
            **dict.fromkeys(("MANUAL", "ACRO", "STABILIZED", "TERMINATION"), False),
            **dict.fromkeys(("ALTCTL", "POSCTL"), True),
        },
        ("ardupilot", VehicleClass.VTOL): {"QSTABILIZE": False, "QHOVER": True, "FBWA": True, "MANUAL": False},
        ("ardupilot", VehicleClass.ROVER): {"MANUAL": True},
    }
    for (family, kind), wanted in table.items():
        flies = model(family, kind)
        for name, insists in wanted.items():
            number = mode(family, name, kind)
            why = mode_refusal(flies, number, force=False)
            assert why is not None and name in why and ("--force" in why) is insists, (family, name, why)
            assert (mode_refusal(flies, number, force=True) is None) is insists, (family, name)
            seen = mode_refusal(replace(flies, sticks=Sticks.READY), number, force=False)
            assert (seen is None) is (name != "TERMINATION")
            stands = [replace(flies, not_disarmed=None, flying=False)]
            if kind is not VehicleClass.ROVER:  # which is under way while it is armed
                stands.append(replace(flies, flying=False))
            for ground in stands:
                assert mode_refusal(ground, number, force=False) is None
    low = mode_refusal(model(sticks=Sticks.LOW), 5, force=False)
    assert low is not None and "throttle stick is down" in low and "sink" in low
    assert "sink" not in str(mode_refusal(FLYING, 5, force=False)), "without any it stays or drifts"
    for sticks in (Sticks.LOW, Sticks.ABSENT):
        assert "would fall" in str(mode_refusal(model(sticks=sticks), 0, force=False))
    for perhaps in (Sticks.UNKNOWN, Sticks.SEEN):  # a pilot may be there
        assert mode_refusal(model(sticks=perhaps), 0, force=True) is None
        assert mode_refusal(model(sticks=perhaps), 0, force=False) is not None
    for autonomous in ("GUIDED", "BRAKE", "LAND", "RTL", "AUTO"):
        assert mode_refusal(FLYING, mode("ardupilot", autonomous), force=False) is None


@each(("family", "fields"), [("ardupilot", {"param2": 0.0}), ("px4", {"param2": 1.0})])
def test_a_falling_mode_is_refused_by_every_door(family: str, fields: dict[str, Any]) -> None:
    flies = model(family)
    custom_mode = 0 if family == "ardupilot" else 1 << 16
    by_command = refusal(flies, "COMMAND_LONG", command=176, param1=1.0, force=True, **fields)
    by_message = refusal(flies, "SET_MODE", base_mode=1, custom_mode=custom_mode, force=True)
    spec = CommandSpec(176, (1.0, fields["param2"], 0.0))
    with pytest.raises(RefusedError) as by_order:
        clear_plan(flies, Plan("mode", (Step("mode", spec),), "", force=True))
    with pytest.raises(RefusedError) as by_raw:
        clear_plan(flies, Plan("command", (Step("mode", spec),), "", force=True))
    named = {(): "STABILIZE"} if family == "ardupilot" else {(1.0,): "MANUAL", (7.0,): "STABILIZED", (1.0, 3.0): "None"}
    for values, name in named.items():  # mode 0 if none is named
        asked = dict(zip(("param2", "param3"), values, strict=False))
        assert name in str(refusal(flies, "COMMAND_LONG", command=176, force=True, **asked)), values
    other = Step("interval", CommandSpec(511))
    for step in (replace(other, instead=(Step("mode", spec),)), replace(other, undo=Step("mode", spec))):
        with pytest.raises(RefusedError) as by_way:
            clear_plan(flies, Plan("mode", (step,), "", force=True))
        assert str(by_way.value) == str(by_order.value), "what may follow a step is looked at before it begins"
    for why in (by_command, by_message, str(by_order.value), str(by_raw.value)):
        assert (why is not None and "would fall" in why) or "motors would idle" in (why or "")


def test_an_undo_is_judged_for_the_vehicle_as_it_is_when_it_is_sent() -> None:
    def undo(vehicle: VehicleModel, command: int, *params: float) -> str:
        try:
            clear_undo(vehicle, "takeoff", Step("undo", CommandSpec(command, params)))
        except RefusedError as error:
            return str(error)
        return ""

    plane = VehicleClass.PLANE
    stands, flies = model(kind=plane, not_disarmed=None, flying=False), model(kind=plane)
    lost, armed = replace(stands, not_disarmed="is lost"), replace(flies, flying=False)
    assert [undo(one, 176, 1.0, 12.0) for one in (stands, flies, lost)] == ["", "it is armed", "it is lost"]
    assert undo(stands, 176, 1.0, 0.0) == "MANUAL is flown by sticks"
    assert [undo(one, 400, 0.0, 0.0) for one in (stands, armed, flies)] == ["", "", "it is in the air"]
    assert "not in its row" in undo(stands, 300, 0.0, 0.0)


def answer(door: Callable[..., Clearance], *asked: Any, **options: Any) -> Clearance | str:
    """Clearance that one way into the gate gives, or the text of its refusal."""
    try:
        return door(*asked, **options)
    except RefusedError as error:
        return str(error)


@each("force", [False, True])
@each("models", [(), (STANDING,), (FLYING,), (STANDING, FLYING), (FLYING, model("px4"))])
def test_a_raw_command_gets_the_same_answer_by_every_door(models: tuple[VehicleModel, ...], force: bool) -> None:
    """As a message, as a command to a component, and as the order of one vehicle."""
    for number, name in COMMANDS.items():
        for params in ((), (0.0,), (1.0, 0.0, 0.0), (1.0, 4.0, 3.0)):
            spec, what = CommandSpec(number, params), f"COMMAND_LONG {name}"
            plan = Plan("command", (Step(what, spec),), "", force=force)
            fields, named = spec.values(1, 1, 0), DIALECT.enums["MAV_CMD"]
            message = answer(clear_message, models, "COMMAND_LONG", fields, named, force=force)
            component = answer(clear_command, models, plan)
            doors = [component]
            if len(models) == 1:
                doors.append(answer(clear_plan, models[0], plan))
            for door in doors:
                if isinstance(message, str):
                    assert door == message
                else:
                    assert door == Clearance("command", frozenset(), frozenset({number}))
                    assert message == Clearance("message", frozenset({"COMMAND_LONG"}), frozenset({number}))


def test_streams_and_transfers_have_the_clearance_of_their_row() -> None:
    found = {}
    for order in gate.ORDERS:
        with contextlib.suppress(KeyError):
            found[order] = gate.standing(order)
    streams = {"setpoints", "poses", "corrections", "heartbeat"}
    assert found.keys() == streams | {"mission upload", "param set", "calibrate", "logs", "signing"}
    for order, clearance in found.items():
        assert clearance == Clearance(order, gate.ORDERS[order].messages, gate.ORDERS[order].commands)


def test_only_the_stop_order_is_sent_without_authority() -> None:
    cleared = [answer(clear_plan, FLYING, Plan(order, (), "")) for order in gate.ORDERS if order != "command"]
    clearances = [clearance for clearance in cleared if isinstance(clearance, Clearance)]
    assert len(clearances) == len(gate.ORDERS) - 1
    assert [clearance.order for clearance in clearances if gate.is_exempt(clearance)] == ["stop"]
    assert not gate.is_exempt(None)


@each(("autopilot", "mav_type"), [(12, 2), (12, 20), (12, 10), (3, 2), (3, 1), (3, 20), (3, 10), (3, 12)])
def test_a_mode_needs_sticks_where_the_gate_refuses_it_without_any(autopilot: int, mav_type: int) -> None:
    vehicle = Vehicle(1, 1, DIALECT, name="alpha")
    beat = {"type": mav_type, "autopilot": autopilot, "base_mode": 0x81, "mavlink_version": 3}
    frame, _ = check(encode(DIALECT.by_name["HEARTBEAT"], beat, sysid=1, compid=1, seq=0), DIALECT.messages)
    assert frame is not None
    vehicle.on_frame(frame, 1.0)
    flies = model(vehicle.family, vehicle.kind, custom_mode=-1)
    names = modes.mode_names(autopilot, mav_type)
    found = {name for name in names if needs_sticks(flies, vehicle, name)}
    numbers = {name: modes.mode_number(autopilot, mav_type, name) for name in names}
    assert found == {name for name in names if mode_refusal(flies, numbers[name], force=False) is not None}
    assert set() < found < set(names)
    assert not needs_sticks(flies, vehicle, "NO_MODE_OF_OURS")


def test_an_order_sends_only_what_its_row_names() -> None:
    hold = clear_plan(FLYING, Plan("hold", (Step("brake", CommandSpec(176, (1.0, 17.0, 0.0))),), ""))
    assert hold.covers("COMMAND_LONG", {"command": 176}) and not hold.covers("COMMAND_LONG", {"command": 400})
    assert not Clearance("command", frozenset(), frozenset({1})).covers("COMMAND_LONG", {}), "it names none"
    assert not hold.covers("PARAM_SET", {}) and hold.covers("SET_MODE", {})
    with pytest.raises(RefusedError, match="not in its row"):
        clear_plan(FLYING, Plan("hold", (Step("kill", CommandSpec(185, (1.0,))),), ""))
    with pytest.raises(RefusedError, match="not in the table"):
        clear_plan(FLYING, Plan("new idea", (), ""))


@given(
    st.sampled_from(sorted(DIALECT.by_name)),
    st.dictionaries(st.text(max_size=8), st.integers() | st.text() | st.none()),
)
def test_whatever_fields_come_a_message_has_a_level(name: str, fields: dict[str, Any]) -> None:
    assert message_rule(name, fields).level in Level


MAKES = {
    "Clearance": {"core/vehicle/gate.py"},
    "OwnMessage": {
        "runtime/hub.py",
        "runtime/admission_reports.py",
        "links/paced.py",
    },  # texts to programs; RTCM cut anew
    "_row_clearance": {"core/vehicle/gate.py"},
    "encode_payload": {
        *("core/radio_link/transmit_queue.py", "core/mavlink/frame.py", "core/routing/sysid_translation.py"),
        "ext/radio_tools/link_probe.py",
    },
}
"""Names that only these files may call: nothing else makes a clearance or a message of ours. `link_probe` measures two
radios at this computer, without a daemon, by ENCAPSULATED_DATA, which no autopilot acts on."""

STANDING_IN = {
    *("command_client", "hub", "param_transfers", "mission_transfers", "offboard_engagement"),
}
"""Modules of runtime that send a stream or a transfer whose begin was checked."""


def test_nothing_but_the_hub_makes_a_message_of_ours_and_nothing_but_the_gate_a_clearance() -> None:
    calls: dict[str, set[str]] = {name: set() for name in (*MAKES, "standing")}
    for path in source_files():
        where = path.relative_to(SRC).as_posix()
        if where.startswith(("sim/", "tlog/", "web/")):  # they send to nobody: simulated vehicles, and logs
            continue
        text = path.read_text(encoding="utf-8")
        if not any(name in text for name in calls):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module == gate.__name__:
                calls["standing"] |= {where for alias in node.names if alias.name == "standing"}
            if isinstance(node, ast.Call):
                name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
                if name in MAKES:
                    calls[name].add(where)
    for name, files in MAKES.items():
        assert calls[name] <= files, name
    assert calls["standing"] <= {f"runtime/{module}.py" for module in STANDING_IN} | {
        "ext/calibration/calibration_run.py",
        "ext/corrections/correction_feed.py",
        "ext/mocap/feed.py",
        "ext/onboard_logs/vehicle_logs.py",
        "ext/signing/signing_setup.py",
    }
