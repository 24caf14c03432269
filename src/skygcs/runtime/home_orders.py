"""Orders that move what a vehicle counts from: the origin of its estimator, and its home.

Each is a function of the vehicle's actor, as those of `runtime.onboard_orders`. The fleet's origin is sent until the
vehicle reports it or is known to refuse it.
"""

from __future__ import annotations

from dataclasses import replace

from skygcs.core.geo import Origin
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle import orders
from skygcs.core.vehicle.estimator_origin import ORIGIN_MESSAGE
from skygcs.core.vehicle.flight_lock import EstimatorOrigin, HomeMove
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.origin import SAME_M, announce, kept, off_m
from skygcs.runtime.order_runner import Planner
from skygcs.runtime.vehicle_actor import VehicleActor

TRIES = 3
"""SET_GPS_GLOBAL_ORIGIN has no acknowledgement: it may be lost while the request after it arrives."""

NO_USE = frozenset({"refused", "unsupported", "lost", "cancelled"})
"""Outcomes that another attempt would not change."""


async def push_origin(actor: VehicleActor, origin: Origin, *, home: bool = False, force: bool = False) -> Outcome:
    """Send the fleet's origin to the vehicle; with ``home`` also make it the home. When armed only with ``force``."""
    with actor.outcomes.tracked("origin") as ended:
        return ended(await _pushed(actor, origin, home, force))


async def _pushed(actor: VehicleActor, origin: Origin, home: bool, force: bool) -> Outcome:
    if (why := actor.services.locks.refusal(EstimatorOrigin(actor.vehicle.key))) is not None:
        return Outcome.refused(why)
    sent = await _until_reported(actor, origin, force=force)
    if not home or sent.result == "refused":
        return sent
    planner = _home(actor, origin.lat_deg, origin.lon_deg, origin.alt_amsl_m, force=force)
    return _both(sent, await actor.runner.attempt(planner))


async def _until_reported(actor: VehicleActor, origin: Origin, *, force: bool) -> Outcome:
    """The outcome is ok only once the vehicle itself reports this origin."""
    vehicle, dialect = actor.vehicle, actor.services.dialect
    elapsed_s = 0.0
    texts: tuple[str, ...] = ()
    for number in range(1, TRIES + 1):
        before = vehicle.count(ORIGIN_MESSAGE)
        outcome = await actor.runner.attempt(lambda now: announce(vehicle, now, dialect, origin, force=force))
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


def _both(origin: Outcome, home: Outcome) -> Outcome:
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


async def set_home(
    actor: VehicleActor,
    *,
    lat_deg: float | None = None,
    lon_deg: float | None = None,
    alt_amsl_m: float | None = None,
    force: bool = False,
) -> Outcome:
    """Set its home; without arguments at its position. In the air, or farther than goto_limit_m, only with
    ``force``; never to another place while a flight counts from it."""
    planner = _home(actor, lat_deg, lon_deg, alt_amsl_m, force=force)
    return await actor.runner.run("home", planner)


def _home(
    actor: VehicleActor, lat_deg: float | None, lon_deg: float | None, alt_amsl_m: float | None, *, force: bool
) -> Planner:
    vehicle, limit_m = actor.vehicle, actor.config.goto_limit_m

    def planner(now: float) -> Plan:
        altitude_m = vehicle.home_alt_amsl_m() if alt_amsl_m is None else alt_amsl_m
        place = None
        if lat_deg is not None and lon_deg is not None and altitude_m is not None:
            place = (lat_deg, lon_deg, altitude_m)
        actor.services.locks.require(HomeMove(vehicle.key, place))
        where = {"lat_deg": lat_deg, "lon_deg": lon_deg, "alt_amsl_m": alt_amsl_m}
        return orders.set_home(vehicle, now, **where, limit_m=limit_m, force=force)

    return planner
