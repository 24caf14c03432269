"""EVENT messages by which PX4 rejects a mission that it has accepted in the upload.

PX4 checks a mission some ms after it has acknowledged the upload (1.16.1: MissionFeasibility/FeasibilityChecker.cpp and
mission_feasibility_checker.cpp) and reports problems by events; the status text with the same content is not sent on
every link. An event's id is a hash of its name (platforms/common/include/px4_platform_common/events.h).
"""

from __future__ import annotations

from collections.abc import Mapping

EVENT = "EVENT"

AUTOPILOT = 1 << 24
"""The high byte of an event's id is the component, the rest the hash."""

REASONS: Mapping[str, str] = {
    "navigator_mis_no_home_rel_alt": "it has no home, and items have heights above it",
    "navigator_mis_unsup_cmd": "a command that it does not fly",
    "navigator_mis_starts_w_landing": "it begins with a landing",
    "navigator_mis_starts_w_landing2": "it begins with a landing",
    "navigator_mis_takeoff_too_low": "the take-off is not above home",
    "navigator_mis_takeoff_not_first": "the take-off is not the first item with a position",
    "navigator_mis_approach_wp_below_land": "the item before the landing is not above it",
    "navigator_mis_land_wp_inside_orbit_radius": "the landing point is within the orbit before it",
    "navigator_mis_unsupported_landing_approach_wp": "the item before the landing is neither waypoint nor orbit",
    "navigator_mis_glide_slope_too_steep": "the descent to the landing is too steep (FW_LND_ANG)",
    "navigator_mis_multiple_land": "there is more than one landing start",
    "navigator_mis_land_before_rtl": "a landing start comes before a return",
    "navigator_mis_invalid_land": "the landing start has no landing",
    "navigator_mis_takeoff_missing": "it needs a take-off (MIS_TKO_LAND_REQ)",
    "navigator_mis_land_missing": "it needs a landing (MIS_TKO_LAND_REQ)",
    "navigator_mis_takeoff_or_land_missing": "it needs a take-off and a landing (MIS_TKO_LAND_REQ)",
    "feasibility_mis_in_air_landing_req": "it needs a landing (MIS_TKO_LAND_REQ)",
    "navigator_mis_add_land_or_rm_to": "it has a take-off and no landing (MIS_TKO_LAND_REQ)",
    "navigator_mis_add_to_or_rm_land": "it has a landing and no take-off (MIS_TKO_LAND_REQ)",
    "navigator_mis_wp_gate_too_close": "a gate is at the position of a waypoint",
    "navigator_mis_vtol_items": "it has items for a VTOL, and the vehicle is not one",
    "navigator_mis_geofence_no_home": "its fence needs a home",
    "navigator_mis_geofence_no_home2": "its fence needs a home",
    "navigator_mis_geofence_violation": "an item is outside its fence",
}


def event_id(name: str) -> int:
    """Event id: 24 bits of the name's FNV-1a hash, and the autopilot's component."""
    value = 0x811C9DC5
    for byte in name.encode("ascii"):
        value = ((value ^ byte) * 0x01000193) & 0xFFFF_FFFF
    return AUTOPILOT | (value & 0xFF_FFFF)


_BY_ID = {event_id(name): reason for name, reason in REASONS.items()}


def rejection(number: int) -> str | None:
    """Why the mission was rejected, if the event with this id is a rejection."""
    return _BY_ID.get(number)
