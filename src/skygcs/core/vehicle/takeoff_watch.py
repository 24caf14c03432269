"""Whether a take-off that was ordered here has come to its end undisturbed, so that control may begin. Pure.

    climbs      the mode is the one the take-off set (PX4 AUTO.TAKEOFF, ArduCopter GUIDED)
    reached     at its height and level; a PX4 has then gone to AUTO.LOITER by itself
    disturbed   any other mode, disarmed, on the ground again, lost, its own failsafe, AUTO.LOITER below the height, or
                longer than it can take: a pilot, another station or the autopilot decided otherwise

A disturbed one is never taken over.
"""

from __future__ import annotations

import math
from typing import Literal

from skygcs.core.vehicle.vehicle import Vehicle

SHORT_M = 0.5
"""PX4 ends a take-off within NAV_MC_ALT_RAD (0.8 m) and flies the rest in AUTO.LOITER; ArduCopter within 0.1 m."""

SHARE = 0.1
"""Of a low height, instead."""

LEVEL_MPS = 0.4
"""Slower than this it has arrived: both firmwares climb with 1 m/s and more and slow down at the end."""

SETTLE_S = 5.0
"""So long may a PX4 be in AUTO.LOITER and below its height, on the last part of its climb."""

SLOWEST_MPS = 0.3
SPOOL_S = 20.0

Verdict = Literal["climbs", "reached"]


class TakeoffWatch:
    """Of one take-off. ``from_amsl_m``: where it stood. Times are the loop's."""

    def __init__(self, vehicle: Vehicle, from_amsl_m: float, height_m: float, now: float) -> None:
        self._vehicle = vehicle
        self._target_amsl_m = from_amsl_m + height_m - min(SHORT_M, SHARE * height_m)
        self._until = now + SPOOL_S + height_m / SLOWEST_MPS
        self._loiter_since = math.inf
        self._was_in_air = False

    def look(self, now: float) -> Verdict | str:
        """ "climbs", "reached", or what disturbed it."""
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
        px4 = vehicle.family == "px4"
        if vehicle.mode not in (("AUTO.TAKEOFF", "AUTO.LOITER") if px4 else ("GUIDED",)):
            return f"its mode became {vehicle.mode}"
        if now > self._until:
            return "it did not reach its height in time"
        position = vehicle.telemetry("position")
        if position is None or position["alt_amsl_m"] is None:
            return "climbs"
        high = position["alt_amsl_m"] >= self._target_amsl_m
        level = abs(position["vel_enu_mps"][2]) <= LEVEL_MPS
        if px4 and vehicle.mode == "AUTO.LOITER":
            self._loiter_since = min(self._loiter_since, now)
            if not high and now - self._loiter_since > SETTLE_S:
                return "its mode became AUTO.LOITER below its height"
        else:
            self._loiter_since = math.inf
        return "reached" if high and level and (not px4 or vehicle.mode == "AUTO.LOITER") else "climbs"
