"""The table of every method of the socket, the methods of the daemon itself, of its events and alarms and of the
separation monitor, and `rpc.discover`.

A handler's docstring is the method's description in `rpc.discover` and docs/reference/rpc.md.
"""

from __future__ import annotations

import asyncio
import functools
import time
from itertools import islice
from typing import Any, Literal

from pydantic import Field

from skygcs.core.alarms import EventSeverity, Severity
from skygcs.rpc import (
    control,
    error_codes,
    links,
    messages,
    vehicles,
)
from skygcs.rpc.context import RELAY, Context, JsonObject
from skygcs.rpc.dispatch import Encoded, Method, document
from skygcs.rpc.models import MethodParams, NoParams, Result, SubscribeParams
from skygcs.rpc.replies import encode
from skygcs.runtime.loop_clock import exact_clock


class EventRecord(Result):
    time_unix_s: float
    kind: str
    vehicle: str | None
    sysid: int | None
    severity: EventSeverity = Field(
        description="alarm: a person has to look now; warning: a change to the worse; info."
    )
    text: str
    data: dict[str, Any]


class ClockReading(Result):
    monotonic_s: float = Field(description="The clock of plans and setpoints here; it restarts with the computer.")
    unix_s: float = Field(description="The wall clock.")


class PresenceResult(Result):
    ok: bool


class RecentParams(MethodParams):
    limit: int = Field(100, ge=1, le=10000, description="At most so many, the newest ones.")


class UnsubscribeParams(MethodParams):
    subscription: int = Field(description="What `subscribe` answered.")


class SubscriptionNumber(Result):
    subscription: int = Field(description="Comes with every notification; needed to unsubscribe.")


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


def daemon_info(context: Context, _: NoParams) -> JsonObject:
    """Version, process id, uptime, own MAVLink ids, dialect, fleet file; now_s: the clock of deadline_s."""
    return {**context.services.info(), "now_s": round(context.services.now(), 4)}


def clock_read(context: Context, _: NoParams) -> JsonObject:
    """Read the clocks of this computer; the caller compares them with its own."""
    return {"monotonic_s": exact_clock(asyncio.get_running_loop())(), "unix_s": time.time()}


def events_recent(context: Context, params: RecentParams) -> list[JsonObject]:
    """The newest events, oldest first."""
    events = context.services.event_log.recent
    return [dict(e) for e in islice(events, max(0, len(events) - params.limit), None)]


def recorder_status(context: Context, _: NoParams) -> JsonObject:
    """The recording: state, file, and what was not recorded."""
    recorder = context.services.recorder
    return {"recording": False} if recorder is None else recorder.status()


def subscribe(context: Context, params: SubscribeParams) -> JsonObject:
    """Receive notifications; each carries the number of the subscription."""
    return {"subscription": context.subscribe(params)}


def unsubscribe(context: Context, params: UnsubscribeParams) -> JsonObject:
    """End a subscription of this connection."""
    context.unsubscribe(params.subscription)
    return {"subscription": params.subscription}


def operator_relay(context: Context, _: NoParams) -> JsonObject:
    """Do not count requests of this connection for operator_timeout_s, but only operator.active.

    For programs that send requests by themselves while a person may have left.
    """
    context.relay_operator()
    return {"ok": True}


def operator_active(context: Context, _: NoParams) -> JsonObject:
    """Report that a person has just done something, for operator_timeout_s."""
    context.services.operator_watchdog.on_client()
    return {"ok": True}


def alarms_list(context: Context, _: NoParams) -> JsonObject:
    """Open alarms, and acknowledged ones whose condition lasts. Each change is an event of kind "alarm"."""
    return {"alarms": context.services.alarms.all()}


def alarms_acknowledge(context: Context, params: AcknowledgeParams) -> JsonObject:
    """Acknowledge alarms. One whose condition is over leaves the list."""
    return {"acknowledged": context.services.alarms.acknowledge(params.numbers, params.by)}


def monitor_status(context: Context, _: NoParams) -> JsonObject:
    """Vehicles about to meet, those that cannot be watched, and what the monitor has done."""
    return context.services.fleet.monitor.status()


async def rpc_discover(context: Context, _: NoParams) -> Encoded:
    """This interface as an OpenRPC document, with the methods of the extensions that run."""
    return await context.described(_document)


@functools.lru_cache(maxsize=1)
def _document(methods: tuple[Method[Context], ...]) -> Encoded:
    """Made once, on the first question: it takes half a second."""
    of_extensions = (method for method in methods if method.name not in METHODS)
    return Encoded(encode(document((*METHODS.values(), *of_extensions))))


_PARTS: tuple[tuple[Method[Context], ...], ...] = (
    (Method("daemon.info", NoParams, daemon_info, always=True),),
    vehicles.METHODS,
    messages.ORDERS,
    (vehicles.COMPONENTS,),
    messages.METHODS,
    links.METHODS,
    (
        Method("events.recent", RecentParams, events_recent, list[EventRecord], while_stopping=True),
        Method("recorder.status", NoParams, recorder_status, while_stopping=True),
        Method(
            "subscribe",
            SubscribeParams,
            subscribe,
            SubscriptionNumber,
            (error_codes.TARGET_ERROR, error_codes.LIMIT_EXCEEDED),
            while_stopping=True,
        ),
        Method("unsubscribe", UnsubscribeParams, unsubscribe, SubscriptionNumber, while_stopping=True),
    ),
    (
        Method(RELAY, NoParams, operator_relay, PresenceResult, while_stopping=True),
        Method("operator.active", NoParams, operator_active, PresenceResult, while_stopping=True),
    ),
    control.ORIGIN,
    control.METHODS,
    (Method("clock.read", NoParams, clock_read, ClockReading, while_stopping=True),),
    (
        Method("alarms.list", NoParams, alarms_list, AlarmList, while_stopping=True),
        Method("alarms.acknowledge", AcknowledgeParams, alarms_acknowledge, Acknowledged),
        Method("monitor.status", NoParams, monitor_status, MonitorState, while_stopping=True),
    ),
    links.AIR,
    (Method("rpc.discover", NoParams, rpc_discover, reach="nothing"),),
)
"""In the order in which they are documented: what an emergency, a setpoint, the origin or an operator's sign of life
needs. Methods that come with their first call are those of extensions on demand (`skygcs.rpc.methods_on_demand`)."""

METHODS: dict[str, Method[Context]] = {method.name: method for part in _PARTS for method in part}
