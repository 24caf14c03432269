"""The fleet's origin: its checks, taking it from a vehicle's position, and sending it to a vehicle; and that of an
ArduCopter's estimator.

The fleet's world frame exists in the daemon and needs nothing from a vehicle. Sending the origin to a vehicle
(SET_GPS_GLOBAL_ORIGIN) moves the vehicle's *own* local frame; programs on board may then share our frame. The firmwares
differ:

PX4 accepts it at any time, for its own system id only (MavlinkReceiver, 1.16), and moves its estimator's frame with it.
It answers at once with a GPS_GLOBAL_ORIGIN that may still be the old one. ArduPilot accepts it while it has none, which
with GPS is before the first fix, and ignores it silently afterwards (GCS_Common, GCS_MAVLINK::set_ekf_origin). So the
vehicle's origin is requested afterwards, and compared.

Where an ArduCopter's estimator has its origin, and a place on earth as a setpoint in its local frame:

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
from collections.abc import Iterable
from dataclasses import dataclass, replace

from skygcs.core.control.cascade import Vector
from skygcs.core.geo import Origin, distance_m, swapped_hint, wrap_deg_180, wrap_deg_360
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.protocols.command import CommandSpec
from skygcs.core.vehicle import orders
from skygcs.core.vehicle.autopilot import firmware_name
from skygcs.core.vehicle.flight_evidence import why_not_idle
from skygcs.core.vehicle.frames import GeodeticPosition
from skygcs.core.vehicle.order_plan import Expectation, MessageAfter, Plan, Step
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.spelling import rounded

REACH_M = 20_000.0
"""At this distance the flat frame is 31 m above the ground; such an origin belongs to another site,
or is another vehicle's."""

ALT_AMSL_M = (-500.0, 9_000.0)
"""From the shore of the Dead Sea to the highest mountain."""

HERE_FRESH_S = 3.0
"""Older positions are refused; the slowest stream profile sends 0.5 Hz."""

GPS_FRESH_S = 10.0
FIX_3D = 3

SAME_M = 0.5
"""PX4 keeps the altitude as a 32-bit float and reports rounded values; a difference of metres is another origin."""

POSES_ALT_M = 0.5
"""How far from 0 the altitude of a PX4's origin may be for it to fly by poses. PX4 1.16 takes the height of a pose for
an altitude each time it begins with poses again (Ekf::controlEvHeightFusion, resetAltitudeTo(-measurement)): with the
origin at 180 m one without poses for 0.6 s took itself for 180 m too low, and climbed at 2.8 m/s (SIH, 1.16.1)."""

SETTING_MESSAGE = "SET_GPS_GLOBAL_ORIGIN"


def checked(origin: Origin) -> Origin:
    """The origin with its heading in [0, 360). Raises RefusedError for impossible values."""
    orders.check_coordinate(origin.lat_deg, origin.lon_deg)
    low, high = ALT_AMSL_M
    if not low <= origin.alt_amsl_m <= high:  # also true for NaN
        raise RefusedError(
            f"an altitude of {rounded(origin.alt_amsl_m)} m above mean sea level is not between {low:g} and {high:g}"
        )
    if not math.isfinite(origin.x_heading_deg):
        raise RefusedError(f"a heading of {origin.x_heading_deg:g} degrees is not finite")
    return replace(origin, x_heading_deg=wrap_deg_360(origin.x_heading_deg))


def require_near(origin: Origin, vehicles: Iterable[Vehicle]) -> None:
    """Raises RefusedError if a connected vehicle is farther away than REACH_M, most likely by a typing error."""
    for vehicle in vehicles:
        position = vehicle.telemetry("position")
        if not vehicle.connected or vehicle.replayed or position is None or position["lat_deg"] is None:
            continue
        away_m = distance_m(origin.lat_deg, origin.lon_deg, position["lat_deg"], position["lon_deg"])
        if away_m > REACH_M:
            near = (position["lat_deg"], position["lon_deg"])
            hint = swapped_hint(origin.lat_deg, origin.lon_deg, near, REACH_M)
            raise RefusedError(
                f"that is {away_m / 1000:.0f} km from {vehicle.name}, and the frame is usable within "
                f"{REACH_M / 1000:g} km{hint}; {orders.FORCE_HINT}"
            )


def from_vehicle(vehicle: Vehicle, now: float, *, heading: bool, force: bool = False) -> Origin:
    """An origin at its present position, with ``heading`` its nose along x. Raises RefusedError if they are not known
    well enough; ``force`` accepts a position without a 3D fix, never an old one."""
    orders.require_connected(vehicle, now)
    position, at = vehicle.telemetry("position"), vehicle.telemetry_at("position")
    if position is None or at is None or position["lat_deg"] is None:
        raise RefusedError(f"{vehicle.name} has not reported its position yet (GLOBAL_POSITION_INT)")
    if now - at > HERE_FRESH_S:
        raise RefusedError(f"the position of {vehicle.name} is {now - at:.1f} s old; {HERE_FRESH_S:g} s is the limit")
    if not force:
        _require_fix(vehicle, now)
    if heading and position["heading_deg"] is None:
        raise RefusedError(f"{vehicle.name} does not report its heading; give one, or leave it out")
    origin = Origin(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"])
    return replace(origin, x_heading_deg=position["heading_deg"]) if heading else origin


def _require_fix(vehicle: Vehicle, now: float) -> None:
    gps, at = vehicle.telemetry("gps"), vehicle.telemetry_at("gps")
    if gps is None or at is None or now - at > GPS_FRESH_S:
        raise RefusedError(f"whether {vehicle.name} has a GPS fix is not known (GPS_RAW_INT); {orders.FORCE_HINT}")
    if gps["fix_type"] < FIX_3D:
        raise RefusedError(f"{vehicle.name} has no 3D fix ({gps['fix']}); {orders.FORCE_HINT}")


@dataclass(frozen=True, slots=True)
class OriginIs:
    """A GPS_GLOBAL_ORIGIN after the first ``count`` of them has this origin."""

    origin: Origin
    count: int

    def met(self, vehicle: Vehicle, now: float) -> bool:
        away_m = off_m(vehicle, self.origin)
        return vehicle.count(ORIGIN_MESSAGE) > self.count and away_m is not None and away_m <= SAME_M

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        return kept(vehicle, self.origin) if vehicle.count(ORIGIN_MESSAGE) > self.count else f"no {ORIGIN_MESSAGE} came"


def announce(vehicle: Vehicle, now: float, dialect: Dialect, origin: Origin, *, force: bool = False) -> Plan:
    """Send the origin, then request the one the vehicle has. Raises RefusedError."""
    orders.require_connected(vehicle, now)
    for name in (SETTING_MESSAGE, ORIGIN_MESSAGE):
        if name not in dialect.by_name:
            raise RefusedError(f"dialect {dialect.name} has no {name}")
    if not force and (why := why_not_idle(vehicle, now)) is not None:
        raise RefusedError(
            f"{why}, and its local frame would move under a program that uses it; disarm it, or {orders.FORCE_HINT}"
        )
    # the message, and what the vehicle shows of it afterwards
    values = {
        "latitude": round(origin.lat_deg * 1e7),
        "longitude": round(origin.lon_deg * 1e7),
        "altitude": round(origin.alt_amsl_m * 1000),
    }
    count = vehicle.count(ORIGIN_MESSAGE)
    expect: Expectation = OriginIs(origin, count)
    if vehicle.family == "ardupilot":  # it answers once only
        expect = MessageAfter(ORIGIN_MESSAGE, count)
    request = CommandSpec(mav_cmd.REQUEST_MESSAGE, (float(dialect.by_name[ORIGIN_MESSAGE].msgid),))
    steps = (
        Step("send the origin", message=(SETTING_MESSAGE, values)),
        Step(
            "request its origin",
            request,
            expect=expect,
            refused=f"{firmware_name(vehicle)} has no {ORIGIN_MESSAGE} to send: its estimator has no origin",
        ),
    )
    return Plan("origin", steps, "its own origin is the fleet's now (its axes stay east and north)")


def off_m(vehicle: Vehicle, origin: Origin) -> float | None:
    """Distance from ``origin`` to the origin the vehicle reported last, height included; None if it reported none."""
    own = vehicle.telemetry("ekf_origin")
    if own is None:
        return None
    across_m = distance_m(own["lat_deg"], own["lon_deg"], origin.lat_deg, origin.lon_deg)
    return math.hypot(across_m, own["alt_amsl_m"] - origin.alt_amsl_m)


def why_no_poses(vehicle: Vehicle) -> str | None:
    """Why a vehicle with this origin of its own must not fly by poses; None if it may."""
    own = vehicle.telemetry("ekf_origin")
    if vehicle.family != "px4" or own is None or abs(own["alt_amsl_m"]) <= POSES_ALT_M:
        return None
    return (
        f"its origin is at an altitude of {own['alt_amsl_m']:.1f} m: after a drop-out a PX4 takes the height of a pose "
        "for an altitude, and would climb or sink by that much; set alt_amsl_m = 0 in [origin], then reboot it"
    )


def kept(vehicle: Vehicle, origin: Origin) -> str:
    """The vehicle's origin if that differs from ``origin``, and the reason, for the user."""
    own, away_m = vehicle.telemetry("ekf_origin"), off_m(vehicle, origin)
    if own is None or away_m is None:
        return "it reports no origin"
    has = f"it still has {own['lat_deg']:.7f}, {own['lon_deg']:.7f}, {own['alt_amsl_m']:.1f} m, {away_m:.1f} m away"
    if vehicle.family == "ardupilot":
        return f"{has}: ArduPilot has an origin already and does not change it before it reboots"
    return has


ORIGIN_MESSAGE = "GPS_GLOBAL_ORIGIN"
LOCAL_MESSAGE = "LOCAL_POSITION_NED"

METRES_PER_DEG = 0.011131884502145034e7
"""ArduPilot's LATLON_TO_M (AP_Math/definitions.h), for latitude and longitude alike: not WGS84's radii, from which it
differs by up to 0.5 %. What ArduPilot makes of a place on earth is what is meant here."""

REPORTED_SAME_M = 0.1
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
            if moved_m > REPORTED_SAME_M:
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
