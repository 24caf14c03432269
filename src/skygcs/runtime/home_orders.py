"""The fleet's world frame, which is passed to every vehicle, and orders that move what a vehicle counts from: the
origin of its estimator, and its home.

Each order is a function of the vehicle's actor, as those of `runtime.onboard_orders`. The fleet's origin is sent until
the vehicle reports it or is known to refuse it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from skygcs.core.geo import EAST_DEG, Origin
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle import orders
from skygcs.core.vehicle import origin as origins
from skygcs.core.vehicle.flight_lock import EstimatorOrigin, HomeMove, OriginChange
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.origin import ORIGIN_MESSAGE, SAME_M, announce, kept, off_m
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.flight_locks import FlightLocks
from skygcs.runtime.order_runner import Planner
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import OnEvent

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


class WorldFrame:
    """``origin`` (None: there is no frame yet) and ``generation``, the count of its changes.

    A change is one synchronous step: before the next frame is read or the next request answered, every vehicle object
    has the new origin, so no answer mixes two frames. Nothing is sent to the vehicles.
    """

    def __init__(
        self, origin: Origin | None, actors: Mapping[int, VehicleActor], locks: FlightLocks, on_event: OnEvent
    ) -> None:
        self.origin = origin
        self.generation = 0 if origin is None else 1
        self._actors = actors
        self._locks = locks
        self._on_event = on_event

    def join(self, actor: VehicleActor) -> None:
        """Pass the frame to a new vehicle."""
        actor.set_origin(self.origin, self.generation)

    def set(self, origin: Origin | None, *, force: bool = False, source: str = "") -> None:
        """Set the frame. Setting the same origin again has no effect.

        Raises RefusedError for an impossible origin, while a flight is made of the present one, and without ``force``
        for one of another site. The event names ``source``: "alpha".
        """
        if origin is not None:
            origin = origins.checked(origin)
            if not force:
                origins.require_near(origin, [actor.vehicle for actor in self._actors.values()])
        old = self.origin
        if origin == old:
            return
        self._locks.require(OriginChange(origin))
        self.origin = origin
        self.generation += 1
        for actor in self._actors.values():
            self.join(actor)
        data = {"old": as_dict(old), "new": as_dict(origin), "generation": self.generation, "source": source or None}
        self._on_event(Event("origin", None, None, _reported(old, origin, source), data))

    def set_from_vehicle(self, actor: VehicleActor, now: float, *, heading: bool = False, force: bool = False) -> None:
        """Set the origin at the vehicle's position; with ``heading`` its nose is along x, else the x axis stays.

        Raises RefusedError.
        """
        if actor.vehicle.duplicate and not force:
            raise RefusedError(f"two vehicles have system id {actor.sysid}: it is not known whose position this is")
        origin = origins.from_vehicle(actor.vehicle, now, heading=heading, force=force)
        if not heading and self.origin is not None:
            origin = Origin(origin.lat_deg, origin.lon_deg, origin.alt_amsl_m, self.origin.x_heading_deg)
        self.set(origin, force=force, source=actor.name)

    def status(self) -> dict[str, Any]:
        """The frame for RPC and CLI."""
        return {"origin": as_dict(self.origin), "generation": self.generation}


def as_dict(origin: Origin | None) -> dict[str, float] | None:
    """`Origin.as_dict`, and None for None."""
    return None if origin is None else origin.as_dict()


def _reported(old: Origin | None, new: Origin | None, source: str) -> str:
    return f"origin {_place(new)}" + (f", from {source}" if source else "") + f"; it was {_place(old)}"


def _place(origin: Origin | None) -> str:
    if origin is None:
        return "none"
    place = f"{origin.lat_deg:.7f}, {origin.lon_deg:.7f}, {origin.alt_amsl_m:.1f} m AMSL"
    return place if origin.x_heading_deg == EAST_DEG else f"{place}, x to {origin.x_heading_deg:.1f}°"
