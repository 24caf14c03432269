"""The methods of alarms, and of the monitor, which raises those of vehicles that are about to meet. `METHODS` and
`MONITOR` are their parts of the table."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from skygcs.core.alarms import Severity
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, NoParams, Result


class AlarmResult(Result):
    """One alarm. Times are of the Unix clock."""

    number: int
    kind: str = Field(description="lost, deaf, battery, failsafe, stop, takeoff, guard, fence, separation, …")
    vehicle: str | None
    other: str | None = Field(description="The second vehicle of a conflict.")
    severity: Severity = Field(description="alarm: a person has to look now.")
    text: str
    raised_unix_s: float
    changed_unix_s: float
    active: bool = Field(description="Its condition lasts.")
    count: int = Field(description="How often it was raised.")
    consequences: dict[str, int] = Field(description="What followed from it and is no alarm of its own, by kind.")
    acknowledged_by: str | None = Field(description="null: it is open.")
    acknowledged_unix_s: float | None


class AlarmList(Result):
    alarms: list[AlarmResult] = Field(description="Open ones first, the newest first.")


class AcknowledgeParams(MethodParams):
    by: str = Field(min_length=1, max_length=80, pattern=r"^[^\x00-\x1f\x7f]*$", description="Who acknowledges.")
    numbers: list[int] | None = Field(None, max_length=1000, description="null: all that are open.")


class Acknowledged(Result):
    acknowledged: list[AlarmResult] = Field(description="Those of them that were open.")


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


def alarms_list(context: Context, _: NoParams) -> JsonObject:
    """Open alarms, and acknowledged ones whose condition lasts. Each change is an event of kind "alarm"."""
    return {"alarms": context.services.alarms.all()}


def alarms_acknowledge(context: Context, params: AcknowledgeParams) -> JsonObject:
    """Acknowledge alarms. One whose condition is over leaves the list."""
    return {"acknowledged": context.services.alarms.acknowledge(params.numbers, params.by)}


def monitor_status(context: Context, _: NoParams) -> JsonObject:
    """Vehicles about to meet, those that cannot be watched, and what the monitor has done."""
    return context.services.fleet.monitor.status()


METHODS: tuple[Method[Context], ...] = (
    Method("alarms.list", NoParams, alarms_list, AlarmList, while_stopping=True),
    Method("alarms.acknowledge", AcknowledgeParams, alarms_acknowledge, Acknowledged),
)

MONITOR: tuple[Method[Context], ...] = (
    Method("monitor.status", NoParams, monitor_status, MonitorState, while_stopping=True),
)
