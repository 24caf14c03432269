"""A trajectory clock of which others run replicas: its orders take effect at a time that all of them know before.

    order        at once                                   at its time, on the clock and on each replica
    ----------   ---------------------------------------   ------------------------------------------------------
    pause …      checked, noted, given to the observers    carried out as `TrajectoryClock` does; refused by then
                 with its time                             (it has finished meanwhile): nothing

    ground       ──pause──┬──── lead_s ────┐ rate falls
    companion             └─ delay ─┐ noted└ rate falls          the same s(t) on both, whatever the delay below lead_s

An order that reaches a replica after its time is carried out when it comes: the replica is ahead on its path by rate
times the lateness, which its vehicle's distance from the common reference shows. Orders have to be noted as they were
given: a pause that is noted after the resume that followed it would stand.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Literal, NamedTuple

from skygcs.core.trajectory.trajectory_clock import (
    MAX_SPEED_FACTOR,
    MIN_SPEED_FACTOR,
    ClockState,
    ClockTime,
    TrajectoryClock,
)
from skygcs.errors import RefusedError

ClockOrderKind = Literal["pause", "resume", "abort", "speed"]

MAX_NOTED = 32
"""Orders that wait for their time; a person gives one or two a second."""

STOP_ROOM = 2
"""Room beyond that for stops alone: a pause, and an abort. Only a resume, which has no room there, comes before the
next pause."""

ENDING = frozenset({ClockState.ABORTING, ClockState.ABORTED, ClockState.FINISHED})

STATE_AFTER = {"pause": ClockState.PAUSING, "resume": ClockState.RUNNING, "abort": ClockState.ABORTING}


class ClockOrder(NamedTuple):
    """``at_s``: when it takes effect; ``speed_factor``: of "speed" only."""

    kind: ClockOrderKind
    at_s: float
    speed_factor: float | None = None

    @property
    def stops(self) -> bool:
        return self.kind in ("pause", "abort")

    def has_room(self, waiting: int) -> bool:
        """True if it may wait beside so many others; a stop of a clock always may."""
        return waiting < MAX_NOTED + (STOP_ROOM if self.stops else 0)


class ReplicatedClock(TrajectoryClock):
    """``lead_s`` after they are given, orders take effect; 0: at once. ``observers`` get each order as it is given."""

    __slots__ = ("_noted", "lead_s", "observers")

    def __init__(
        self,
        duration_s: float,
        rate_limit_per_s: float,
        *,
        speed_factor: float = 1.0,
        rests_at_start: bool = True,
        rests_at_end: bool = True,
        lead_s: float = 0.0,
    ) -> None:
        super().__init__(
            duration_s,
            rate_limit_per_s,
            speed_factor=speed_factor,
            rests_at_start=rests_at_start,
            rests_at_end=rests_at_end,
        )
        self.lead_s = lead_s
        self.observers: list[Callable[[ClockOrder], None]] = []
        self._noted: list[ClockOrder] = []

    def note(self, order: ClockOrder) -> None:
        """An order of the clock that this one replicates. Raises RefusedError if too many wait."""
        if not order.has_room(len(self._noted)):
            raise RefusedError(f"{MAX_NOTED} orders to the clock wait for their time already")
        self._noted.append(order)
        self._noted.sort(key=lambda noted: noted.at_s)

    def pause(self, now: float) -> None:
        """Stop on the path, ``lead_s`` from now. Raises RefusedError."""
        if self.lead_s <= 0.0:
            super().pause(now)
            return
        state = self._expected(now)
        if state is ClockState.READY or state in ENDING:
            raise RefusedError(f"the trajectory is {state}: there is nothing to pause")
        if state in (ClockState.RUNNING, ClockState.WAITING):
            self._order(ClockOrder("pause", now + self.lead_s))

    def resume(self, now: float) -> None:
        """Go on, ``lead_s`` from now. Raises RefusedError."""
        if self.lead_s <= 0.0:
            super().resume(now)
            return
        state = self._expected(now)
        if state not in (ClockState.PAUSING, ClockState.PAUSED):
            raise RefusedError(f"the trajectory is {state}: only a paused one can be resumed")
        self._order(ClockOrder("resume", now + self.lead_s))

    def abort(self, now: float) -> None:
        """Stop for good, ``lead_s`` from now; without effect where it is over already."""
        if self.lead_s <= 0.0:
            super().abort(now)
        elif self._expected(now) not in ENDING:
            self._order(ClockOrder("abort", now + self.lead_s))

    def set_speed(self, now: float, speed_factor: float) -> None:
        """Fly at this multiple of the planned speed, ``lead_s`` from now. Raises RefusedError."""
        if self.lead_s <= 0.0:
            super().set_speed(now, speed_factor)
            return
        state = self._expected(now)
        if state in ENDING:
            raise RefusedError(f"the trajectory is {state}: its speed cannot be changed")
        if not MIN_SPEED_FACTOR <= speed_factor <= MAX_SPEED_FACTOR:  # also for NaN
            limits = f"{MIN_SPEED_FACTOR:g} and {MAX_SPEED_FACTOR:g}"
            raise RefusedError(f"a speed factor of {speed_factor:g} is not between {limits}")
        self._order(ClockOrder("speed", now + self.lead_s, speed_factor))

    def at(self, now: float) -> ClockTime:
        """Same as `TrajectoryClock.at`, after the orders whose time has come. A paused clock that is to go on is
        running: what looks at it must not take the wait for another pause."""
        due = [order for order in self._noted if order.at_s <= now]
        del self._noted[: len(due)]  # before the first is carried out, which asks for the present again
        for order in due:
            self._carry_out(order)
        time = super().at(now)
        if self._noted and time.state is ClockState.PAUSED and self._noted[-1].kind == "resume":
            return time._replace(state=ClockState.RUNNING)
        return time

    def _expected(self, now: float) -> ClockState:
        """The state once all that waits has been carried out."""
        for order in reversed(self._noted):
            if order.kind in STATE_AFTER:
                return STATE_AFTER[order.kind]
        return self.at(now).state

    def _order(self, order: ClockOrder) -> None:
        self.note(order)
        for observer in self.observers:
            observer(order)

    def _carry_out(self, order: ClockOrder) -> None:
        super().at(order.at_s)
        with contextlib.suppress(RefusedError):  # it has come to its end meanwhile
            match order.kind:
                case "pause":
                    super().pause(order.at_s)
                case "resume":
                    super().resume(order.at_s)
                case "abort":
                    super().abort(order.at_s)
                case "speed" if order.speed_factor is not None:
                    super().set_speed(order.at_s, order.speed_factor)
