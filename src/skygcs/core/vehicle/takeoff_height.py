"""The altitude that a take-off gives to the autopilot, so that it ends at a height above the ground it stands on.

    firmware     what NAV_TAKEOFF takes                             what is sent
    ----------   ------------------------------------------------   --------------------------------------------------
    PX4          AMSL (navigator/takeoff.cpp)                       altitude of the ground + height
    ArduCopter   height above home (ModeGuided,                     height of the ground above home + height; both may
                 do_user_takeoff_start; not below where it          be negative
                 stands: takeoff.cpp, do_user_takeoff)
    the same     height above the ground, with a range finder       only where home is at the height of the ground
                 that is used and reaches so far

An ArduCopter moves a home that no station has set to where it stands when it arms (AP_Arming_Copter::arm), and a
station may move it at any time. So the command is made when its step begins, after the arming, from a position that
came later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from skygcs.core.mavlink import mav_cmd
from skygcs.core.protocols.command import CommandSpec
from skygcs.core.vehicle.decoding import TelemetryGroup
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError

FRESH_S = 10.0
"""Oldest position from which a take-off is computed; the slowest stream profile sends 0.5 Hz. It stands there."""

LEVEL_M = 1.0
"""A home within this height of the ground is at the height of the ground: barometers drift by as much."""

RANGE_FINDERS = ("DISTANCE_SENSOR", "RANGEFINDER")
"""Messages of a vehicle that has a range finder."""

NAN = math.nan


@dataclass(frozen=True, slots=True)
class StandsSinceArming:
    """A position has come since the vehicle was armed: its heights count from the home of this flight."""

    def met(self, vehicle: Vehicle, now: float) -> bool:
        return standing_position(vehicle, now) is not None

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        return "no position has come since it was armed"


@dataclass(frozen=True, slots=True)
class ClimbTo:
    """NAV_TAKEOFF to ``height_m`` above the ground on which the vehicle stands when the step begins."""

    height_m: float

    def command(self, vehicle: Vehicle, now: float) -> CommandSpec:
        """Raises RefusedError if the height of the ground is not known."""
        position = standing_position(vehicle, now)
        if position is None:
            raise RefusedError("no position has come since it was armed, so the height to climb to is not known")
        if vehicle.family == "px4":
            return _climb(NAN, float(position["alt_amsl_m"]) + self.height_m)
        ground_m = float(position["alt_rel_m"])
        if abs(ground_m) > LEVEL_M and any(vehicle.count(name) for name in RANGE_FINDERS):
            raise RefusedError(
                f"it has a range finder, and its home is {home_offset(ground_m)} the ground that it stands on: which "
                "of the two its take-off counts from is not known; set its home here (skygcs-cli home)"
            )
        return _climb(0.0, ground_m + self.height_m)


def standing_position(vehicle: Vehicle, now: float) -> TelemetryGroup | None:
    """Its position if that is fresh and, where its heights count from home, not older than its arming; else None."""
    position, at = vehicle.timed_telemetry("position")
    if position is None or at is None or position["lat_deg"] is None or now - at > FRESH_S:
        return None
    counts = vehicle.family == "px4" or not vehicle.armed or at >= vehicle.armed_since
    return position if counts else None


def home_offset(ground_m: float) -> str:
    """The place of home in words: "3.0 m below", by the height of the ground above it."""
    return f"{abs(ground_m):.1f} m {'below' if ground_m > 0 else 'above'}"


def _climb(place: float, altitude_m: float) -> CommandSpec:
    """``place``: yaw, latitude and longitude; PX4 flies to any that is a number."""
    return CommandSpec(mav_cmd.NAV_TAKEOFF, (0.0, 0.0, 0.0, place, place, place, altitude_m))
