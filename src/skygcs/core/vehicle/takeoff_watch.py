"""A take-off that is ordered here: the altitude it is given, and whether it goes as it was ordered. Pure.

The altitude that it gives to the autopilot, so that it ends at a height above the ground it stands on:

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

Whether it goes so:

    climbs      the mode is the one the take-off set (PX4 AUTO.TAKEOFF, ArduCopter GUIDED, ArduPlane TAKEOFF)
    reached     at its height and level; a PX4 has then gone to AUTO.LOITER by itself; a plane need not be level
    wrong       above its height, or level in the air below it: it flies to another height than was ordered, an alarm
    disturbed   any other mode, disarmed, on the ground again, lost, its own failsafe, AUTO.LOITER below the height, or
                longer than it can take: a pilot, another station or the autopilot decided otherwise

Control never begins after one that is disturbed or goes to a wrong height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from skygcs.core.mavlink import mav_cmd
from skygcs.core.protocols.command import CommandSpec
from skygcs.core.vehicle.decoding import TelemetryGroup
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError

STANDING_FRESH_S = 10.0
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
    if position is None or at is None or position["lat_deg"] is None or now - at > STANDING_FRESH_S:
        return None
    counts = vehicle.family == "px4" or not vehicle.armed or at >= vehicle.armed_since
    return position if counts else None


def home_offset(ground_m: float) -> str:
    """The place of home in words: "3.0 m below", by the height of the ground above it."""
    return f"{abs(ground_m):.1f} m {'below' if ground_m > 0 else 'above'}"


def _climb(place: float, altitude_m: float) -> CommandSpec:
    """``place``: yaw, latitude and longitude; PX4 flies to any that is a number."""
    return CommandSpec(mav_cmd.NAV_TAKEOFF, (0.0, 0.0, 0.0, place, place, place, altitude_m))


SHORT_M = 0.5
"""PX4 ends a take-off within NAV_MC_ALT_RAD (0.8 m) and flies the rest in AUTO.LOITER; ArduCopter within 0.1 m."""

SHARE = 0.1
"""Share of the height that may be missing at the end, instead of SHORT_M, where the height is low."""

OVER_M = 1.0
OVER_SHARE = 0.05
"""So much above its height, and this share of it, is no overshoot of a controller, nor drift of a barometer on the
way up."""

PLANE_SHORT_M = 3.0
PLANE_OVER_M = 20.0
"""A plane ends its climb before its height (ArduPlane: 2 m, mode_takeoff.cpp) or beyond it (PX4: 10 m above it,
kClearanceAltitudeBuffer), and goes up and down while it turns into its circle."""

LEVEL_MPS = 0.4
"""Slower than this it has arrived: both firmwares climb with 1 m/s and more and slow down at the end."""

SETTLE_S = 5.0
"""So long may a PX4 be in AUTO.LOITER and below its height, on the last part of its climb; and any vehicle in the air
without climbing by `RISE_M`."""

PLANE_SETTLE_S = 20.0
"""`SETTLE_S` of a plane, which gathers speed at a constant height first."""

RISE_M = 0.2

SLOWEST_MPS = 0.3
SPOOL_S = 20.0

FRESH_S = 3.0
"""An older position does not show how high it is; the slowest stream profile sends 0.5 Hz."""

Verdict = Literal["climbs", "reached"]


@dataclass(frozen=True, slots=True)
class WrongHeight:
    """A take-off that leads to another height than was ordered."""

    height_m: float
    """Above the ground it stood on."""
    wanted_m: float

    def __str__(self) -> str:
        what = "it is" if self.height_m > self.wanted_m else "it stopped climbing"
        return f"{what} {self.height_m:.1f} m above the ground it stood on; {self.wanted_m:.1f} m were ordered"


class TakeoffWatch:
    """Watch over one take-off. ``from_amsl_m``: where it stood. Times are the loop's."""

    def __init__(self, vehicle: Vehicle, from_amsl_m: float, height_m: float, now: float) -> None:
        self._vehicle = vehicle
        self._from_amsl_m = from_amsl_m
        self._height_m = height_m
        self._until = now + SPOOL_S + height_m / SLOWEST_MPS
        self._loiter_since = math.inf
        self._was_in_air = False
        self._highest_m = -math.inf
        self._rose_at = math.inf
        self._runs = vehicle.abilities.takeoff.is_ahead
        """It is a plane's: along the ground, and up ahead."""

    def look(self, now: float) -> Verdict | WrongHeight | str:
        """ "climbs", "reached", the wrong height it leads to, or what disturbed it."""
        if (disturbed := self._disturbed(now)) is not None:
            return disturbed
        vehicle = self._vehicle
        position, at = vehicle.timed_telemetry("position")
        if position is None or at is None or position["alt_amsl_m"] is None or now - at > FRESH_S:
            self._rose_at = math.inf  # what it did meanwhile is not known
            return "climbs"
        # where it is, and whether that is where it should end
        up_m = position["alt_amsl_m"] - self._from_amsl_m
        over_m = PLANE_OVER_M if self._runs else OVER_M
        if up_m > self._height_m + over_m + OVER_SHARE * self._height_m:
            return WrongHeight(up_m, self._height_m)
        high = up_m >= self._height_m - min(PLANE_SHORT_M if self._runs else SHORT_M, SHARE * self._height_m)
        level = self._runs or abs(position["vel_enu_mps"][2]) <= LEVEL_MPS
        if high:
            loiters = vehicle.family != "px4" or vehicle.mode == "AUTO.LOITER"
            return "reached" if level and loiters else "climbs"
        return self._below(up_m, now)

    def progress(self) -> str:
        """The climb so far, for people: "1.2 of 5.0 m"."""
        position = self._vehicle.telemetry("position")
        up_m = 0.0 if position is None else position["alt_amsl_m"] - self._from_amsl_m
        return f"{max(0.0, up_m):.1f} of {self._height_m:.1f} m"

    def _disturbed(self, now: float) -> str | None:
        vehicle = self._vehicle
        if not vehicle.connected:
            return "the vehicle was lost"
        if not vehicle.armed:
            return "it was disarmed"
        if vehicle.failsafe:
            return "its own failsafe is active"
        in_air = vehicle.in_air(now)
        self._was_in_air = self._was_in_air or in_air is True
        if self._was_in_air and in_air is False:
            return "it is on the ground again"
        own = ("TAKEOFF",) if self._runs else ("GUIDED",)
        if vehicle.mode not in (("AUTO.TAKEOFF", "AUTO.LOITER") if vehicle.family == "px4" else own):
            return f"its mode became {vehicle.mode}"
        return "it did not reach its height in time" if now > self._until else None

    def _below(self, up_m: float, now: float) -> Verdict | WrongHeight | str:
        """Judge a vehicle that is below its height: does it still climb?"""
        if self._vehicle.mode == "AUTO.LOITER":
            self._loiter_since = min(self._loiter_since, now)
            if now - self._loiter_since > SETTLE_S:
                return "its mode became AUTO.LOITER below its height"
        else:
            self._loiter_since = math.inf
        if up_m > self._highest_m + RISE_M or not self._was_in_air or math.isinf(self._rose_at):
            self._highest_m, self._rose_at = max(up_m, self._highest_m), now
        sinks = now - self._rose_at > (PLANE_SETTLE_S if self._runs else SETTLE_S)
        return WrongHeight(up_m, self._height_m) if sinks else "climbs"


def reports_takeoff(vehicle: Vehicle, now: float) -> bool:
    """True if the vehicle itself reports a take-off under way, ordered by any program. The landed state may be two
    seconds old: a take-off that was ordered here is judged by its watch."""
    return vehicle.armed and (vehicle.mode == "AUTO.TAKEOFF" or vehicle.landed(now) == "takeoff")
