"""What a method knows of who asks, and what several groups of methods do alike."""

from __future__ import annotations

from typing import Any, Protocol

from skygcs.errors import TargetError
from skygcs.rpc import models as m
from skygcs.rpc.ports import Daemon, JsonObject, Vehicle, resolve
from skygcs.runtime.fleet import Order


class Context(Protocol):
    """What a method knows of who asks: the daemon, and the session's subscriptions."""

    @property
    def daemon(self) -> Daemon: ...
    def subscribe(self, params: m.SubscribeParams) -> int: ...
    def unsubscribe(self, number: int) -> None: ...


async def order(context: Context, order: Order, params: m.TargetsParams) -> JsonObject:
    """An order whose arguments are the parameters."""
    return await outcomes(context, params.targets, order, **params.model_dump(exclude={"targets"}))


async def outcomes(context: Context, targets: str | list[str], order: Order, **arguments: Any) -> JsonObject:
    """The same order to every target at the same time, and what became of it on each."""
    told = await context.daemon.fleet.command_all(targets, order, **arguments)
    return {"outcomes": {name: outcome.as_dict() for name, outcome in told.items()}}


def one_vehicle(daemon: Daemon, target: str) -> Vehicle:
    """The vehicle of a target expression. Raises TargetError unless it names exactly one."""
    vehicles = resolve(daemon, target)
    if len(vehicles) != 1:
        names = ", ".join(v.name for v in vehicles[:10]) or "none"
        raise TargetError(f"{target} names {len(vehicles)} vehicles ({names}); give one")
    return vehicles[0]
