"""The locks of all flights under way: each flight takes its own, and each order that could change one asks here.

A lock is held as long as its flight says so: it cannot be left behind by a flight that ended on a way of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from skygcs.config.control import ControlSettings
from skygcs.core.geo import Origin
from skygcs.core.vehicle.flight_lock import Change, FlightLock, Holder, member_of
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError

_END_FIRST = tuple(Holder)
"""A plan's lock is named before those of its trajectories and engagements, which end with it."""


class FlightLocks:
    """Locks of one fleet. Held locks are at most one per engagement and group, and one of a plan."""

    def __init__(self, links_to: Callable[[Vehicle], frozenset[str]] = lambda vehicle: frozenset()) -> None:
        """``links_to``: names of the links that carry a vehicle now."""
        self._links_to = links_to
        self._held: list[tuple[FlightLock, Callable[[], bool]]] = []

    def make(
        self, holder: Holder, title: str, origin: Origin, flown: Iterable[tuple[Vehicle, ControlSettings]]
    ) -> FlightLock:
        """A lock of these vehicles as they are now. The one place where a flight reads present values."""
        members = tuple(
            member_of(vehicle, settings.fence_at(origin), settings.trajectory_limits(), self._links_to(vehicle))
            for vehicle, settings in flown
        )
        return FlightLock(holder, title, origin, members)

    def take(self, lock: FlightLock, under_way: Callable[[], bool]) -> FlightLock:
        """Hold a lock as long as its flight is ``under_way``."""
        self._held = [(other, held) for other, held in self._held if held()]
        self._held.append((lock, under_way))
        return lock

    def held(self) -> list[FlightLock]:
        """The locks of the flights under way, plans first."""
        self._held = [(lock, held) for lock, held in self._held if held()]
        return sorted((lock for lock, _ in self._held), key=lambda lock: _END_FIRST.index(lock.holder))

    def refusal(self, change: Change, *, own: FlightLock | None = None) -> str | None:
        """Why a change has to wait for a flight; None if it may be made now. ``own``: the lock of the flight that makes
        it for itself."""
        return next(
            (why for lock in self.held() if lock is not own and (why := lock.refusal(change)) is not None), None
        )

    def require(self, change: Change) -> None:
        """Raises RefusedError for a change that has to wait."""
        if (why := self.refusal(change)) is not None:
            raise RefusedError(why)
