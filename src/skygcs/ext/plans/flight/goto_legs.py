"""The legs of one step that is flown by goto: which vehicle is sent its order, again or for the first time. Pure.

    a vehicle    means                                          ends
    ----------   --------------------------------------------   ------------------------------------------------------
    due          its order is to be given now                   it is given → ordered
    ordered      its order is under way to it                   accepted → flies; unheard → waits; refused → refused
    waits        nothing was heard of its order                 after `AGAIN_S` → due
    flies        it has accepted, and shows its target          it stands, and not at its place, for `STUCK_S` → due
    refused      it has denied its order                        a stop

    the step     means                                          ends
    ----------   --------------------------------------------   ------------------------------------------------------
    running      legs are flown                                 all fly, and stand → finished; a stop → pausing
    finished     all stand: the barrier decides                 one moves → running
    pausing      they were ordered to hold on their legs        every order to hold has ended → paused
    paused       nothing is sent                                go on → running, every order anew
    aborted      nothing is sent any more                       –

A vehicle whose order was lost, or whose link is, is in no danger: it stands at the end of the leg before, or flies to
the end of this one, and both are certified as places to stay while the others are anywhere on theirs.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from skygcs.core.separation import separation_m
from skygcs.core.trajectory import ClockState
from skygcs.core.trajectory.piecewise import Vector
from skygcs.ext.plans.flight.flight_steps import Places

AGAIN_S = 2.0
"""From an order of which nothing was heard to the next one. The order repeats its command by itself for 3 to 10 s."""

STUCK_S = 6.0
"""A vehicle that has accepted and stands for so long elsewhere than at its place is ordered again: it begins to move
within 2 s, and its position comes once a second over a slow radio."""

STANDS_MPS = 0.3
"""Slower than any leg is flown but for its first and last metre."""


class LegState(StrEnum):
    DUE = "due"
    ORDERED = "ordered"
    WAITS = "waits"
    FLIES = "flies"
    REFUSED = "refused"


@dataclass(slots=True)
class _Leg:
    goal_m: Vector
    state: LegState = LegState.DUE
    since: float = 0.0
    """When this state began; of `FLIES`: since when it stands elsewhere."""


class GotoLegs:
    """Legs of one step, from its first order to its end."""

    def __init__(self, goals: Places, within_m: Mapping[str, float], downwash_ratio: float) -> None:
        """``goals``: the vehicles that move in this step, and their places; ``within_m``: how near each has to come."""
        self._legs = {name: _Leg(goal) for name, goal in goals.items()}
        self._within_m = dict(within_m)
        self._ratio = downwash_ratio
        self._holding: set[str] = set()
        self._state = ClockState.RUNNING
        self.orders = 0
        """Orders given, repeats by the order itself not counted."""

    @property
    def state(self) -> ClockState:
        """The state in the words of a clock, for which legs never wait."""
        return self._state

    @property
    def moving(self) -> tuple[str, ...]:
        """The vehicles that have a leg in this step."""
        return tuple(self._legs)

    def goal_m(self, name: str) -> Vector:
        return self._legs[name].goal_m

    def flies(self, name: str) -> bool:
        """True if it has accepted its order, and flies its leg by it."""
        leg = self._legs.get(name)
        return leg is not None and leg.state is LegState.FLIES

    def there(self, name: str, place_m: Vector) -> bool:
        """True if this is its place, or near enough."""
        return self._off_m(self._legs[name], place_m) <= self._within_m[name]

    def due(self) -> list[str]:
        """The vehicles to which an order is to be given now; each counts as ordered from here on."""
        if self._state not in (ClockState.RUNNING, ClockState.FINISHED):
            return []
        names = [name for name, leg in self._legs.items() if leg.state is LegState.DUE]
        for name in names:
            self._legs[name].state = LegState.ORDERED
        self.orders += len(names)
        return names

    def ended(self, name: str, *, ok: bool, unheard: bool, now: float) -> None:
        """An order has ended; ``unheard``: no answer came, so that it may have been received or not."""
        leg = self._legs.get(name)
        if leg is None or leg.state is not LegState.ORDERED:
            return
        leg.state = LegState.FLIES if ok else LegState.WAITS if unheard else LegState.REFUSED
        leg.since = now

    def refused(self) -> list[str]:
        """The vehicles that have denied their orders."""
        return [name for name, leg in self._legs.items() if leg.state is LegState.REFUSED]

    def look(self, now: float, seen: Mapping[str, tuple[Vector | None, float]]) -> None:
        """``seen``: place, None where it is not known now, and speed of each vehicle."""
        if self._state not in (ClockState.RUNNING, ClockState.FINISHED):
            return
        done = True
        for name, leg in self._legs.items():
            place_m, speed_mps = seen[name]
            if leg.state is LegState.WAITS and now - leg.since >= AGAIN_S:
                leg.state = LegState.DUE
            if leg.state is not LegState.FLIES or place_m is None:
                done = False
                continue
            there = self.there(name, place_m)
            if there or speed_mps > STANDS_MPS:
                leg.since = now
                done = done and there
            elif now - leg.since >= STUCK_S:
                leg.state, done = LegState.DUE, False
        self._state = ClockState.FINISHED if done else ClockState.RUNNING

    def _off_m(self, leg: _Leg, place_m: Vector) -> float:
        dx, dy, dz = (a - b for a, b in zip(place_m, leg.goal_m, strict=True))
        return separation_m(dx, dy, dz, self._ratio)

    # -- stops

    def stop(self, names: Iterable[str]) -> list[str]:
        """These are ordered to hold on their legs: returns those that have one."""
        if self._state not in (ClockState.RUNNING, ClockState.FINISHED):
            return []
        self._holding = {name for name in names if name in self._legs}
        self._state = ClockState.PAUSING if self._holding else ClockState.PAUSED
        return sorted(self._holding)

    def held(self, name: str) -> None:
        """The order to hold has ended, well or not: one that was not heard leads to the end of the leg."""
        self._holding.discard(name)
        if self._state is ClockState.PAUSING and not self._holding:
            self._state = ClockState.PAUSED

    def go_on(self, without: Collection[str] = ()) -> None:
        """Every order anew."""
        if self._state not in (ClockState.PAUSED, ClockState.PAUSING):
            return
        self._state, self._holding = ClockState.RUNNING, set()
        for name, leg in self._legs.items():
            if name not in without:
                leg.state = LegState.DUE

    def end(self) -> None:
        """Stop sending."""
        self._state = ClockState.ABORTED
