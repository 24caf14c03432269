"""The place of the fleet's one plan: everything that the core asks of plans, which an extension makes and flies.

no method of plans was called yet    the status is that no plan is loaded, and there is nothing to do
afterwards                           the extension's `PlanKeeper` answers

It is also the one gate to the keeper: an exception of its code is reported as a fault and reaches nobody else. Then
the last status stands with the fault as its reason, and after a fault of the clock the trajectories of plans pause:
nothing may fly them on without the plan's checks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

NO_PLAN: dict[str, Any] = {
    "plan": None,
    "name": None,
    "kind": None,
    "state": "none",
    "busy": None,
    "phase": None,
    "step": 0,
    "steps": 0,
    "reason": "",
    "by": None,
    "mode": None,
    "speed": None,
    "clock": None,
    "waits_for": [],
    "pairs": [],
    "vehicles": [],
}
"""Keys of the status where no plan is loaded."""


class PlanKeeper(Protocol):
    """Keeps the fleet's plan, and flies it."""

    @property
    def moving(self) -> bool:
        """True if a flight is under way."""
        ...

    def status(self) -> dict[str, Any]:
        """The keys of the status that differ from `NO_PLAN`."""
        ...

    def tick(self) -> None:
        """Five times a second, after the trajectories of the fleet."""
        ...

    async def wind_down(self) -> None:
        """Wind down for the end of the daemon: no vehicle takes off any more, those that stand armed are disarmed.
        Those in the air hold after this."""
        ...


FAULT = "the extension of plans has failed, see the log; its trajectories pause: order its vehicles to hold or land"
"""The reason in a status that its keeper could not give."""


class PlanPlace:
    """The plan of one fleet. ``observers`` are called after each change of `status` that is worth a notification."""

    def __init__(
        self, now: Callable[[], float], on_fault: Callable[[Exception], None], pause: Callable[[], None]
    ) -> None:
        """``on_fault`` gets the exceptions of the keeper (the daemon sets `Hub.fault`); ``pause`` stops the
        trajectories of plans on their paths."""
        self.keeper: PlanKeeper | None = None
        self.observers: set[Callable[[], None]] = set()
        self._now = now
        self.on_fault = on_fault
        self._pause = pause
        self._last: dict[str, Any] = {}
        """The keeper's last answer."""

    @property
    def moving(self) -> bool:
        """True if a flight is under way; also where the keeper fails: it may be."""
        try:
            return self.keeper is not None and self.keeper.moving
        except Exception as error:
            self.on_fault(error)
            return True

    def status(self) -> dict[str, Any]:
        """Status as plan.status answers it."""
        try:
            if self.keeper is not None:
                self._last = self.keeper.status()
            found = self._last
        except Exception as error:
            self.on_fault(error)
            found = self._last | {"reason": FAULT}
        return {"now_s": round(self._now(), 3), **NO_PLAN} | found

    def tick(self) -> None:
        """Watch the flight; called five times a second."""
        try:
            if self.keeper is not None:
                self.keeper.tick()
        except Exception as error:
            self.on_fault(error)
            self._pause()

    async def wind_down(self) -> None:
        """See `PlanKeeper.wind_down`."""
        try:
            if self.keeper is not None:
                await self.keeper.wind_down()
        except Exception as error:
            self.on_fault(error)
            self._pause()

    def changed(self) -> None:
        """Notify the observers."""
        for observer in list(self.observers):
            observer()
