"""The fleet's world frame: sets it, passes it to every vehicle, and counts its changes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skygcs.core.geo import EAST_DEG, Origin
from skygcs.core.vehicle import origin as origins
from skygcs.core.vehicle.flight_lock import OriginChange
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.flight_locks import FlightLocks
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import OnEvent


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
