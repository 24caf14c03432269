"""What the daemon knows of its fleet for plans: where each vehicle is, and the terms of its margin, from the fleet file
and from measurements."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.separation import DOWNWASH_RATIO
from skygcs.core.trajectory.piecewise import MAX_POSITION_M, Vector
from skygcs.core.vehicle.orders import POSITION_FRESH_S
from skygcs.runtime.vehicle_actor import VehicleActor

FLEET_FILE = "fleet file"

LEAST_TICKS = 100
"""Of the control clock, before its lateness is believed."""

LARGEST_M = 100.0


def margin_rule(
    actors: Iterable[VehicleActor], *, margin_m: float | None = None, downwash_ratio: float | None = None
) -> MarginRule:
    """For plans of these vehicles, by their names. Raises RefusedError for impossible values."""
    actors = list(actors)
    by_vehicle = {actor.name: uncertainty(actor) for actor in actors}
    if downwash_ratio is None:
        ratios = [actor.config.separation.footprint().downwash_ratio for actor in actors]
        downwash_ratio = max(ratios, default=DOWNWASH_RATIO)
    return MarginRule(Uncertainty(), by_vehicle, downwash_ratio, margin_m)


def uncertainty(actor: VehicleActor) -> Uncertainty:
    """What is known of one vehicle, and where each value comes from."""
    known: dict[str, Any] = {}
    sources: dict[str, str] = {}
    settings = actor.config.separation
    for name in ("wingspan_m", "position_error_m", "tracking_error_m"):
        if (value := getattr(settings, name)) is not None:
            known[name], sources[name] = value, FLEET_FILE
    record, clock = actor.offboard.tracking, actor.offboard.clock
    if (error_m := record.tracking_error_m) is not None and error_m > known.get("tracking_error_m", 0.0):
        known["tracking_error_m"] = min(error_m, LARGEST_M)
        sources["tracking_error_m"] = f"measured over {_minutes(record.measured_s)}"
    if (delay_s := record.delay_s) is not None:
        known["delay_s"] = delay_s
        sources["delay_s"] = f"measured by {record.round_trips} pings"
    late_s = clock.lateness_p99_s()
    if late_s is not None and clock.ticks >= LEAST_TICKS:
        # a reference is evaluated at each tick and held to the next, which the lead makes up for on average
        known["clock_error_s"] = min(0.5 * actor.offboard.controller.period_s + late_s, LARGEST_M)
        sources["clock_error_s"] = f"measured by {clock.ticks} ticks"
    return Uncertainty(**known, sources=sources)


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"


def place(actor: VehicleActor, now: float, *, fresh: bool) -> Vector | None:
    """Where a vehicle was last heard, in the fleet's frame; None if that is unknown, or ``fresh`` is asked and it is
    older than `POSITION_FRESH_S`."""
    vehicle = actor.vehicle
    found, at = vehicle.enu_m(), vehicle.telemetry_at("position")
    if found is None or at is None or vehicle.replayed or (fresh and now - at > POSITION_FRESH_S):
        return None
    east, north, up = found
    return (east, north, up) if all(abs(value) <= MAX_POSITION_M for value in found) else None
