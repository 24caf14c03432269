"""The daemon's knowledge of its fleet for plans: where each vehicle is, and the terms of its margin, from the
fleet file and from measurements."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.plan.fleet_plan import FlightSpace
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.separation import DOWNWASH_RATIO
from skygcs.core.trajectory.piecewise import MAX_POSITION_M, Vector
from skygcs.core.vehicle.orders import ORDER_POSITION_S
from skygcs.runtime.vehicle_actor import VehicleActor

FLEET_FILE = "fleet file"

LEAST_TICKS = 100
"""Ticks of the control clock before its lateness is believed."""

LARGEST_M = 100.0


def margin_rule(
    actors: Iterable[VehicleActor], *, margin_m: float | None = None, downwash_ratio: float | None = None
) -> MarginRule:
    """Rule for plans of these vehicles, by their names. Raises RefusedError for impossible values."""
    actors = list(actors)
    by_vehicle = {actor.name: uncertainty(actor) for actor in actors}
    if downwash_ratio is None:
        ratios = [actor.config.separation.footprint().downwash_ratio for actor in actors]
        downwash_ratio = max(ratios, default=DOWNWASH_RATIO)
    return MarginRule(Uncertainty(), by_vehicle, downwash_ratio, margin_m)


def uncertainty(actor: VehicleActor) -> Uncertainty:
    """The known margins of one vehicle, each with its source."""
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
    older than `ORDER_POSITION_S`."""
    vehicle = actor.vehicle
    found, at = vehicle.enu_m(), vehicle.telemetry_at("position")
    if found is None or at is None or vehicle.replayed or (fresh and now - at > ORDER_POSITION_S):
        return None
    east, north, up = found
    return (east, north, up) if all(abs(value) <= MAX_POSITION_M for value in found) else None


def control_space(actors: Iterable[VehicleActor], origin: Origin, rule: MarginRule) -> FlightSpace:
    """Where the control fences of all these vehicles allow a plan: a certificate in it passes the fence's check of a
    flight. That asks each path to be `margin_m` inside, and a certificate its part of the margin inside of these walls,
    so the walls are moved by the difference."""
    frame = EnuFrame(origin)
    low, high, top_m = [-math.inf, -math.inf], [math.inf, math.inf], math.inf
    for actor in actors:
        fence = actor.config.control.fence_at(origin)
        less_m = fence.margin_m - rule.half_m(actor.name)
        local = EnuFrame(fence.origin)
        corners = [
            frame.from_geodetic(*local.to_geodetic(x, y, up)) for x in fence.x_m for y in fence.y_m for up in fence.up_m
        ]
        # of each wall the corner farther in: a fence about another origin stands a little turned and tilted
        for axis in (0, 1):
            values = sorted(corner[axis] for corner in corners)
            low[axis] = max(low[axis], values[3] + less_m)
            high[axis] = min(high[axis], values[4] - less_m)
        top_m = min(top_m, sorted(corner[2] for corner in corners)[4] - less_m)
    if math.isinf(top_m) or low[0] >= high[0] or low[1] >= high[1]:
        return FlightSpace()
    walls = ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]))
    return FlightSpace(walls, None, top_m)
