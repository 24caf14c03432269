"""OFFBOARD step by step: the table of the module."""

from __future__ import annotations

from typing import Any

from skygcs.core.ros.setpoints import Demand
from skygcs.ext.ros.offboard import ATTEMPTS, Engage, Offboard, TakeOff

CLIMB = Demand("position", {"pos_enu_m": [0, 0, 4], "yaw_deg": 0}, 4.0)


def state(armed: bool, landed: str, control: str | None = None, up_m: float = 0.1) -> dict[str, Any]:
    return {
        "armed": armed,
        "landed": landed,
        "control": None if control is None else {"state": control},
        "local": {"pos_enu_m": [0.0, 0.0, up_m]},
    }


GROUND, ARMED, AIR = state(False, "on_ground"), state(True, "on_ground"), state(True, "in_air", up_m=3.0)
FLOWN = state(True, "in_air", "flying", up_m=4.0)


def wished(now: float = 0.0) -> Offboard:
    offboard = Offboard()
    offboard.on_demand(CLIMB, now)
    assert offboard.wish("OFFBOARD", now) is None
    return offboard


def flying() -> Offboard:
    offboard = wished()
    assert offboard.next_step(AIR, 0.1) == Engage("position")
    assert offboard.on_engaged("position", True, 0.2)
    assert offboard.state == "flying"
    return offboard


def test_without_setpoints_it_is_refused() -> None:
    offboard = Offboard()
    assert offboard.wish("OFFBOARD", 0.0) is not None
    offboard.on_demand(CLIMB, 0.0)
    assert offboard.wish("OFFBOARD", 0.6) is not None
    assert (offboard.state, offboard.shown_mode) == ("idle", "")


def test_a_px4_node_may_set_offboard_before_its_first_setpoint_while_it_shows_that_it_lives() -> None:
    """As PX4's own example in Python does: it waits for OFFBOARD in vehicle_status."""
    offboard = Offboard()
    offboard.on_proof(0.0)
    assert offboard.wish("OFFBOARD", 0.1) is None and offboard.shown_mode == "OFFBOARD"
    assert offboard.next_step(ARMED, 0.4) is None and offboard.state == "wished"
    offboard.on_proof(0.5)
    offboard.on_demand(CLIMB, 0.6)
    assert isinstance(offboard.next_step(ARMED, 0.6), TakeOff)
    silent = Offboard()
    silent.on_proof(0.0)
    assert silent.wish("OFFBOARD", 0.1) is None
    assert silent.next_step(ARMED, 0.7) is None and silent.state == "idle", "a node that stops, stops"


def test_it_takes_off_once_when_armed_and_is_engaged_in_the_air() -> None:
    offboard = wished()
    assert offboard.next_step(GROUND, 0.1) is None
    step = offboard.next_step(ARMED, 0.2)
    assert isinstance(step, TakeOff) and step.height_m is not None and abs(step.height_m - 3.9) < 1e-9
    assert offboard.next_step(ARMED, 0.3) is None
    assert offboard.next_step(AIR, 0.4) == Engage("position")
    assert offboard.next_step(AIR, 0.45) is None
    assert offboard.on_engaged("position", True, 0.5) and offboard.shown_mode == "OFFBOARD"


def test_a_setpoint_on_the_ground_is_no_take_off() -> None:
    offboard = Offboard()
    for demand in (CLIMB._replace(climbs_m=0.3), CLIMB._replace(climbs_m=None)):
        offboard.on_demand(demand, 0.0)
        offboard.wish("OFFBOARD", 0.0)
        assert offboard.next_step(ARMED, 0.1) is None
    offboard.on_demand(Demand("velocity", {"vel_enu_mps": [1.0, 0.0, 0.0]}), 0.1)
    assert offboard.next_step(ARMED, 0.2) is None
    offboard.on_demand(Demand("velocity", {"vel_enu_mps": [0.0, 0.0, 1.0]}), 0.2)
    assert offboard.next_step(ARMED, 0.3) == TakeOff(None)


def test_a_node_that_stops_before_the_flight_ends_it() -> None:
    offboard = wished()
    assert offboard.next_step(ARMED, 0.6) is None
    assert offboard.state == "idle"
    offboard.on_demand(CLIMB, 1.0)  # it comes back, and has to ask again
    assert offboard.next_step(ARMED, 1.1) is None


def test_control_that_has_ended_needs_a_new_set_mode() -> None:
    offboard = flying()
    assert offboard.next_step(AIR, 0.3) is None and offboard.state == "flying"  # the state is older than the engagement
    offboard.on_demand(CLIMB, 1.0)
    assert offboard.next_step(FLOWN, 1.0) is None
    offboard.on_demand(CLIMB, 3.0)
    assert offboard.next_step(AIR, 3.0) is None and offboard.state == "idle"  # a person took over
    offboard.on_demand(CLIMB, 3.1)
    assert offboard.next_step(AIR, 3.1) is None


def test_setpoints_of_another_mode_change_it() -> None:
    offboard = flying()
    offboard.on_demand(Demand("velocity", {"vel_enu_mps": [0, 0, 0]}), 3.0)
    assert offboard.next_step(FLOWN, 3.0) == Engage("velocity")


def test_refusals_end_it_after_some_attempts() -> None:
    offboard, now = wished(), 0.0
    for attempt in range(ATTEMPTS):
        now += 3.0
        offboard.on_demand(CLIMB, now)
        assert offboard.next_step(AIR, now) == Engage("position")
        offboard.on_demand(CLIMB, now + 0.1)
        assert offboard.next_step(AIR, now + 0.1) is None
        assert offboard.on_engaged("position", False, now + 0.1) is (attempt < ATTEMPTS - 1)
    assert offboard.state == "idle"


def test_disarming_ends_it() -> None:
    offboard = wished()
    offboard.next_step(ARMED, 0.1)
    offboard.on_demand(CLIMB, 0.2)
    assert offboard.next_step(GROUND, 0.2) is None
    assert (offboard.state, offboard.shown_mode) == ("idle", "")


def test_guided_waits_for_setpoints_and_takes_off_by_an_order() -> None:
    offboard = Offboard()
    offboard.wish_guided()
    assert offboard.next_step(ARMED, 0.0) is None and offboard.shown_mode == ""
    offboard.on_demand(CLIMB, 5.0)
    assert offboard.next_step(ARMED, 5.1) is None  # no take-off by itself
    assert offboard.next_step(AIR, 9.0) is None and offboard.state == "wished"
    offboard.on_demand(CLIMB, 10.0)
    assert offboard.next_step(AIR, 10.1) == Engage("position")
