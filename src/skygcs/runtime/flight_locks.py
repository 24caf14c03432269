"""The locks of all flights under way: each flight takes its own, and each order that could change one asks here.

A lock is held as long as its flight says so: it cannot be left behind by a flight that ended on a way of its own.
Flights of extensions say so by code of theirs. An exception of it is a fault, and the flight counts as under way: what
it was certified with must not change under a flight that may be in the air.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from skygcs.config.control import ControlSettings
from skygcs.core.geo import Origin
from skygcs.core.vehicle.flight_lock import Change, FlightLock, Holder, member_of
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError

_END_FIRST = tuple(Holder)
"""A plan's lock is named before those of its trajectories and engagements, which end with it."""


IN_DOUBT = "; that flight could not say whether it has ended (a fault, see the log): if it has, restart skygcs"
"""The end of a refusal by a lock whose flight fails."""


def _ignore(error: Exception) -> None:
    """The report of faults where nobody reads them."""


@dataclass(slots=True)
class _Held:
    """A lock and whether its flight is under way; ``in_doubt``: the last time that was asked, its code failed."""

    lock: FlightLock
    """The flight's own object, by which it is known."""
    under_way: Callable[[], bool]
    in_doubt: bool = False
    taken_out: frozenset[str] = frozenset()
    """Names of members that a later flight has."""

    @property
    def present(self) -> FlightLock:
        """The lock of the members that it still holds."""
        if not self.taken_out:
            return self.lock
        return self.lock.of(frozenset(member.name for member in self.lock.members) - self.taken_out)


class FlightLocks:
    """Locks of one fleet. Held locks are at most one per engagement and group, and one of a plan; of flights that fail,
    at most one per kind of flight and vehicle."""

    def __init__(
        self,
        links_to: Callable[[Vehicle], frozenset[str]] = lambda vehicle: frozenset(),
        on_fault: Callable[[Exception], None] = _ignore,
    ) -> None:
        """``links_to``: names of the links that carry a vehicle now. ``on_fault`` gets the exceptions of flights (the
        daemon sets `Hub.fault`)."""
        self._links_to = links_to
        self.on_fault = on_fault
        self._held: list[_Held] = []

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
        """Hold a lock as long as its flight is ``under_way``. It takes its members out of older locks of flights that
        fail: each new flight of the same kind would leave one more of them."""
        taken = frozenset(member.name for member in lock.members)
        for held in self._under_way():
            if held.in_doubt and held.lock.holder is lock.holder:
                held.taken_out |= taken
        self._held = [held for held in self._held if held.present.members or not held.in_doubt]
        self._held.append(_Held(lock, under_way))
        return lock

    def held(self) -> list[FlightLock]:
        """The locks of the flights under way, plans first."""
        return [held.present for held in self._under_way()]

    def refusal(self, change: Change, *, own: FlightLock | None = None) -> str | None:
        """Why a change has to wait for a flight; None if it may be made now. ``own``: the lock of the flight that makes
        it for itself."""
        for held in self._under_way():
            if held.lock is not own and (why := held.present.refusal(change)) is not None:
                return why + IN_DOUBT if held.in_doubt else why
        return None

    def require(self, change: Change) -> None:
        """Raises RefusedError for a change that has to wait."""
        if (why := self.refusal(change)) is not None:
            raise RefusedError(why)

    def _under_way(self) -> list[_Held]:
        """Drop the locks of flights that have ended; returns the others, plans first."""
        self._held = [held for held in self._held if self._goes_on(held)]
        return sorted(self._held, key=lambda held: _END_FIRST.index(held.lock.holder))

    def _goes_on(self, held: _Held) -> bool:
        """True while the flight is under way; also where its code fails: it may be."""
        try:
            under_way = held.under_way()
        except Exception as error:
            self.on_fault(error)
            held.in_doubt = True
            return True
        held.in_doubt = False
        return under_way
