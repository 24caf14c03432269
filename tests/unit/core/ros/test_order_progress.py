"""Orders as goals: parameters, distance, and every way in which one ends."""

from __future__ import annotations

import math
from typing import Any

import pytest

from skygcs.core.ros.action_goals import ABORTED, SUCCEEDED
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.core.ros.order_progress import (
    ACTIONS,
    GROUND_S,
    MOVING,
    SETTLE_S,
    SILENT_S,
    STALLED_S,
    GoalError,
    OrderProgress,
    order_params,
)
from skygcs.runtime import order_runner
from support.table import each


def goal(order: Any, **fields: Any) -> dict[str, Any]:
    """As it comes over the network."""
    known, type_ = ros2_interfaces(), f"{ACTIONS[order]}_Goal"
    return known.decode(type_, known.encode(type_, fields))


def state(**more: Any) -> dict[str, Any]:
    position = {"lat_deg": 43.0, "lon_deg": -79.0, "alt_rel_m": 10.0, "alt_takeoff_m": 10.0, "age_s": 0.1}
    position |= {"enu_m": [0.0, 0.0, 10.0], "vel_enu_mps": [0.0, 0.0, 0.0], **more.pop("position", {})}
    plain = {"name": "alpha", "connected": True, "armed": True, "mode": "AUTO.LOITER", "landed": "in_air"}
    return {**plain, "control": None, "position": position, **more}


def going(order: Any = "goto", at: float = 100.0, **fields: Any) -> OrderProgress:
    """An accepted order, whose own outcome has come."""
    given = fields or ({"position": {"x": 30.0, "y": 40.0, "z": 10.0}} if order == "goto" else {"height_m": 8.0})
    progress = OrderProgress(order, goal(order, **({} if order == "land" else given)), state())
    assert progress.on_event(outcome(order)) is None
    assert progress.accepted(at) is None
    return progress


def outcome(order: str, vehicle: str = "alpha", ok: bool = True, **more: Any) -> dict[str, Any]:
    return {"kind": "command", "vehicle": vehicle, "data": {"order": order, "ok": ok, **more}}


@each(
    ("order", "fields", "params"),
    [
        ("land", {}, {}),
        ("takeoff", {}, {"height_m": None, "arm": False}),
        ("takeoff", {"height_m": 4.0, "arm": True}, {"height_m": 4.0, "arm": True}),
        ("goto", {"position": {"x": 1, "y": 2, "z": 3}}, {"enu_m": [1.0, 2.0, 3.0]}),
        ("goto", {"frame": 1, "lat_deg": 43.5, "lon_deg": 9.0, "height_m": 5.0}, {"lat_deg": 43.5, "lon_deg": 9.0}),
        (
            "goto",
            {"frame": 1, "lat_deg": 1.0, "use_height": True, "height_m": 5.0, "use_heading": True, "heading_deg": 90.0},
            {"lat_deg": 1.0, "lon_deg": 0.0, "height_m": 5.0, "yaw_deg": 90.0},
        ),
    ],
)
def test_a_goal_becomes_the_daemons_parameters(order: Any, fields: dict[str, Any], params: dict[str, Any]) -> None:
    assert order_params(order, goal(order, **fields)) == params


@each(
    ("order", "wrong"),
    [
        ("takeoff", [{"height_m": value} for value in (math.nan, math.inf, -1.0)]),
        ("goto", [{"position": {"z": math.nan}}, {"frame": 2}, {"frame": 1, "lat_deg": math.inf}]),
        ("goto", [{"frame": 1, "use_height": True, "height_m": math.nan}]),
        ("goto", [{"use_heading": True, "heading_deg": math.nan}]),
        ("goto", [{"tolerance_m": value} for value in (0.1, 1000.0, math.nan)]),
    ],
)
def test_a_goal_that_is_no_order_is_refused(order: Any, wrong: list[dict[str, Any]]) -> None:
    for fields in wrong:
        with pytest.raises(GoalError):
            order_params(order, goal(order, **fields))


def test_the_orders_that_replace_are_the_daemons() -> None:
    assert MOVING == order_runner.MOVING


def test_a_goto_measures_and_arrives() -> None:
    progress = going()
    assert progress.on_state(state(), 100.2) is None
    assert progress.feedback() == {"distance_m": 50.0, "height_m": 10.0}
    there = {"enu_m": [30.0, 39.0, 10.0]}
    assert progress.on_state(state(position={**there, "vel_enu_mps": [0.0, 3.0, 0.0]}), 110.0) is None  # it flies by
    end = progress.on_state(state(position=there), 111.0)
    assert end == (SUCCEEDED, "arrived")
    assert progress.result(end) == {"ok": True, "reason": "arrived", "distance_m": 1.0}


def test_a_place_on_earth_is_measured_with_and_without_a_height() -> None:
    north_m = 0.001 * 111_111
    for fields, height_m in (({"use_height": True, "height_m": 40.0}, 40.0), ({}, 10.0)):
        progress = going(frame=1, lat_deg=43.001, lon_deg=-79.0, **fields)
        progress.on_state(state(), 100.2)
        assert progress.distance_m == pytest.approx(math.hypot(north_m, height_m - 10), rel=2e-3)


def test_an_old_position_is_no_distance() -> None:
    progress = going()
    progress.on_state(state(position={"age_s": 5.0, "enu_m": [30.0, 40.0, 10.0]}), 100.2)
    assert math.isnan(progress.distance_m) and math.isnan(progress.height_m)
    progress.on_state(state(position=dict.fromkeys(("enu_m", "lat_deg", "alt_rel_m"))), 100.4)
    assert math.isnan(progress.distance_m)
    assert progress.on_state(state() | {"position": None}, 100.6) is None


def test_a_takeoff_arrives_at_its_height() -> None:
    progress = going("takeoff")
    climbing = {"landed": "takeoff", "mode": "AUTO.TAKEOFF"}
    assert progress.on_state(state(position={"alt_takeoff_m": 1.0}, **climbing), 101) is None
    assert progress.feedback() == {"distance_m": 7.0, "height_m": 1.0}
    assert progress.on_state(state(position={"alt_takeoff_m": 7.6}, **climbing), 104) is None
    end = progress.on_state(state(position={"alt_takeoff_m": 7.6}), 105)
    assert end is not None and progress.result(end) == {"ok": True, "reason": "arrived", "height_m": 7.6}


def test_a_takeoff_to_the_fleet_files_height() -> None:
    fields = goal("takeoff")
    known, unknown = (OrderProgress("takeoff", fields, state(), height_m) for height_m in (2.5, None))
    for progress in (known, unknown):
        progress.accepted(100.0)
        rising = {"alt_takeoff_m": 1.0, "vel_enu_mps": [0.0, 0.0, 1.0]}
        assert progress.on_state(state(position=rising), 101) is None
        assert progress.on_state(state(position={"alt_takeoff_m": 2.4}), 102) == (SUCCEEDED, "arrived")


def test_a_landing_ends_on_the_ground() -> None:
    progress = going("land")
    landing = {"mode": "AUTO.LAND", "landed": "landing"}
    assert progress.on_state(state(**landing), 101) is None
    assert progress.feedback() == {"distance_m": 10.0, "height_m": 10.0}
    on_ground = {"mode": "AUTO.LAND", "landed": "on_ground"}
    assert progress.on_state(state(**on_ground), 110) is None
    assert progress.on_state(state(**on_ground), 110 + GROUND_S) == (SUCCEEDED, "landed, still armed")
    assert going("land").on_state(state(**on_ground, armed=False), 103) == (SUCCEEDED, "landed and disarmed")


@each("order", sorted(MOVING))
def test_an_order_of_anybody_replaces_it(order: str) -> None:
    progress = going()
    assert progress.on_event(outcome(order, "bravo")) is None
    assert progress.on_event(outcome(order, ok=False)) is None
    assert progress.on_event(outcome("arm")) is None
    assert progress.on_event(outcome(order)) == (ABORTED, f"replaced: {order} was ordered")


def test_its_own_outcome_may_come_after_the_answer_but_once_and_a_lost_one_hides_no_other_for_long() -> None:
    again = ABORTED, "replaced: goto was ordered"
    progress = OrderProgress("goto", goal("goto"), state())
    assert progress.accepted(100.0) is None
    assert [progress.on_event(outcome("goto")) for _ in range(2)] == [None, again]
    progress = OrderProgress("goto", goal("goto"), state())
    progress.accepted(100.0)
    progress.on_state(state(position={"enu_m": [9.0, 0.0, 10.0]}), 100.1 + SETTLE_S)
    assert progress.on_time(100.1 + SETTLE_S) is None
    assert progress.on_event(outcome("goto")) == again


@each(
    ("seen", "ends"),
    [
        (["hold", "goto"], False),  # the hold was before it
        (["goto", "hold"], True),
        (["goto", "goto"], True),  # which of two was the last is not known
        (["hold"], False),
        (["hold"] * 1000 + ["goto"], False),
    ],
)
def test_orders_at_the_same_time(seen: list[str], ends: bool) -> None:
    progress = OrderProgress("goto", goal("goto"), state())
    for order in seen:
        assert progress.on_event(outcome(order)) is None
    assert (progress.accepted(100.0) is not None) is ends


def test_reports_that_were_lost_end_it() -> None:
    assert going().on_event(outcome("arm", withheld=3)) is not None
    assert going().on_event(outcome("arm", "bravo", withheld=3)) is None
    assert going().on_event({**outcome("arm", "bravo"), "dropped": 9}) is not None


def test_another_mode_replaces_it_once_its_own_was_seen() -> None:
    for order, mode in (("goto", "POSCTL"), ("takeoff", "STABILIZE"), ("land", "AUTO.LOITER")):
        progress = going(order)
        assert progress.on_state(state(mode=mode), 100.2) is None  # an old state
        late = progress.on_state(state(mode=mode), 100.1 + SETTLE_S)
        assert late is not None and late == (ABORTED, f"replaced: its mode is {mode}")
    progress = going()
    progress.on_state(state(), 100.2)
    assert progress.on_state(state(mode="POSCTL"), 100.4) == (ABORTED, "replaced: its mode is POSCTL")


def test_a_vehicle_that_is_disarmed_or_not_heard_ends_it() -> None:
    progress = going("takeoff")
    assert progress.on_state(state(armed=False, landed="on_ground"), 100.2) is None  # an old state
    progress.on_state(state(landed="takeoff"), 100.4)
    assert progress.on_state(state(armed=False, landed="on_ground"), 100.6) == (ABORTED, "it was disarmed")
    assert going().on_state(state(connected=False), 100.2) == (ABORTED, "the vehicle is not heard")


@each(
    ("control", "ends"),
    [
        ({"state": "flying", "reference": {"pos_enu_m": [3.0, 4.0, 10.0]}}, False),
        ({"state": "flying", "reference": {"pos_enu_m": [-3.0, -4.0, 10.0]}}, True),
        ({"state": "flying", "reference": {"pos_enu_m": [None, None, 10.0]}}, True),
        ({"state": "flying", "reference": {"pos_enu_m": [3.0, 4.0, 10.0]}, "trajectory": {"name": "loop"}}, True),
        ({"state": "off"}, False),
        ({"state": "flying", "reference": None}, False),
    ],
)
def test_flight_control_that_leads_elsewhere_replaces_it(control: dict[str, Any], ends: bool) -> None:
    progress = going()
    begin = {"state": "flying", "reference": {"pos_enu_m": [0.0, 0.0, 10.0]}}
    assert progress.on_state(state(mode="OFFBOARD", control=begin), 100.2) is None
    assert (progress.on_state(state(mode="OFFBOARD", control=control), 100.4) is not None) is ends


def test_silence_and_standing_still_end_it() -> None:
    progress = going()
    progress.on_state(state(), 100.2)
    assert progress.on_time(100.2 + SILENT_S) is None
    silent = progress.on_time(100.3 + SILENT_S)
    assert silent is not None and silent.status == ABORTED and "no state" in silent.reason
    progress = going()
    for tick in range(1, int(STALLED_S)):
        now = 100.0 + tick
        assert progress.on_state(state(position={"enu_m": [0.01 * tick, 0.0, 10.0]}), now) is None
        assert progress.on_time(now) is None
    progress.on_state(state(), 101.0 + STALLED_S)
    stalled = progress.on_time(101.5 + STALLED_S)
    assert stalled is not None and "no nearer" in stalled.reason


def test_a_landing_below_home_goes_on_as_long_as_it_sinks() -> None:
    """The ground may lie below home: its distance is 0 there, and it still comes nearer."""
    progress = going("land")
    for second in range(1, 80):
        sinking = state(mode="AUTO.LAND", position={"alt_rel_m": 10.0 - 0.7 * second, "vel_enu_mps": [0.0, 0.0, -0.7]})
        assert progress.on_state(sinking, 100.0 + second) is None and progress.on_time(100.0 + second) is None
    end = progress.on_time(100.0 + 79 + STALLED_S + 1.0) or progress.on_time(100.0 + 79 + STALLED_S + 1.0)
    assert end is not None and end.status == ABORTED


def test_a_goto_without_a_height_keeps_that_of_its_execution() -> None:
    """It was sent while the vehicle climbed, and waited for the end of the take-off."""
    fields = {"frame": 1, "lat_deg": 43.0, "lon_deg": -79.0}
    progress = OrderProgress("goto", goal("goto", **fields), state(position={"alt_rel_m": 2.0}))
    assert progress.on_event(outcome("goto")) is None and progress.accepted(100.0) is None
    end = progress.on_state(state(position={"alt_rel_m": 10.0}), 100.2)
    assert end is not None and end.status == SUCCEEDED
