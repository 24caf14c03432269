"""The place of the fleet's one plan: everything that the core asks of plans, which an extension makes and flies.

no method of plans was called yet    the status is that no plan is loaded, and there is nothing to do
afterwards                           the extension's `PlanKeeper` answers
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


class PlanPlace:
    """The plan of one fleet. ``observers`` are called after each change of `status` that is worth a notification."""

    def __init__(self, now: Callable[[], float]) -> None:
        self.keeper: PlanKeeper | None = None
        self.observers: set[Callable[[], None]] = set()
        self._now = now

    @property
    def moving(self) -> bool:
        """True if a flight is under way."""
        return self.keeper is not None and self.keeper.moving

    def status(self) -> dict[str, Any]:
        """Status as plan.status answers it."""
        nothing = {"now_s": round(self._now(), 3), **NO_PLAN}
        return nothing if self.keeper is None else nothing | self.keeper.status()

    def tick(self) -> None:
        """Five times a second."""
        if self.keeper is not None:
            self.keeper.tick()

    async def wind_down(self) -> None:
        """See `PlanKeeper.wind_down`."""
        if self.keeper is not None:
            await self.keeper.wind_down()

    def changed(self) -> None:
        """Notify the observers."""
        for observer in list(self.observers):
            observer()
