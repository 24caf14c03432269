"""Every flight of the table of `skygcs.sim.behaviours`, and what of its figures is compared with the table."""

from __future__ import annotations

from collections.abc import Callable

from support.attitude_flights import attitude_targets, check_attitude_targets
from support.behaviour_flights import (
    Figures,
    Findings,
    answers,
    answers_in_flight,
    attitude_then_silence,
    battery_critical,
    beyond_the_fence,
    check_answers,
    check_answers_in_flight,
    check_attitude_then_silence,
    check_battery_critical,
    check_beyond_the_fence,
    check_gps_lost,
    check_ground_station_lost,
    check_idle,
    check_modes,
    check_offboard_entry,
    check_position_and_velocity,
    check_returns,
    check_up_there_and_down,
    check_velocity_then_silence,
    gps_lost,
    ground_station_lost,
    idle_on_the_ground,
    modes,
    offboard_entry,
    position_and_velocity,
    returns,
    up_there_and_down,
    velocity_then_silence,
)
from support.behaviour_rig import Rig
from support.followed_targets import check_circles, circles

CHECKS: dict[str, tuple[Callable[[Rig], Figures], Callable[[Rig, Figures, Findings], None]]] = {
    "modes on the ground": (modes, check_modes),
    "idle on the ground": (idle_on_the_ground, check_idle),
    "answers": (answers, check_answers),
    "up, there and down": (up_there_and_down, check_up_there_and_down),
    "answers in flight": (answers_in_flight, check_answers_in_flight),
    "velocity then silence": (velocity_then_silence, check_velocity_then_silence),
    "attitude then silence": (attitude_then_silence, check_attitude_then_silence),
    "position and velocity": (position_and_velocity, check_position_and_velocity),
    "offboard entry": (offboard_entry, check_offboard_entry),
    "ground station lost": (ground_station_lost, check_ground_station_lost),
    "beyond the fence": (beyond_the_fence, check_beyond_the_fence),
    "returns": (returns, check_returns),
    "gps lost": (gps_lost, check_gps_lost),
    "circle": (circles, check_circles),
    "attitude targets": (attitude_targets, check_attitude_targets),
    # Last: ArduCopter does not arm again after its battery failsafe.
    "battery critical": (battery_critical, check_battery_critical),
}


def fly(name: str, rig: Rig, *, late_s: float = 0.0) -> tuple[Figures, list[str]]:
    """The figures of one flight, and what in them is not as the table says."""
    flight, compare = CHECKS[name]
    figures = flight(rig)
    found = Findings(late_s)
    compare(rig, figures, found)
    return figures, list(found)
