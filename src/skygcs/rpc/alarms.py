"""The methods of alarms. `METHODS` is their part of the table."""

from __future__ import annotations

from pydantic import Field

from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, NoParams, Result


class AlarmResult(Result):
    """One alarm. Times are of the Unix clock."""

    number: int
    kind: str = Field(description="lost, deaf, battery, failsafe, stop, takeoff, guard, fence, separation, …")
    vehicle: str | None
    other: str | None = Field(description="The second vehicle of a conflict.")
    severity: str = Field(description="alarm: a person has to look now; warning.")
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


def alarms_list(context: Context, _: NoParams) -> JsonObject:
    """The alarms that are open, and those that were acknowledged and whose condition lasts.

    They are the daemon's: the same for every client, and kept over a restart. Each change is an event of kind "alarm".
    """
    return {"alarms": context.services.alarms.all()}


def alarms_acknowledge(context: Context, params: AcknowledgeParams) -> JsonObject:
    """Acknowledge alarms: a person has seen them. One whose condition is over leaves the list."""
    return {"acknowledged": context.services.alarms.acknowledge(params.numbers, params.by)}


METHODS: tuple[Method[Context], ...] = (
    Method("alarms.list", NoParams, alarms_list, AlarmList, while_stopping=True),
    Method("alarms.acknowledge", AcknowledgeParams, alarms_acknowledge, Acknowledged),
)
