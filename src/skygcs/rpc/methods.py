"""The table of every method of the socket, the methods of the daemon itself, and `rpc.discover`.

A handler's docstring is the method's description in `rpc.discover` and docs/reference/rpc.md.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Iterable
from itertools import islice
from typing import Any

from pydantic import Field, TypeAdapter

from skygcs import __version__
from skygcs.rpc import (
    companions,
    control,
    dispatch,
    links,
    messages,
    missions,
    mocap,
    monitor,
    onboard_logs,
    operator,
    origin,
    params,
    planning,
    plans,
    relayed_control,
    signing,
    trajectory,
    vehicles,
)
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, NoParams, Result, SubscribeParams


class EventRecord(Result):
    time_unix_s: float
    kind: str
    vehicle: str | None
    sysid: int | None
    text: str
    data: dict[str, Any]


class RecentParams(MethodParams):
    limit: int = Field(100, ge=1, le=10000, description="At most so many, the newest ones.")


class UnsubscribeParams(MethodParams):
    subscription: int = Field(description="What `subscribe` answered.")


class SubscriptionNumber(Result):
    subscription: int = Field(description="Comes with every notification; needed to unsubscribe.")


def daemon_info(context: Context, _: NoParams) -> JsonObject:
    """Version, process id, uptime, own MAVLink ids, dialect, fleet file; now_s, the clock of a request's deadline_s."""
    return {**context.services.info(), "now_s": round(context.services.now(), 4)}


def events_recent(context: Context, params: RecentParams) -> list[JsonObject]:
    """The newest events, oldest first."""
    events = context.services.event_log.recent
    return [dict(e) for e in islice(events, max(0, len(events) - params.limit), None)]


def recorder_status(context: Context, _: NoParams) -> JsonObject:
    """What is recorded, where, and what could not be recorded."""
    recorder = context.services.recorder
    return {"recording": False} if recorder is None else recorder.status()


def subscribe(context: Context, params: SubscribeParams) -> JsonObject:
    """Receive notifications from now on: "telemetry", "event", "message" or "plan".

    Each carries the subscription's number and a state, an event, a message or the status of the plan. A client that
    reads slowly gets fewer, fresher telemetry updates; events and messages that did not fit are counted in "dropped".
    """
    return {"subscription": context.subscribe(params)}


def unsubscribe(context: Context, params: UnsubscribeParams) -> JsonObject:
    """End a subscription of this connection."""
    context.unsubscribe(params.subscription)
    return {"subscription": params.subscription}


def rpc_discover(context: Context, _: NoParams) -> JsonObject:
    """This interface as an OpenRPC document."""
    return _document()


@functools.cache
def _document() -> JsonObject:
    """Made once, on the first question: it takes 15 ms."""
    return document(METHODS.values())


ERRORS: dict[int, str] = {
    dispatch.TARGET_ERROR: "The targets name no vehicle; the text names the part that matches none, and the vehicles.",
    dispatch.REFUSED: "skygcs refuses the order itself; the text says why.",
    dispatch.LINK_ERROR: "A link could not be opened, changed or sent on.",
    dispatch.NOT_AUTHENTICATED: "TCP only: the first request must be auth with the token.",
    dispatch.LIMIT_EXCEEDED: "A limit per client is reached; the text names it.",
}


_REF = "#/components/schemas/{model}"


def document(methods: Iterable[Method[Any]]) -> dict[str, Any]:
    """All of it, JSON-able; takes some milliseconds."""
    methods = list(methods)
    results = [(i, "serialization", TypeAdapter(method.result)) for i, method in enumerate(methods)]
    result_schemas, definitions = TypeAdapter.json_schemas(
        [(key, "serialization", adapter) for key, _, adapter in results], ref_template=_REF
    )
    components = dict(definitions.get("$defs", {}))
    described = []
    for i, method in enumerate(methods):
        params = method.params.model_json_schema(ref_template=_REF)
        components.update(params.get("$defs", {}))
        described.append(_method(method, params, result_schemas[i, "serialization"]))
    return {
        "openrpc": "1.3.2",
        "info": {
            "title": "skygcs",
            "version": __version__,
            "description": "JSON-RPC 2.0, one object a line, on a Unix socket (or TCP on loopback, after auth).",
        },
        "methods": described,
        "components": {"schemas": components},
    }


def _method(method: Method[Any], params: dict[str, Any], result: Any) -> dict[str, Any]:
    text = inspect.cleandoc(method.handler.__doc__ or "")
    required = set(params.get("required", ()))
    return {
        "name": method.name,
        "summary": text.split("\n", 1)[0],
        "description": text,
        "paramStructure": "either",
        "params": [
            {"name": name, "description": schema.get("description", ""), "required": name in required, "schema": schema}
            for name, schema in params.get("properties", {}).items()
        ],
        "result": {"name": "result", "schema": result},
        "errors": [{"code": code, "message": ERRORS[code]} for code in method.errors],
    }


METHODS: dict[str, Method[Context]] = {
    method.name: method
    for method in (
        Method("daemon.info", NoParams, daemon_info, always=True),
        *vehicles.METHODS,
        *messages.ORDERS,
        vehicles.COMPONENTS,
        *messages.METHODS,
        *links.METHODS,
        Method("events.recent", RecentParams, events_recent, list[EventRecord], while_stopping=True),
        Method("recorder.status", NoParams, recorder_status, while_stopping=True),
        Method(
            "subscribe",
            SubscribeParams,
            subscribe,
            SubscriptionNumber,
            (dispatch.TARGET_ERROR, dispatch.LIMIT_EXCEEDED),
            while_stopping=True,
        ),
        Method("unsubscribe", UnsubscribeParams, unsubscribe, SubscriptionNumber, while_stopping=True),
        *operator.METHODS,
        *origin.METHODS,
        *params.METHODS,
        *control.METHODS,
        *trajectory.METHODS,
        *relayed_control.METHODS,
        *plans.METHODS,
        *planning.METHODS,
        *mocap.METHODS,
        *companions.METHODS,
        *monitor.METHODS,
        *missions.METHODS,
        *links.AIR,
        *links.CORRECTIONS,
        *missions.FENCE,
        *onboard_logs.METHODS,
        *signing.METHODS,
        *params.PREFLIGHT,
        *params.UNDO,
        Method("rpc.discover", NoParams, rpc_discover),
    )
}
"""By name, in the order in which they are documented."""
