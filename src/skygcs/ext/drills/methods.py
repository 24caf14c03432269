"""The methods of drills. `METHODS` is their part of the table."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, as_json
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import NoParams, Outcomes, Result, TargetsParams
from skygcs.sim.drills import FaultName


class DrillBeginParams(TargetsParams):
    fault: FaultName = Field(description="deaf: nothing sent to it arrives; link: nothing in either direction.")
    value: float | None = Field(None, description="battery: charge in percent (8); wind: from the west, in m/s (8).")


class DrillEndParams(TargetsParams):
    fault: FaultName | None = Field(None, description="null: all active ones.")


class DrillFault(Result):
    """A fault that can be begun."""

    fault: FaultName
    text: str
    unit: str | None = Field(description="Of its value; null: it has none.")
    default: float | None
    least: float
    most: float


class ActiveDrillFault(Result):
    """A fault that lasts."""

    vehicle: str
    fault: FaultName
    text: str
    value: float | None
    lasts_s: float


class DrillsStatus(Result):
    simulated: list[str] = Field(description="Vehicles that may be given faults.")
    faults: list[DrillFault]
    active: list[ActiveDrillFault]


async def drills_begin(context: Context, params: DrillBeginParams) -> JsonObject:
    """Begin a fault in simulated vehicles, until it is ended; an active one gets the new value."""
    drills = context.services.extensions["drills"]
    return as_json(drills.begin(context.services.fleet.resolve(params.targets), params.fault, params.value))


async def drills_end(context: Context, params: DrillEndParams) -> JsonObject:
    """End a fault of simulated vehicles, or all of them."""
    drills = context.services.extensions["drills"]
    return as_json(drills.end(context.services.fleet.resolve(params.targets), params.fault))


def drills_status(context: Context, _: NoParams) -> JsonObject:
    """Possible and active faults, and their vehicles."""
    status: dict[str, Any] = context.services.extensions["drills"].status()
    return status


_TARGET = (error_codes.TARGET_ERROR,)

METHODS: tuple[Method[Context], ...] = (
    Method("drills.begin", DrillBeginParams, drills_begin, Outcomes, _TARGET),
    Method("drills.end", DrillEndParams, drills_end, Outcomes, _TARGET),
    Method("drills.status", NoParams, drills_status, DrillsStatus),
)
