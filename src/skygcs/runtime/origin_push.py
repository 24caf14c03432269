"""Sends the fleet's origin to one vehicle until the vehicle reports it or is known to refuse it."""

from __future__ import annotations

from dataclasses import replace

from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle import orders
from skygcs.core.vehicle.origin import ORIGIN_MESSAGE, SAME_M, announce, kept, off_m
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.runtime.order_runner import Attempt, Planner

TRIES = 3
"""SET_GPS_GLOBAL_ORIGIN has no acknowledgement: it may be lost while the request after it arrives."""

NO_USE = frozenset({"refused", "unsupported", "lost", "cancelled"})
"""Outcomes that another attempt would not change."""


async def push_origin(
    attempt: Attempt,
    vehicle: Vehicle,
    dialect: Dialect,
    origin: Origin,
    *,
    force: bool,
) -> Outcome:
    """The outcome is ok only once the vehicle itself reports this origin."""
    elapsed_s = 0.0
    texts: tuple[str, ...] = ()
    for number in range(1, TRIES + 1):
        before = vehicle.count(ORIGIN_MESSAGE)
        outcome = await attempt(lambda now: announce(vehicle, now, dialect, origin, force=force))
        elapsed_s += outcome.elapsed_s
        texts += tuple(t for t in outcome.status_texts if t not in texts)
        sent = 0 if outcome.result == "refused" else number
        outcome = replace(outcome, attempts=sent, elapsed_s=elapsed_s, status_texts=texts)
        if outcome.ok and vehicle.count(ORIGIN_MESSAGE) > before:
            away_m = off_m(vehicle, origin)
            if away_m is not None and away_m <= SAME_M:
                return outcome
            text = f"denied: {kept(vehicle, origin)}"
            return replace(outcome, ok=False, result="denied", message=text)
        if outcome.result in NO_USE:
            return outcome
    return outcome


def both(origin: Outcome, home: Outcome) -> Outcome:
    """The outcome of sending the origin and of setting the home there: ok if both are."""
    worse = origin if not origin.ok else home
    return Outcome(
        origin.ok and home.ok,
        worse.result,
        f"origin: {origin.message}; home: {home.message}",
        max(origin.attempts, home.attempts),
        origin.elapsed_s + home.elapsed_s,
        origin.status_texts + tuple(t for t in home.status_texts if t not in origin.status_texts),
    )


def home_at(vehicle: Vehicle, origin: Origin, *, limit_m: float, force: bool) -> Planner:
    """The order that sets the vehicle's home to the origin, with the checks of any other home."""
    return lambda now: orders.set_home(
        vehicle,
        now,
        lat_deg=origin.lat_deg,
        lon_deg=origin.lon_deg,
        alt_amsl_m=origin.alt_amsl_m,
        limit_m=limit_m,
        force=force,
    )
