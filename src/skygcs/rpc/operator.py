"""The methods of the operator's presence, for a program that asks on its own while a person may have left.

Each request of a client counts for operator_timeout_s: skygcs-cli sends one because somebody typed it. A web page
refreshes itself for as long as it is open; what relays it calls operator.relay once for each connection, and
operator.active whenever a person used the page. `METHODS` is their part of the table.
"""

from __future__ import annotations

from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import NoParams, Result

RELAY = "operator.relay"
"""The one request that does not count itself."""


class PresenceResult(Result):
    ok: bool


def operator_relay(context: Context, _: NoParams) -> JsonObject:
    """Do not count requests of this connection for operator_timeout_s; only operator.active does.

    For programs that send requests by themselves while a person may have left.
    """
    context.relay_operator()
    return {"ok": True}


def operator_active(context: Context, _: NoParams) -> JsonObject:
    """Report that a person has just done something, for operator_timeout_s."""
    context.services.operator_watchdog.on_client()
    return {"ok": True}


METHODS: tuple[Method[Context], ...] = (
    Method(RELAY, NoParams, operator_relay, PresenceResult, while_stopping=True),
    Method("operator.active", NoParams, operator_active, PresenceResult, while_stopping=True),
)
