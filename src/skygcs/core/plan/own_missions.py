"""The mission by which an autopilot flies its way of a plan by itself: from corner to corner, resting at each. Pure.

Both firmwares fly a straight way between waypoints and cut a corner where they do not have to stop. They stop at a
waypoint with a time to hold: PX4 leaves out the next setpoint for it (mission.cpp, brake_for_hold, 1.16), ArduCopter
the next destination (mode_auto.cpp, set_next_wp, 4.6).
"""

from __future__ import annotations

from collections.abc import Sequence

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import GLOBAL, MissionItem
from skygcs.core.mission.plan import MissionPlan

HOLD_S = 1.0
"""ArduCopter counts whole seconds."""

WITHIN_M = 0.5
"""A PX4 begins to hold within it; by default 2 m from the corner and more (NAV_ACC_RAD), and the hold would be over
before it is there. ArduCopter takes no notice: it holds where its own path has ended."""


def mission_along(places: Sequence[tuple[float, float, float]]) -> MissionPlan:
    """A mission through these places: latitude and longitude in degrees, height above mean sea level in metres. The
    vehicle stands at the first one, which is no item unless it is the only one."""
    items = tuple(
        MissionItem.from_params(
            mav_cmd.NAV_WAYPOINT, GLOBAL, (HOLD_S, WITHIN_M, 0.0, None, lat_deg, lon_deg, alt_amsl_m), True
        )
        for lat_deg, lon_deg, alt_amsl_m in (places[1:] or places)
    )
    return MissionPlan(items)
