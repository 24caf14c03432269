"""States of one run of a plan, the reports of their changes, and the orders that it gives to its vehicles. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from skygcs.ext.plans.flight.flight_steps import StepKind
from skygcs.ext.plans.flight.sights import Pair


class PlanState(StrEnum):
    ARMING = "arming"
    TAKEOFF = "takeoff"
    ENGAGING = "engaging"
    TO_STARTS = "to_starts"
    RETURNING = "returning"
    FLYING = "flying"
    PAUSED = "paused"
    STOPPED = "stopped"
    ABORTING = "aborting"
    LANDING = "landing"
    FINISHED = "finished"
    ABORTED = "aborted"
    LANDED = "landed"


OVER = frozenset({PlanState.FINISHED, PlanState.ABORTED, PlanState.LANDED})
STEPPING = frozenset({PlanState.TO_STARTS, PlanState.RETURNING, PlanState.FLYING})

STATE_OF = {
    StepKind.WAY_THERE: PlanState.TO_STARTS,
    StepKind.WAY_BACK: PlanState.RETURNING,
    StepKind.PLAN: PlanState.FLYING,
}


class OrderKind(StrEnum):
    """Orders that the runtime is to carry out; ``vehicles`` of the order say with which."""

    MODE = "mode"
    """Change to the mode of the take-off."""
    ARM = "arm"
    DISARM = "disarm"
    TAKEOFF = "takeoff"
    ENGAGE = "engage"
    FLY = "fly"
    """Start the step on one clock."""
    STOP_CLOCK = "stop clock"
    GO_ON = "go on"
    END_CLOCK = "end clock"
    HOLD = "hold"
    CERTIFY_LANDING = "certify landing"
    LAND = "land"


class Order(NamedTuple):
    kind: OrderKind
    vehicles: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PlanChange:
    """A state change, to be reported once."""

    state: PlanState
    text: str
    vehicle: str | None = None
    pairs: tuple[Pair, ...] = ()
