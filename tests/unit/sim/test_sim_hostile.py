"""Nothing a sender can put into a message makes a simulated vehicle raise, leave the field or stop its heartbeat."""

from __future__ import annotations

import struct
from math import isfinite
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.mavlink.dialect import FieldInfo, MessageInfo
from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim import protocol
from skygcs.sim.vehicle import SimVehicle
from support.examples import examples, thinned
from support.sim_pilot import Pilot, copter, px4, sim_dialect
from support.table import each

COSTS = "half of all commands with nasty numbers in each place"

COMMANDS = [value for name, value in vars(protocol).items() if name.startswith("MAV_CMD_")]
LISTENED_TO = (
    *("HEARTBEAT", "COMMAND_LONG", "COMMAND_INT", "SET_POSITION_TARGET_GLOBAL_INT"),
    *("SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET", "SET_MODE", "PARAM_SET", "PARAM_REQUEST_READ"),
    *("REQUEST_DATA_STREAM", "MISSION_COUNT", "PING", "TIMESYNC"),
)
NASTY = [0.0, 1.0, -1.0, float("nan"), float("inf"), float("-inf"), 3e38, -3e38, 1e-40, 511.0, 21196.0, 1e10, 2.5e9]
NAMES = [
    *("MAV_SYS_ID", "SYSID_THISMAV", "WPNAV_ACCEL", "WPNAV_SPEED_UP", "MPC_XY_CRUISE", "SR1_POSITION", "RTL_ALT"),
    *("GUID_OPTIONS", "GUID_TIMEOUT", "FENCE_ENABLE", "FENCE_RADIUS", "FS_GCS_ENABLE", "BATT_FS_LOW_ACT"),
    *("COM_OF_LOSS_T", "COM_OBL_RC_ACT", "GF_ACTION", "GF_MAX_HOR_DIST", "NAV_DLL_ACT", "NOPE"),
]


def value_of(field: FieldInfo) -> st.SearchStrategy[Any]:
    if field.name in ("target_system", "target_component"):
        return st.sampled_from([0, 1])
    if field.name == "command":
        return st.sampled_from(COMMANDS)
    if field.name == "param_id":
        return st.sampled_from(NAMES)
    if field.name in ("frame", "coordinate_frame"):
        return st.integers(0, 12)
    if field.type == "float":
        one: st.SearchStrategy[Any] = st.sampled_from(NASTY) | st.floats(width=32)
    else:
        size = struct.calcsize("<" + {"c": "B"}.get(field.code[-1:], field.code[-1:]))
        low = -(1 << (8 * size - 1)) if field.type.startswith("int") else 0
        one = st.integers(low, low + (1 << 8 * size) - 1)
    return st.lists(one, min_size=field.array_length, max_size=field.array_length) if field.array_length else one


def message() -> st.SearchStrategy[tuple[MessageInfo, dict[str, Any]]]:
    infos = [sim_dialect().by_name[name] for name in LISTENED_TO]
    return st.one_of(
        [st.tuples(st.just(i), st.fixed_dictionaries({f.name: value_of(f) for f in i.fields})) for i in infos]
    )


@pytest.mark.deep
@each("make", [px4, copter])
def test_every_command_survives_every_nasty_number_in_every_place(make: type[SimVehicle]) -> None:
    for command in thinned(COMMANDS, len(COMMANDS) // 2, turn=make is copter):
        vehicle = make()
        pilot = Pilot(vehicle)
        pilot.hovering()
        for at, value in thinned(enumerate(NASTY), 5, turn=command):
            for place in thinned(range(1, 8), 1, turn=command + at):
                params = [1.0] * 7
                params[place - 1] = value
                pilot.command(command, *params)
                pilot.command_int(command, *params[:4], x=2**31 - 1, y=-(2**31), z=value, frame=place)
            pilot.run(0.1)


@each("make", [px4, copter])
@each("value", thinned([1e30, 0.0, -1.0], 1))
def test_no_parameter_makes_it_fly_beyond_what_telemetry_can_say(make: type[SimVehicle], value: float) -> None:
    vehicle = make()
    pilot = Pilot(vehicle)
    pilot.hovering()
    for index in range(len(vehicle.params)):
        param = vehicle.params.at(index)
        assert param is not None
        if param.type == protocol.MAV_PARAM_TYPE_REAL32:
            vehicle.params.set(param.name, value)
    pilot.command_int(protocol.MAV_CMD_DO_REPOSITION, -1, 1, 0, 0, x=0, y=0, z=1000, frame=3)
    pilot.run(120, step_s=10)
    assert 0 < vehicle.motion.groundspeed_mps <= 30
    pilot.command(protocol.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    pilot.run(30, step_s=10)


@each("make", [px4, copter])
@each("flying", [False, True])
@given(messages=st.lists(message(), min_size=1, max_size=25))
@settings(max_examples=examples(25), deadline=None, derandomize=True)
def test_random_messages_never_raise_and_never_stop_it(
    make: type[SimVehicle], flying: bool, messages: list[tuple[MessageInfo, dict[str, Any]]]
) -> None:
    vehicle = make()
    pilot = Pilot(vehicle)
    if flying:
        pilot.hovering()
    parser = FrameParser(sim_dialect())
    for seq, (info, fields) in enumerate(messages):
        for frame in parser.feed(encode(info, fields, sysid=250, compid=1, seq=seq)):
            vehicle.on_frame(frame, pilot.now)
        pilot.run(0.5)
    pilot.run(20, step_s=1.0)  # whatever was set has come to pass
    motion = vehicle.motion
    assert isfinite(motion.east_m + motion.north_m + motion.up_m + motion.yaw_rad)
    vehicle.reboot(pilot.now)  # rates are the defaults again, so the heartbeat is back if it was turned off
    pilot.forget()
    pilot.run(6)
    assert any(x.get_type() == "HEARTBEAT" for x in pilot.heard)
