"""The fleet's origin: which are refused, how one is taken from a vehicle, and how a vehicle is told of it.

The fleet's world frame lives in the daemon and asks nothing of a vehicle. Telling a vehicle (SET_GPS_GLOBAL_ORIGIN)
moves its *own* local frame, which only helps programs on board that share a frame with ours. The firmwares differ:

PX4 takes it at any time, for its own system id only (MavlinkReceiver, 1.16), and moves its estimator's frame with it.
It answers at once with a GPS_GLOBAL_ORIGIN that may still be the old one. ArduPilot takes it while it has none, which
with GPS is before the first fix, and drops it without a word afterwards (GCS_Common, `set_ekf_origin`). So what it has
in the end is asked for, and compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from skygcs.core.geo import Origin, distance_m, wrap_deg_360
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.protocols.command import CommandSpec
from skygcs.core.vehicle import orders
from skygcs.core.vehicle.autopilot import REQUEST_MESSAGE, firmware_name
from skygcs.core.vehicle.flight_evidence import why_not_idle
from skygcs.core.vehicle.order_plan import Expectation, MessageAfter, Plan, Step
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError

REACH_M = 20_000.0
"""Farther from the origin the flat frame is 31 m above the ground; an origin that far off is one of another site."""

ALT_AMSL_M = (-500.0, 9_000.0)
"""From the shore of the Dead Sea to the highest mountain."""

HERE_FRESH_S = 3.0
"""An older position is not where the vehicle is now; the slowest stream profile sends 0.5 Hz."""

GPS_FRESH_S = 10.0
FIX_3D = 3

SAME_M = 0.5
"""PX4 keeps the altitude as a 32-bit float and tells all three rounded; metres are another origin."""

ORIGIN_MESSAGE = "GPS_GLOBAL_ORIGIN"
SETTING_MESSAGE = "SET_GPS_GLOBAL_ORIGIN"


def checked(origin: Origin) -> Origin:
    """The same with a heading in [0, 360). Raises RefusedError for what can be no origin."""
    orders.check_coordinate(origin.lat_deg, origin.lon_deg)
    low, high = ALT_AMSL_M
    if not low <= origin.alt_amsl_m <= high:  # also true for NaN
        raise RefusedError(
            f"an altitude of {origin.alt_amsl_m:g} m above mean sea level is not between {low:g} and {high:g}"
        )
    if not math.isfinite(origin.x_heading_deg):
        raise RefusedError(f"a heading of {origin.x_heading_deg:g} degrees is none")
    return replace(origin, x_heading_deg=wrap_deg_360(origin.x_heading_deg))


def require_near(origin: Origin, vehicles: Iterable[Vehicle]) -> None:
    """Raises RefusedError if a connected vehicle is farther than REACH_M: most likely it is a typing error."""
    for vehicle in vehicles:
        position = vehicle.telemetry("position")
        if not vehicle.connected or vehicle.replayed or position is None or position["lat_deg"] is None:
            continue
        away_m = distance_m(origin.lat_deg, origin.lon_deg, position["lat_deg"], position["lon_deg"])
        if away_m > REACH_M:
            raise RefusedError(
                f"that is {away_m / 1000:.0f} km from {vehicle.name}, and the frame is of use within "
                f"{REACH_M / 1000:g} km; {orders.FORCE_HINT}"
            )


def from_vehicle(vehicle: Vehicle, now: float, *, heading: bool, force: bool = False) -> Origin:
    """Where it is now, and with ``heading`` its nose along x. Raises RefusedError if that is not known well enough;
    ``force`` takes a position without a 3D fix, never an old one."""
    orders.require_connected(vehicle, now)
    position, at = vehicle.telemetry("position"), vehicle.telemetry_at("position")
    if position is None or at is None or position["lat_deg"] is None:
        raise RefusedError(f"{vehicle.name} has not told its position yet (GLOBAL_POSITION_INT)")
    if now - at > HERE_FRESH_S:
        raise RefusedError(f"the position of {vehicle.name} is {now - at:.1f} s old; {HERE_FRESH_S:g} s is the limit")
    if not force:
        _require_fix(vehicle, now)
    if heading and position["heading_deg"] is None:
        raise RefusedError(f"{vehicle.name} does not tell its heading; give one, or leave it out")
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
    """GPS_GLOBAL_ORIGIN, come after ``count`` others, tells this origin."""

    origin: Origin
    count: int

    def met(self, vehicle: Vehicle, now: float) -> bool:
        away_m = off_m(vehicle, self.origin)
        return vehicle.count(ORIGIN_MESSAGE) > self.count and away_m is not None and away_m <= SAME_M

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        return kept(vehicle, self.origin) if vehicle.count(ORIGIN_MESSAGE) > self.count else f"no {ORIGIN_MESSAGE} came"


def announce(vehicle: Vehicle, now: float, dialect: Dialect, origin: Origin, *, force: bool = False) -> Plan:
    """Send the origin, then ask which one it has. Raises RefusedError."""
    orders.require_connected(vehicle, now)
    for name in (SETTING_MESSAGE, ORIGIN_MESSAGE):
        if name not in dialect.by_name:
            raise RefusedError(f"dialect {dialect.name} has no {name}")
    if not force and (why := why_not_idle(vehicle, now)) is not None:
        raise RefusedError(
            f"{why}, and its local frame would move under whoever flies it by that; disarm it, or {orders.FORCE_HINT}"
        )
    values = {
        "latitude": round(origin.lat_deg * 1e7),
        "longitude": round(origin.lon_deg * 1e7),
        "altitude": round(origin.alt_amsl_m * 1000),
    }
    count = vehicle.count(ORIGIN_MESSAGE)
    expect: Expectation = OriginIs(origin, count)
    if vehicle.family == "ardupilot":  # its first answer is its last word: no use in waiting for another
        expect = MessageAfter(ORIGIN_MESSAGE, count)
    request = CommandSpec(REQUEST_MESSAGE, (float(dialect.by_name[ORIGIN_MESSAGE].msgid),))
    steps = (
        Step("tell the origin", message=(SETTING_MESSAGE, values)),
        Step(
            "ask for its origin",
            request,
            expect=expect,
            refused=f"{firmware_name(vehicle)} has no {ORIGIN_MESSAGE} to send: its estimator has no origin",
        ),
    )
    return Plan("origin", steps, "its own origin is the fleet's now (its axes stay east and north)")


def off_m(vehicle: Vehicle, origin: Origin) -> float | None:
    """How far the origin that the vehicle told last is from ``origin``, height included; None if it has told none."""
    own = vehicle.telemetry("ekf_origin")
    if own is None:
        return None
    across_m = distance_m(own["lat_deg"], own["lon_deg"], origin.lat_deg, origin.lon_deg)
    return math.hypot(across_m, own["alt_amsl_m"] - origin.alt_amsl_m)


def kept(vehicle: Vehicle, origin: Origin) -> str:
    """What a vehicle that has another origin than ``origin`` has, and why, for a person."""
    own, away_m = vehicle.telemetry("ekf_origin"), off_m(vehicle, origin)
    if own is None or away_m is None:
        return "it tells no origin"
    has = f"it still has {own['lat_deg']:.7f}, {own['lon_deg']:.7f}, {own['alt_amsl_m']:.1f} m, {away_m:.1f} m away"
    if vehicle.family == "ardupilot":
        return f"{has}: ArduPilot has an origin already and does not change it before it reboots"
    return has
