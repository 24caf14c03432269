"""What the RPC server needs of the daemon, and no more: the seam at which tests put a fake one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame

JsonObject = dict[str, Any]
OnFrame = Callable[[Frame, Any, float], None]
OnEvent = Callable[[Mapping[str, Any]], None]
Unsubscribe = Callable[[], object]


class OutcomeLike(Protocol):
    """skygcs.core.exchange.command.Outcome."""

    def as_dict(self) -> JsonObject: ...


class Vehicle(Protocol):
    """skygcs.runtime.vehicle_actor.VehicleActor."""

    @property
    def name(self) -> str: ...
    @property
    def sysid(self) -> int: ...
    @property
    def compid(self) -> int: ...
    def state(self, now: float) -> JsonObject: ...
    def latest(self, message_name: str) -> JsonObject | None: ...


class Fleet(Protocol):
    """skygcs.runtime.fleet.Fleet; ``vehicles`` by sysid << 8 | compid."""

    @property
    def vehicles(self) -> Mapping[int, Vehicle]: ...
    def resolve(self, targets: str | list[str]) -> Sequence[Vehicle]: ...
    async def command_all(
        self, targets: str | list[str], order: str, /, **arguments: Any
    ) -> Mapping[str, OutcomeLike]: ...


class Daemon(Protocol):
    """skygcs.daemon.Daemon."""

    @property
    def dialect(self) -> Dialect: ...
    @property
    def fleet(self) -> Fleet: ...
    @property
    def events(self) -> Sequence[Mapping[str, Any]]: ...
    def now(self) -> float: ...
    def info(self) -> JsonObject: ...
    def link_quality(self, key: int) -> JsonObject: ...
    def links_status(self) -> list[JsonObject]: ...
    async def add_link(self, name: str, link: JsonObject) -> Any: ...
    async def change_link(self, name: str, link: JsonObject) -> Any: ...
    async def remove_link(self, name: str) -> Any: ...
    def router_stats(self) -> JsonObject: ...
    def recorder_status(self) -> JsonObject: ...
    def send_message(self, name: str, fields: JsonObject, target: str | None, link: str | None) -> JsonObject: ...
    def subscribe_events(self, callback: OnEvent) -> Unsubscribe: ...
    def subscribe_messages(self, names: set[str] | None, keys: set[int] | None, callback: OnFrame) -> Unsubscribe: ...


class Sink(Protocol):
    """A client's output, as subscriptions see it."""

    @property
    def writable(self) -> bool:
        """False while the client has not taken what was written before."""
        ...

    def write(self, data: bytes) -> None: ...


def resolve(daemon: Daemon, targets: str | list[str]) -> list[Vehicle]:
    """The vehicles of a target expression; "all" may be none. Raises TargetError for any other that names none."""
    if targets in ("all", ["all"]):
        return sorted(daemon.fleet.vehicles.values(), key=lambda v: (v.sysid, v.compid))
    return list(daemon.fleet.resolve(targets))


def state_of(daemon: Daemon, vehicle: Vehicle) -> JsonObject:
    """A vehicle's state with the links it is heard on."""
    state = vehicle.state(daemon.now())
    state["links"] = daemon.link_quality(vehicle.sysid << 8 | vehicle.compid)
    return state
