"""What clients are told without asking: telemetry, events, messages.

A client that reads slowly never makes the daemon keep more: telemetry is coalesced per vehicle (fewer, fresher
updates), events and messages wait in bounded queues whose losses are counted and told with the next one.
"""

from __future__ import annotations

import asyncio
import difflib

from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.rpc.dispatch import InvalidParams
from skygcs.rpc.models import SubscribeParams, VehicleState
from skygcs.rpc.notices import EventFeed, EventSubscription, MessageFeed, MessageSubscription
from skygcs.rpc.ports import Daemon, Sink
from skygcs.rpc.telemetry import TelemetryFeed, TelemetrySubscription

DEFAULT_TELEMETRY_HZ = 2.0

Subscription = TelemetrySubscription | EventSubscription | MessageSubscription


class Feeds:
    """The sources of all subscriptions of all clients."""

    def __init__(self, daemon: Daemon, loop: asyncio.AbstractEventLoop) -> None:
        self._daemon = daemon
        self._loop = loop
        self._telemetry = TelemetryFeed(daemon, loop)
        self._events = EventFeed(daemon, loop)
        self._messages = MessageFeed(daemon, loop)

    def add(self, sink: Sink, number: int, params: SubscribeParams) -> Subscription:
        """Begin to tell ``sink``. Raises TargetError and InvalidParams."""
        texts = frozenset(str(name) for name in params.names or ())
        match params.topic:
            case "telemetry":
                _check_sections(texts)
                rate_hz = params.rate_hz or DEFAULT_TELEMETRY_HZ
                telemetry = TelemetrySubscription(sink, number, params.targets, rate_hz, texts)
                self._telemetry.add(telemetry)
                return telemetry
            case "events":
                events = EventSubscription(sink, number, self._loop, self._daemon, params.targets, texts)
                self._events.add(events)
                return events
            case "messages":
                names = None
                if params.names is not None:
                    names = [find_message(self._daemon.dialect, name, "names").name for name in params.names]
                messages = MessageSubscription(sink, number, self._loop, params.rate_hz)
                self._messages.add(messages, names, params.targets)
                return messages

    def remove(self, subscription: Subscription) -> None:
        match subscription:
            case TelemetrySubscription():
                self._telemetry.remove(subscription)
            case EventSubscription():
                self._events.remove(subscription)
            case MessageSubscription():
                self._messages.remove(subscription)

    def resume(self) -> None:
        """Some client takes data again."""
        self._telemetry.resume()

    def close(self) -> None:
        self._telemetry.close()
        self._events.close()
        self._messages.close()


def _check_sections(names: frozenset[str]) -> None:
    unknown = sorted(names - VehicleState.model_fields.keys())
    if unknown:
        there_is = ", ".join(VehicleState.model_fields)
        raise InvalidParams(("names", f"a vehicle's state has no {', '.join(unknown)[:80]}; it has: {there_is}"))


def find_message(dialect: Dialect, name: str | int, param: str) -> MessageInfo:
    """The message of that name or id. Raises InvalidParams for ``param``."""
    try:
        return dialect.find(name)
    except KeyError as error:
        close = difflib.get_close_matches(str(name)[:80].upper(), dialect.by_name, n=3)
        hint = f"did you mean {', '.join(close)}?" if close else "messages.list lists them"
        raise InvalidParams((param, f"{error.args[0]}; {hint}")) from None
