"""The method of the monitor: which vehicles are about to meet. `METHODS` is its part of the table."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import NoParams, Result


class ConflictState(Result):
    """Two vehicles that are about to meet, or were until a moment ago."""

    vehicles: list[str] = Field(description="Both; the first has the right of way.")
    level: Literal["notice", "warning", "action"]
    distance_m: float | None = Field(
        None, description="Now, in the metric of the margin: heights are divided by the downwash ratio."
    )
    closest_m: float | None = Field(None, description="The closest they will come if both fly straight on.")
    closest_in_s: float | None = None
    enters_in_s: float | None = Field(None, description="Until margin_m is lost; 0: it is.")
    margin_m: float | None = Field(None, description="The sum of the three terms that follow.")
    wingspans_m: float | None = Field(None, description="Half of each.")
    position_errors_m: float | None = Field(None, description="Of both.")
    balls_m: float | None = Field(
        None, description="How far both may be from where they are taken to be, by their age."
    )


class UnwatchedVehicle(Result):
    vehicle: str
    reason: str
    flying: bool


class MonitorCounters(Result):
    """Since the daemon began."""

    evaluations: int
    pairs_checked: int = Field(description="Pairs whose closest approach was worked out.")
    pairs_dropped: int = Field(description="Conflicts that were not kept: a vehicle has at most 8, the most urgent.")
    notices: int
    warnings: int
    actions: int
    holds: int = Field(description="Orders to hold that were given.")
    holds_failed: int
    orders_checked: int
    orders_refused: int = Field(description="Because of another vehicle.")


class MonitorState(Result):
    mode: Literal["off", "advisory", "acting"]
    horizon_s: float = Field(description="How far ahead it looks.")
    watched: int = Field(description="Vehicles whose position is known, parked ones included.")
    flying: int = Field(description="Those of them that fly.")
    unwatched: list[UnwatchedVehicle]
    conflicts: list[ConflictState] = Field(description="The most urgent first.")
    counters: MonitorCounters
    took_s: float = Field(description="CPU time of the last evaluation.")
    longest_turn_s: float = Field(description="The longest part of it for which everything else had to wait.")


def monitor_status(context: Context, _: NoParams) -> JsonObject:
    """Which vehicles are about to meet, which cannot be watched, and what the monitor has done."""
    return context.services.fleet.monitor.status()


METHODS: tuple[Method[Context], ...] = (
    Method("monitor.status", NoParams, monitor_status, MonitorState, while_stopping=True),
)
