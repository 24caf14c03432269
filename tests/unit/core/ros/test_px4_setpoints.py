"""Setpoints and commands of PX4's own topics against what they mean in the fleet's frame."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import EAST_DEG, Origin
from skygcs.core.ros.px4_setpoints import OffboardControlMode, ack, is_for, service_call
from skygcs.core.ros.services import RequestError
from skygcs.core.ros.setpoints import Demand, LocalFrame, SetpointError
from support.table import each

PLACE = (43.7806, -79.4653, 180.0)
FRAME = LocalFrame(Origin(*PLACE, x_heading_deg=EAST_DEG), PLACE, 180.0, 0.0)
UNSET = [math.nan] * 3
NOTHING = dict.fromkeys(("position", "velocity", "acceleration", "attitude", "body_rate"), False)


def setpoint(**more: Any) -> dict[str, Any]:
    parts = {"position": UNSET, "velocity": UNSET, "acceleration": UNSET, "jerk": UNSET}
    return {"timestamp": 0, **parts, "yaw": math.nan, "yawspeed": math.nan, **more}


def demand(first: str, **more: Any) -> Demand:
    mode = OffboardControlMode()
    mode.on_message(NOTHING | {first: True}, 10.0)
    return mode.demand(setpoint(**more), FRAME, 10.2)


SOME = st.floats(-50, 50)


@given(SOME, SOME, SOME, st.floats(-math.pi, math.pi))
def test_a_position_is_east_north_up_and_yaw_from_east(north: float, east: float, down: float, yaw: float) -> None:
    found = demand("position", position=[north, east, down], yaw=yaw)
    assert found.mode == "position" and found.climbs_m == pytest.approx(-down)
    assert found.params["pos_enu_m"] == pytest.approx([east, north, -down], abs=1e-3)
    assert math.cos(math.radians(found.params["yaw_deg"]) - (math.pi / 2 - yaw)) == pytest.approx(1, abs=1e-9)
    assert found.params.keys() == {"pos_enu_m", "yaw_deg"}


def test_nan_decides_what_is_controlled() -> None:
    both = demand("position", position=[1.0, 2.0, -3.0], velocity=[0.5, math.nan, math.nan], yawspeed=0.5)
    assert both.params["vel_enu_mps"] == [None, 0.5, None]
    assert both.params["yaw_rate_dps"] == pytest.approx(-math.degrees(0.5))
    height = demand("position", position=[math.nan, math.nan, -3.0], velocity=[1.0, 2.0, math.nan])
    assert height.params["pos_enu_m"][:2] == [None, None] and height.params["pos_enu_m"][2] == pytest.approx(3)
    assert height.params["vel_enu_mps"] == [2.0, 1.0, None] and height.climbs_m == 3
    level = demand("position", position=[1.0, 2.0, math.nan], velocity=[math.nan, math.nan, 0.5])
    assert level.params["pos_enu_m"][2] is None and level.climbs_m is None
    assert level.params["vel_enu_mps"] == [None, None, -0.5]
    assert demand("position", velocity=[1.0, 0.0, 0.0]).mode == "velocity"


def test_the_mode_decides_which_parts_count() -> None:
    everything = {"position": [1.0, 2.0, -3.0], "velocity": [1.0, 2.0, 3.0], "acceleration": [4.0, 5.0, 6.0]}
    fast = demand("velocity", **everything)
    assert fast.mode == "velocity" and fast.params == {
        "vel_enu_mps": [2.0, 1.0, -3.0],
        "acc_enu_mps2": [5.0, 4.0, -6.0],
    }
    assert demand("acceleration", **everything) == Demand("raw", {"acc_enu_mps2": [5.0, 4.0, -6.0]})
    for first in ("attitude", "body_rate"):
        with pytest.raises(SetpointError, match="none of"):
            demand(first, **everything)


@each(
    ("first", "more"),
    [
        ("position", {}),
        ("velocity", {"position": [0.0, 0.0, -3.0]}),
        ("position", {"position": [math.inf, 0.0, -3.0]}),
        ("position", {"position": [1e9, 0.0, -3.0]}),
        ("velocity", {"velocity": [0.0, 0.0, -math.inf]}),
        ("velocity", {"velocity": [0.0, 0.0, 0.0], "yaw": math.inf}),
    ],
)
def test_what_is_no_setpoint_is_refused(first: str, more: dict[str, Any]) -> None:
    with pytest.raises(SetpointError):
        demand(first, **more)


def test_a_setpoint_without_a_fresh_mode_is_refused() -> None:
    mode = OffboardControlMode()
    good = setpoint(position=[0.0, 0.0, -3.0])
    with pytest.raises(SetpointError, match="offboard_control_mode"):
        mode.demand(good, FRAME, 0.0)
    mode.on_message(NOTHING | {"position": True}, 1.0)
    assert mode.demand(good, FRAME, 1.5).mode == "position"
    with pytest.raises(SetpointError, match="2 Hz"):
        mode.demand(good, FRAME, 1.6)


def command(number: int, *params: float, **more: int) -> dict[str, Any]:
    values = {f"param{n}": value for n, value in enumerate((*params, *[0.0] * (7 - len(params))), 1)}
    who = {"target_system": 3, "target_component": 1, "source_system": 1, "source_component": 7}
    return {"command": number, **values, **who, **more}


def test_only_commands_for_this_vehicles_autopilot_count() -> None:
    assert is_for(command(400, 1), 3) and is_for(command(400, 1, target_system=0), 3)
    assert not is_for(command(400, 1), 4)
    assert is_for(command(400, 1, target_component=0), 3) and not is_for(command(400, 1, target_component=154), 3)


def test_commands_are_mavros_services() -> None:
    assert service_call(command(400, 1.0)) == ("cmd/arming", {"value": True})
    assert service_call(command(400, 0.0, 21196.0)) == ("cmd/arming", {"value": False})
    assert service_call(command(176, 1, 6))[1]["custom_mode"] == "OFFBOARD"
    assert service_call(command(176, 1, 4, 6))[1]["custom_mode"] == "AUTO.LAND"
    assert service_call(command(176, 1, 3, math.nan))[1]["custom_mode"] == "POSCTL"
    name, request = service_call(command(22, 0, 0, 0, math.nan, 43.5, -79.5, 190.0))
    assert name == "cmd/command" and (request["command"], request["param7"], request["broadcast"]) == (22, 190.0, False)
    made = ack(command(22), 4)
    assert (made["command"], made["result"], made["target_system"], made["target_component"]) == (22, 4, 1, 7)


@each(
    "wrong",
    [
        command(100_000),
        command(176, 0, 6),
        command(176, 1, 99),
        command(176, 1, math.nan),
        command(176, 1, math.inf),
        command(176, 1, 6, -1),
    ],
)
def test_what_is_no_command_of_mavlink_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(RequestError):
        service_call(wrong)
