"""Evidence that a disarmed vehicle flies, or has not landed: its heartbeat and its landed state alone show neither.

The armed bit of one heartbeat may be forged, or come from another vehicle. A disarmed autopilot reports itself on the
ground within two seconds (EXTENDED_SYS_STATE of ArduCopter and PX4), stands still and does not turn its motors. If
telemetry contradicts that, control by setpoints orders a hold before it ends, and orders that would be dangerous in the
air need `force`. Which of the disarmed have landed:
`landing_watch`.
"""

from __future__ import annotations

import math

from skygcs.core.vehicle.state import AIRBORNE
from skygcs.core.vehicle.vehicle import Vehicle

FRESH_S = 3.0
"""Older telemetry is not used: the slowest stream profile sends 0.5 Hz, and one message may be lost."""

HEIGHT_M = 5.0
"""Height over home that a vehicle on the ground never shows: barometers drift by 1 or 2 m."""

CLIMB_MPS = 1.0
SPEED_MPS = 3.0
"""Faster than a vehicle is carried by hand, and than GPS noise of a standing one."""

THROTTLE_PERCENT = 10

RECENTLY_ARMED_S = 3.0
"""Three heartbeats: by then the landed state has followed as well."""


def flight_evidence(vehicle: Vehicle, now: float) -> str | None:
    """Telemetry that shows the vehicle flying, whatever its armed bit says; None if there is none, or if its class does
    not fly."""
    if not vehicle.abilities.flies:
        return None
    if (state := _airborne_state(vehicle, now)) is not None:
        return state
    return height_evidence(vehicle, now) or motion_evidence(vehicle, now)


def _airborne_state(vehicle: Vehicle, now: float) -> str | None:
    state, at = vehicle.landed_state()
    if state in AIRBORNE and now - at <= FRESH_S:
        return f"it reports itself {'in the air' if state == 'in_air' else 'in ' + state}"
    return None


def height_evidence(vehicle: Vehicle, now: float) -> str | None:
    """Its height above home, where that shows it flying. Where the ground is higher than home it is none."""
    position, at = vehicle.timed_telemetry("position")
    if position is None or at is None or now - at > FRESH_S or position["lat_deg"] is None:
        return None
    return f"it is {position['alt_rel_m']:.0f} m above its home" if position["alt_rel_m"] > HEIGHT_M else None


def motion_evidence(vehicle: Vehicle, now: float) -> str | None:
    """Its landed state, its speed or its throttle, where one of them shows it flying; None: none does."""
    if (state := _airborne_state(vehicle, now)) is not None:
        return state
    position, at = vehicle.timed_telemetry("position")
    if position is not None and at is not None and now - at <= FRESH_S:
        east, north, up = position["vel_enu_mps"]
        speed = math.hypot(east, north)
        if abs(up) > CLIMB_MPS:
            return f"it {'climbs' if up > 0 else 'sinks'} at {abs(up):.1f} m/s"
        if speed > SPEED_MPS:
            return f"it moves at {speed:.1f} m/s"
    vfr, vfr_at = vehicle.timed_telemetry("vfr")
    turning = vfr is not None and vehicle.abilities.hovers and vfr["throttle_percent"] >= THROTTLE_PERCENT
    if vfr is not None and turning and vfr_at is not None and now - vfr_at <= FRESH_S:
        return f"its throttle is at {vfr['throttle_percent']} %"
    return None


def contradiction(vehicle: Vehicle, now: float) -> str | None:
    """Why it may be flying although its heartbeat shows it disarmed; None if it is armed, or certainly disarmed."""
    if vehicle.armed:
        return None
    if vehicle.duplicate_beside:
        return "two vehicles send with its ids on one link"
    return flight_evidence(vehicle, now)


def why_maybe_flying(vehicle: Vehicle, now: float) -> str | None:
    """Why a heartbeat that shows the vehicle disarmed is doubted; None if it is not."""
    if (evidence := contradiction(vehicle, now)) is not None:
        return f"its heartbeat shows it disarmed, but {evidence}"
    if vehicle.duplicate_elsewhere is not None:
        return f"two vehicles have its system id ({vehicle.duplicate_elsewhere})"
    return None


def why_not_idle(vehicle: Vehicle, now: float) -> str | None:
    """Why the vehicle must be treated as armed, and orders dangerous in the air be refused; None: it is idle."""
    if vehicle.armed:
        return "it is armed"
    if (why := why_maybe_flying(vehicle, now)) is not None:
        return why
    state, at = vehicle.landed_state()
    seen_on_ground = state == "on_ground" and at > vehicle.armed_at
    if 0.0 <= now - vehicle.armed_at <= RECENTLY_ARMED_S and not seen_on_ground:
        return f"it was armed {now - vehicle.armed_at:.1f} s ago: wait until it is seen on the ground"
    return None
