"""Where an ArduCopter's estimator has its origin, and a place on earth as a setpoint in its local frame says it. Pure.

ArduCopter takes an acceleration beside position and velocity in SET_POSITION_TARGET_LOCAL_NED only, and that counts
from its estimator's origin (GPS_GLOBAL_ORIGIN). Where the origin is wrong, the vehicle flies to another place; so it is
used only while nothing speaks against it:

    what                                                                then
    -----------------------------------------------------------------   -------------------------------------------
    no GPS_GLOBAL_ORIGIN since it started                               none
    one farther than REACH_M from the vehicle                           none
    another one than before, in the same flight by setpoints            none from then on: EKF3 keeps its origin until
                                                                        it reboots (NavEKF3::setOriginLLH), so one of
                                                                        the two was not the vehicle's
    a LOCAL_POSITION_NED that differs from GLOBAL_POSITION_INT          none from then on
    by more than DIFFERENCE_M

A reset of its position moves both of its positions and not the origin: the place on earth stays the one that was meant.
Without an origin the same place goes as SET_POSITION_TARGET_GLOBAL_INT, without the acceleration.
"""

from __future__ import annotations

import math

from skygcs.core.control.cascade import Vector
from skygcs.core.geo import Origin, distance_m, wrap_deg_180
from skygcs.core.vehicle.frames import GeodeticPosition
from skygcs.core.vehicle.vehicle import Vehicle

ORIGIN_MESSAGE = "GPS_GLOBAL_ORIGIN"
LOCAL_MESSAGE = "LOCAL_POSITION_NED"

METRES_PER_DEG = 0.011131884502145034e7
"""ArduPilot's LATLON_TO_M (AP_Math/definitions.h), for latitude and longitude alike: not WGS84's radii, from which it
differs by up to 0.5 %. What ArduPilot makes of a place on earth is what is meant here."""

REACH_M = 20_000.0
"""Farther off ArduPilot's flat frame is no place to send a vehicle by, and the origin most likely another vehicle's."""

SAME_M = 0.1
"""Two reports of one origin: the message carries 1e-7 degrees and millimetres."""

DIFFERENCE_M = 1.0
"""Between the two positions of one estimator, after their velocity and the time between them: centimetres of rounding
and milliseconds of dating."""

TOGETHER_S = 0.3
"""Two positions farther apart in time are not compared: at 10 m/s a dating error of 10 % is 0.3 m."""


class EstimatorOrigin:
    """Estimator origin of one vehicle, during one flight by setpoints: `begin`, then `local_enu_m` for each
    setpoint."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._origin: Origin | None = None
        self._distrusted: str | None = None
        self._origins = -1
        self._locals = -1

    @property
    def distrusted(self) -> str | None:
        """Why it is not used in this flight although the vehicle has reported one; None: nothing speaks against it."""
        return self._distrusted

    def begin(self) -> None:
        """A new flight by setpoints: what was distrusted in the last is looked at anew."""
        self._origin, self._distrusted, self._origins, self._locals = None, None, -1, -1

    def local_enu_m(self, place: GeodeticPosition) -> Vector | None:
        """East, north and up of a place from the estimator's origin, as ArduPilot computes it
        (`Location::get_vector_from_origin_NEU`); None while the origin is not known, or not trusted."""
        self._look()
        origin = self._origin
        if origin is None or self._distrusted is not None:
            return None
        return _offset_m(place.lat_deg, place.lon_deg, place.alt_amsl_m, origin)

    def _look(self) -> None:
        """Look at what came since the last look."""
        vehicle = self._vehicle
        if self._distrusted is not None:
            return
        count = vehicle.count(ORIGIN_MESSAGE)
        if count != self._origins:
            self._origins = count
            self._take_origin()
        count = vehicle.count(LOCAL_MESSAGE)
        if count != self._locals:
            self._locals = count
            self._compare()

    def _take_origin(self) -> None:
        reported = self._vehicle.telemetry("ekf_origin")
        if reported is None:
            self._origin = None  # it has rebooted
            return
        origin = Origin(reported["lat_deg"], reported["lon_deg"], reported["alt_amsl_m"])
        before = self._origin
        if before is not None:
            moved_m = math.hypot(
                distance_m(before.lat_deg, before.lon_deg, origin.lat_deg, origin.lon_deg),
                before.alt_amsl_m - origin.alt_amsl_m,
            )
            if moved_m > SAME_M:
                self._distrusted = f"its reported estimator origin moved by {moved_m:.1f} m"
            return
        position = self._vehicle.telemetry("position")
        if position is None or position["lat_deg"] is None:
            self._origins = -1  # to be looked at again, with a position
            return
        away_m = distance_m(position["lat_deg"], position["lon_deg"], origin.lat_deg, origin.lon_deg)
        if away_m > REACH_M:
            self._distrusted = f"its reported estimator origin is {away_m / 1000:.0f} km away"
            return
        self._origin = origin

    def _compare(self) -> None:
        vehicle, origin = self._vehicle, self._origin
        local, position = vehicle.telemetry("local"), vehicle.telemetry("position")
        local_at, position_at = vehicle.telemetry_at("local"), vehicle.telemetry_at("position")
        if origin is None or local is None or position is None or local_at is None or position_at is None:
            return
        if position["lat_deg"] is None or None in local["pos_enu_m"] or None in local["vel_enu_mps"]:
            return
        apart_s = position["time_boot_s"] - local["time_boot_s"]
        if abs(apart_s) > TOGETHER_S:
            return
        here = _offset_m(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"], origin)
        moved = (at + v * apart_s for at, v in zip(local["pos_enu_m"], local["vel_enu_mps"], strict=True))
        off_m = math.dist(here, tuple(moved))
        if off_m > DIFFERENCE_M:
            self._distrusted = f"its local position and its position on earth are {off_m:.1f} m apart"


def _offset_m(lat_deg: float, lon_deg: float, alt_amsl_m: float, origin: Origin) -> Vector:
    north = (lat_deg - origin.lat_deg) * METRES_PER_DEG
    scale = max(math.cos(math.radians((lat_deg + origin.lat_deg) / 2.0)), 0.01)  # Location::longitude_scale
    east = wrap_deg_180(lon_deg - origin.lon_deg) * METRES_PER_DEG * scale
    return east, north, alt_amsl_m - origin.alt_amsl_m
