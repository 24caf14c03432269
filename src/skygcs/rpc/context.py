"""The context of a call of a method, and the parts that several groups of methods share."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Coroutine, Mapping
from pathlib import Path
from typing import Any, Protocol

from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.vehicle.order_ledger import ClientIdentity
from skygcs.errors import TargetError
from skygcs.rpc import error_codes
from skygcs.rpc.dispatch import Encoded, Method
from skygcs.rpc.json_lines import OrderReports
from skygcs.rpc.models import Outcomes, Result, SubscribeParams, TargetsParams
from skygcs.rpc.slices import Slices
from skygcs.runtime.alarm_book import AlarmBook
from skygcs.runtime.event_log import EventLog
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.fleet_orders import CARRIED_ON, Order
from skygcs.runtime.hub import Hub
from skygcs.runtime.linktable import LinkTable
from skygcs.runtime.operator_watchdog import OperatorWatchdog
from skygcs.runtime.radios import Radios
from skygcs.runtime.recorder import Recorder
from skygcs.runtime.renumbering import Renumbering
from skygcs.runtime.signing_keys import Signing
from skygcs.runtime.vehicle_actor import VehicleActor

JsonObject = dict[str, Any]

RELAY = "operator.relay"
"""The one request that does not count for operator_timeout_s. What relays a web page, which refreshes itself for as
long as it is open, calls it once for each connection, and operator.active whenever a person used the page."""

NewSession = Callable[[Callable[[asyncio.Transport], bool]], asyncio.BaseProtocol]
"""Makes the session of a connection; its argument has the last word on the connection's transport."""


Accept = Callable[[Collection[Method[Any]]], None]
"""Raises for methods that a table cannot take, as their names are those of others."""


class ExtensionParts(Protocol):
    """Parts that the extensions of a daemon add to the socket; `skygcs.extension.Extensions`."""

    def __getitem__(self, table: str) -> Any: ...
    @property
    def methods(self) -> tuple[Method[Context], ...]: ...
    @property
    def state_groups(self) -> Mapping[str, object]: ...
    def require_well(self, word: str) -> None: ...
    def failed(self, word: str, error: Exception) -> Exception: ...
    def demand(self, word: str, accept: Accept) -> tuple[Method[Context], ...]: ...
    def groups_of(self, vehicle: VehicleActor, now: float, names: frozenset[str] | None) -> JsonObject: ...
    async def serve(self, new_session: NewSession) -> None: ...


class Services(Protocol):
    """The parts of a running daemon that methods act on; `skygcs.daemon.Daemon` has all of them."""

    config: FleetConfig
    source: str
    socket_path: Path
    dialect: Dialect
    fleet: Fleet
    hub: Hub
    links: LinkTable
    air: Radios
    renumbering: Renumbering
    operator_watchdog: OperatorWatchdog
    recorder: Recorder | None
    signing: Signing
    event_log: EventLog
    alarms: AlarmBook

    @property
    def extensions(self) -> ExtensionParts: ...
    @property
    def stopping(self) -> bool: ...
    def now(self) -> float: ...
    def info(self) -> JsonObject: ...
    def check_sending(self) -> None: ...


class Context(Protocol):
    """The client that called a method: the daemon it is connected to, its subscriptions, and notifications to it."""

    @property
    def services(self) -> Services: ...
    @property
    def slices(self) -> Slices: ...
    @property
    def reports(self) -> OrderReports | None:
        """Where to report each vehicle's outcome as it comes; None: the client did not ask for it."""
        ...

    @property
    def client(self) -> ClientIdentity:
        """Identity of the client, the same for all of its requests; ``gone`` once its connection has ended."""
        ...

    def subscribe(self, params: SubscribeParams) -> int: ...
    def unsubscribe(self, number: int) -> None: ...
    def relay_operator(self) -> None: ...
    def at_end(self, action: Callable[[], None]) -> Callable[[], None]:
        """Call ``action`` when this client is gone; returns how to take that back. The caller bounds their number."""
        ...

    def notify(self, method: str, params: JsonObject) -> None: ...
    async def described(self, describe: Callable[[tuple[Method[Context], ...]], Encoded]) -> Encoded:
        """Return what ``describe``, which keeps what it made last, makes of all methods that the server has or may
        have; it is called beside the loop."""
        ...


class ReportingContext:
    """The context of a request whose client asked for its outcomes as they come: its session, with `OrderReports`."""

    def __init__(self, session: Context, request_id: str | float) -> None:
        self.reports: OrderReports | None = OrderReports(session, request_id)
        # the rest is the session's; each by its name, so that the type checker knows it
        self.services = session.services
        self.slices = session.slices
        self.client = session.client
        self.subscribe = session.subscribe
        self.unsubscribe = session.unsubscribe
        self.relay_operator = session.relay_operator
        self.at_end = session.at_end
        self.notify = session.notify
        self.described = session.described


class HasDict(Protocol):
    """`Outcome`, `FenceOutcome`, `ParamOutcome`."""

    def as_dict(self) -> JsonObject: ...


def as_json(outcomes: Mapping[str, HasDict]) -> JsonObject:
    """The result of an order: the outcome of each vehicle by its name."""
    return {"outcomes": {name: outcome.as_dict() for name, outcome in outcomes.items()}}


async def command(context: Context, targets: str | list[str], order: Order, **arguments: Any) -> JsonObject:
    """Give one order to all targets at the same time, and report each outcome; see `FleetOrders.command_all`."""
    fleet = context.services.fleet
    return as_json(await fleet.orders.command_all(targets, order, reports=context.reports, **arguments))


def order_method(
    name: str,
    params: type[TargetsParams],
    order: Order,
    description: str,
    *,
    result: type[Result] = Outcomes,
    errors: tuple[int, ...] = (error_codes.TARGET_ERROR,),
    **more: Any,
) -> Method[Context]:
    """The method of an order whose arguments are its parameters. ``more``: for `FleetOrders.command_all`.

    An order that ends a flight is carried on to its outcome if its client leaves, and is accepted from a client that
    came when all places were taken and while the daemon shuts down.
    """

    def handler(context: Context, given: TargetsParams) -> Coroutine[Any, Any, Mapping[str, HasDict]]:
        give = context.services.fleet.orders.command_all
        return give(given.targets, order, reports=context.reports, **more, **given.arguments())

    handler.__doc__ = description
    ends_flight = order in CARRIED_ON
    return Method(name, params, handler, result, errors, ends_flight, ends_flight, shown=as_json)


def resolve(services: Services, targets: str | list[str]) -> list[VehicleActor]:
    """The vehicles of a target expression. Raises TargetError if it names none, except for "all"."""
    if targets in ("all", ["all"]):
        return sorted(services.fleet.vehicles.values(), key=lambda v: (v.sysid, v.compid))
    return services.fleet.resolve(targets)


def one_vehicle(services: Services, target: str) -> VehicleActor:
    """The vehicle of a target expression. Raises TargetError unless it names exactly one."""
    vehicles = resolve(services, target)
    if len(vehicles) != 1:
        names = ", ".join(v.name for v in vehicles[:10]) or "none"
        raise TargetError(f"{target} names {len(vehicles)} vehicles ({names}); give one")
    return vehicles[0]


def state_of(services: Services, vehicle: VehicleActor, names: frozenset[str] | None = None) -> JsonObject:
    """A vehicle's state with the quality of the links it is heard on: all keys, or those in ``names``."""
    state = vehicle.state(services.now(), names)
    if "links" in state:
        state["links"] = services.hub.statistics.link_quality(vehicle.sysid << 8 | vehicle.compid)
    if "separation" in state:
        state["separation"] = services.fleet.monitor.of(vehicle.sysid << 8 | vehicle.compid)
    if "companion" in state:
        state["companion"] = services.fleet.companion_of(vehicle)
    return state | services.extensions.groups_of(vehicle, services.now(), names)
