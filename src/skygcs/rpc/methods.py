"""The table of every method of the socket, the methods of the daemon itself, and `rpc.discover`.

A handler's docstring is the method's description in `rpc.discover` and docs/reference/rpc.md.
"""

from __future__ import annotations

import asyncio
import functools
import time
from itertools import islice
from typing import Any

from pydantic import Field

from skygcs.core.alarms import EventSeverity
from skygcs.rpc import (
    alarms,
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
    alarms.METHODS,
    alarms.MONITOR,
    links.AIR,
    (Method("rpc.discover", NoParams, rpc_discover, reach="nothing"),),
)
"""In the order in which they are documented: what an emergency, a setpoint, the origin or an operator's sign of life
needs. Methods that come with their first call are those of extensions on demand (`skygcs.rpc.methods_on_demand`)."""

METHODS: dict[str, Method[Context]] = {method.name: method for part in _PARTS for method in part}
