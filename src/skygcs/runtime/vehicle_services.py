"""Dependencies shared by the actors of a fleet's vehicles: the daemon's ids, clock and journal, and the links."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Protocol

from skygcs.config.models import VehicleConfig
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.monitor.tracks import Place
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.routing.source_statistics import LinkFacts
from skygcs.core.vehicle.frames import Setpoint
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.disk_writer import DiskWriter
from skygcs.events import Event
from skygcs.runtime.command_client import SendFn
from skygcs.runtime.flight_elsewhere import FlightElsewhere
from skygcs.runtime.flight_locks import FlightLocks
from skygcs.runtime.loop_clock import ControlClock
from skygcs.runtime.param_cache import ParamCache
from skygcs.runtime.task_set import OneATurn
from skygcs.runtime.undo_journal import UndoJournal

MAX_VEHICLES = 300
"""Vehicles of a fleet at most: those that one link may have, and room for those of others."""

OnEvent = Callable[[Event], None]

NewFlight = Callable[[Vehicle, VehicleConfig, "VehicleServices"], FlightElsewhere]
"""Makes the flight of a vehicle whose `ControlSettings.at` is an extension's."""

OrderRefusal = Callable[[Vehicle, Plan, float], str | None]


def no_order_refusal(vehicle: Vehicle, plan: Plan, now: float) -> str | None:
    """Every order passes."""
    return None


class VehicleLinks(Protocol):
    """The links to a fleet's vehicles (`link_view.LinkView`). ``flown``: all vehicles that are flown by setpoints."""

    def setpoint_bytes_per_s(self, vehicle: Vehicle, flown: Callable[[], Iterable[Vehicle]]) -> float:
        """The rate available for setpoints on the links to this vehicle; infinite if none is slow. ``flown`` walks the
        whole fleet: it is called only for a slow link."""
        ...

    def stream_refusal(self, vehicle: Vehicle, flown: Callable[[], Iterable[Vehicle]]) -> str | None:
        """Why its radio cannot carry a stream of setpoints; None if it can."""
        ...

    def facts(self, key: int, now: float) -> Mapping[str, LinkFacts]:
        """How well a vehicle (sysid << 8 | compid) is heard, by link."""
        ...

    def why_silent(self, vehicle: Vehicle) -> str:
        """Why a vehicle that is heard may not answer: the end of a sentence, or ""."""
        ...

    def may_broadcast(self) -> bool:
        """True if no link could carry a frame for all vehicles to one that is not in the fleet."""
        ...

    def radio_to(self, vehicle: Vehicle) -> str | None:
        """The name of a radio link that leads to this vehicle; None if no link that it is heard on is a radio."""
        ...

    def is_replayed(self, key: int) -> bool:
        """True if this source exists only in a recording."""
        ...

    def channels_to(self, vehicle: Vehicle) -> tuple[int, ...]:
        """Ids of the channels on which a message of ours to this vehicle is sent now."""
        ...

    def holds(self, vehicle: Vehicle, priority: Priority, key: Hashable) -> bool:
        """True if a message of ours to this vehicle still waits to be sent under this key."""
        ...

    def links_to(self, vehicle: Vehicle) -> frozenset[str]:
        """Names of the links over which this vehicle is heard now."""
        ...

    def uplink_lost(self, key: int) -> None:
        """A vehicle does not hear us over the link that is used, one of several."""
        ...

    def counts_on(self, key: int, channel_id: int) -> Mapping[int, int] | None:
        """Frames of a vehicle on one channel by message id; None: it is heard on one channel only."""
        ...

    def forget_flows(self) -> None:
        """Vehicles or components were added or removed: cached flows are out of date."""
        ...

    def authority_refusal(self, sysid: int) -> str | None:
        """Why nothing may be sent to this system now, as an extension gates it; None if it may. By the clock of now:
        call it at the moment of sending."""
        ...


class SetpointProgram(Protocol):
    """A program inside the daemon that flies several vehicles by setpoints and keeps them apart."""

    @property
    def keys(self) -> frozenset[int]:
        """The vehicles that it flies now, by sysid << 8 | compid."""
        ...

    def foreseen(self, key: int) -> list[Place]:
        """Where one of them will be now and every `PLAN_STEP_S` of the monitor; empty: it is not one of them."""
        ...


class VehiclePart:
    """Base of what an extension keeps for one vehicle and makes of its actor (`VehicleActor.part`). The actor passes on
    what happens to the vehicle; every call that a part does not override does nothing, and none may raise."""

    messages: ClassVar[frozenset[int]] = frozenset()
    """The messages of the vehicle whose frames `on_frame` gets. No other part of the actor may read them."""

    def on_frame(self, frame: Frame, now: float) -> None:
        """One frame of these messages. Hot."""

    def on_text(self, text: str) -> None:
        """A status text of the vehicle."""

    def on_armed(self) -> None:
        """It was armed."""

    def on_reboot(self) -> None:
        """It has rebooted; `stop` was called before."""

    def tick(self, now: float) -> None:
        """Called one to ten times a second."""

    def stop(self, result: str, text: str) -> None:
        """End every exchange with the vehicle with this result: it was lost, its id is no longer its own, or nothing
        may be sent to it."""

    async def wind_down(self) -> None:
        """The daemon ends: undo what has begun, while the links are open."""

    def close(self, reason: str) -> None:
        """Nothing goes to the vehicle any more."""

    async def ended(self) -> None:
        """After `close`: wait until the changes that could not be undone have been noted."""


class OrderChecks(Protocol):
    """Check whether an order would bring a vehicle too close to another (`separation_monitor.SeparationMonitor`): a
    reason to refuse it, or None."""

    def takeoff_refusal(self, vehicle: Vehicle, height_m: float) -> str | None: ...
    def setpoint_refusal(self, vehicle: Vehicle, setpoint: Setpoint, together: frozenset[int]) -> str | None: ...


class NoOrderChecks:
    """Every order passes."""

    def takeoff_refusal(self, vehicle: Vehicle, height_m: float) -> str | None:
        return None

    def setpoint_refusal(self, vehicle: Vehicle, setpoint: Setpoint, together: frozenset[int]) -> str | None:
        return None


@dataclass(frozen=True, slots=True)
class VehicleServices:
    """Created once by the fleet and passed to every actor."""

    own: tuple[int, int]
    """Our system and component id."""
    dialect: Dialect
    send: SendFn
    """`Hub.send`."""
    loop: asyncio.AbstractEventLoop
    on_event: OnEvent
    links: VehicleLinks
    flown: Callable[[], Iterable[Vehicle]]
    """All vehicles that are controlled by setpoints, which share the links."""
    param_cache: ParamCache
    journal: UndoJournal
    """Journal of changes to undo."""
    disk: DiskWriter
    """Writes files beside the loop."""
    order_checks: OrderChecks = field(default_factory=NoOrderChecks)
    log_dir: Path = Path("logs")
    """Folder for control traces and records of fence tests."""
    flights_elsewhere: Mapping[str, NewFlight] = field(default_factory=dict)
    """Makers of flights elsewhere, by values of `ControlSettings.at`."""
    locks: FlightLocks = field(default_factory=FlightLocks)
    """Locks of the flights under way: asked before an order that could change one."""
    preflight_valid_s: float = math.inf
    probes: bool = False
    """True if uplinks are probed."""
    order_refusal: OrderRefusal = no_order_refusal
    """Why an extension objects to an order (`Extensions.order_refusal`); None: it may be sent."""
    asleep: Callable[[], bool] = lambda: False
    """`SleepWatch.check`."""
    running_clocks: set[ControlClock] = field(default_factory=set)
    """Clocks of all vehicles that are controlled by setpoints."""
    one_a_turn: OneATurn = field(default_factory=OneATurn)
    """Awaited by what reads much for one vehicle, as it is often asked of all: 60 of them held the loop for 20 s."""
