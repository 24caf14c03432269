"""The one door of the daemon: what an extension is, and how the daemon runs the ones that its fleet file asks for.

An extension is one class. It owns one table of the fleet file, whose presence turns it on, and may bring methods,
groups of a vehicle's state, clocks, a start and an end, and hooks: frames that it observes, orders that it checks
before they are sent, and a gate before bytes are sent. The package that has it names it as an entry point of the group
`skygcs.extensions`, with the name of the table: docs/howto/extension.md shows one of 60 lines.

An extension without a table is an entry point of the group `skygcs.on_demand`, with the first word of its methods (or,
as `vehicles.calibrate`, with the begin of all their names up to a `_`). It is imported beside the loop and made when
one of them is first called; nothing is asked of it but methods, state groups, orders to check, and its end.

What a running daemon calls, and when:

    __init__       once, before a link is open; `core` is complete but for its socket
    registered     once its methods and groups are accepted
    send_gate      once, before a link is open; the daemon does not start without the gate
    claim          before anything begins: bind an address, open a file
    run, clocks    their tasks run from the opening of the links to the end
    new_flight     a vehicle is met whose `ControlSettings.at` is its own
    serve          the task runs from when the socket answers to its end
    start          after the socket answers
    woke           this computer slept, or the process stood still
    on_frame, order_refusal, state_groups       as frames, orders and clients come
    close          the daemon ends: nothing is sent after it; links are open, orders still end
    ended          after all links: wait for files and connections, briefly
"""

from __future__ import annotations

import asyncio
import functools
import math
import re
from collections.abc import Awaitable, Callable, Collection, Coroutine, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar, cast

from skygcs.config.extension_tables import find_on_demand
from skygcs.config.tables import Model, Problem
from skygcs.core.routing.send_gates import SendGate, SendGates
from skygcs.errors import ConfigError, RefusedError

if TYPE_CHECKING:  # an extension imports what it uses
    from skygcs.config.models import FleetConfig, VehicleConfig
    from skygcs.core.mavlink.frame import Frame
    from skygcs.core.vehicle.order_plan import Plan
    from skygcs.core.vehicle.vehicle import Vehicle
    from skygcs.links.base import Channel
    from skygcs.rpc.context import Accept, Context, NewSession, Services
    from skygcs.rpc.dispatch import Method
    from skygcs.runtime.flight_elsewhere import FlightElsewhere
    from skygcs.runtime.vehicle_actor import VehicleActor
    from skygcs.runtime.vehicle_services import NewFlight, VehicleServices

C = TypeVar("C", bound=Model)

ENDS_FLIGHT = frozenset({"land", "rtl", "hold", "stop", "disarm", "release"})
"""Orders that end a flight, or a motion: no extension is asked about them."""

MADE_AGAIN_S = 5.0
"""From a failure to make an extension on demand to the next attempt: calls meanwhile are refused at once."""

AGAIN_S = 1.0
"""From a fault of an extension's work to its next begin: a fault that stays is reported, and takes no core."""


class NoTable(Model):
    """The table of an extension that has none."""


StateGroup = Callable[["VehicleActor", float], dict[str, Any] | None]
"""One group of a vehicle's state now; None: it has none."""


@dataclass(frozen=True, slots=True)
class Clock:
    """An action that is called at the start and then every ``period_s``. An exception of it is reported once as a
    fault, and stops nothing."""

    name: str
    period_s: float
    action: Callable[[], None]


class Extension(Generic[C]):
    """Base of extensions: every part that one does not override is empty."""

    Config: ClassVar[type[Model]] = NoTable
    """Its table of the fleet file: frozen, unknown keys refused, a default for each key if the table may be empty."""

    names: ClassVar[tuple[str, ...]] = ()
    """First words of its methods and state groups beside the name of its table."""

    own_methods: ClassVar[tuple[Method[Context], ...]] = ()
    """Its RPC methods, where they do not follow from its table."""

    control_at: ClassVar[str | None] = None
    """The value of `ControlSettings.at` for vehicles that it flies from elsewhere; see `new_flight`."""

    def __init__(self, core: Services, config: C) -> None:
        self.core = core
        self.config = config

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        """Everything wrong with its table beside the other tables, such as a vehicle that they do not name."""
        return []

    @classmethod
    def notes(cls, config: Any) -> list[str]:
        """Return what is missing and may come before the daemon starts, for `skygcs check`: a package, a file, a
        device."""
        return []

    @classmethod
    def fleet_notes(cls, config: Any, fleet: FleetConfig) -> list[str]:
        """Return what to look at in the fleet file for this table, for `skygcs check`, though it is no error."""
        return []

    @classmethod
    def summary(cls, config: Any) -> str:
        """Return what one line of `skygcs check` shows of it; "": nothing."""
        return ""

    @classmethod
    def applied(cls, config: Any, fleet: FleetConfig) -> FleetConfig:
        """The fleet file as the daemon runs it with this table: other ids of ours, a further link, the vehicles that
        other ground stations may command. Called also for a file that has problems."""
        return fleet

    # -- what it adds

    def methods(self) -> Iterable[Method[Context]]:
        """Its RPC methods; their names begin with the name of its table, or one of ``names``."""
        return self.own_methods

    def state_groups(self) -> Mapping[str, StateGroup]:
        """Its groups of a vehicle's state, by name. One of the core's name takes the place of that."""
        return {}

    def new_flight(self, vehicle: Vehicle, config: VehicleConfig, services: VehicleServices) -> FlightElsewhere:
        """The flight by setpoints of a vehicle whose `ControlSettings.at` is ``control_at``."""
        raise NotImplementedError(f"{type(self).__name__} flies no vehicle")

    def clocks(self) -> Iterable[Clock]:
        """Its clocks."""
        return ()

    def info(self) -> Mapping[str, Any] | None:
        """Return what daemon.info shows under the name of its table; None: nothing."""
        return None

    def announcement(self) -> str:
        """Return what the log says of it when the daemon is up; "": nothing."""
        return ""

    # -- its life

    def registered(self) -> None:
        """Called once its methods and groups are taken, before one of them is called: here, and not when it is made, it
        puts itself into the core. An exception ends it."""

    def claim(self) -> None:
        """Take what another process could have. Raises SkygcsError: the daemon does not start then."""

    async def run(self) -> None:
        """Work until the task is cancelled, or there is nothing more to do. An exception is reported as a fault, and it
        is called again `AGAIN_S` later."""

    async def serve(self, new_session: NewSession) -> None:
        """Accept clients of the socket in a way of its own, each as one session, until the task is cancelled: it begins
        when the socket listens. An exception is a fault, as of `run`."""

    async def start(self) -> None:
        """Begin. Raises SkygcsError: the daemon ends then."""

    def woke(self, why: str) -> None:
        """This computer slept, or the process stood still (``why``, the begin of a sentence): nothing counts that came
        before, or has waited since in a connection of its own; close that and open it again. All vehicles are dropped
        already. What it reads itself asks the fleet's `SleepWatch.check` before it counts: it may come before
        this call."""

    def close(self) -> None:
        """End its work; idempotent."""

    async def ended(self) -> None:
        """Wait for the end of what `close` ended."""

    # -- hooks

    def observed_msgids(self) -> Collection[int]:
        """The messages whose frames `on_frame` gets; asked once, before a link is open."""
        return ()

    def on_frame(self, frame: Frame, channel: Channel, now: float) -> None:
        """One good frame of an observed message, from anybody. It is on the path of every such frame: be short. An
        exception of it is reported as a fault and stops nothing."""

    def bytes_per_s(self, channel_id: int) -> float:
        """The bytes that it sends on a channel by itself; setpoints share what it leaves."""
        return 0.0

    def order_refusal(self, vehicle: Vehicle, plan: Plan, now: float) -> str | None:
        """Why an order must not be sent to a vehicle; None: it may. Never asked about an emergency stop, nor about a
        landing, a return, a hold or a disarming: what ends a flight always passes."""
        return None

    def send_gate(self) -> SendGate | None:
        """The gate of vehicles to which it lets nothing be sent at times, by whoever: not a byte but vehicles.stop
        leaves for one that it refuses, control of it ends, and orders are refused in the gate's words. A gate that
        raises is closed. None: it gates no vehicle."""
        return None


class Extensions:
    """The extensions of one running daemon. What one of them does wrong is reported as a fault and stops nothing."""

    def __init__(
        self,
        parts: Mapping[str, Extension[Any]],
        on_fault: Callable[[Exception], None],
        core: Services | None = None,
    ) -> None:
        """``parts``: by the names of their tables; ``core``: what extensions without a table are made with, None: none
        is made. Raises ConfigError for a name that is not the extension's own."""
        self._parts: dict[str, Extension[Any]] = {}
        self._on_fault = on_fault
        self._core = core
        self._closed = False
        self._failed: dict[str, tuple[float, RefusedError]] = {}
        """By the first word, until when one that could not be made is not tried again, and the refusal."""
        self._demanded: dict[str, tuple[Method[Context], ...]] = {}
        """Methods of those that were made on demand, by their first word."""
        self.methods: tuple[Method[Context], ...] = ()
        self.state_groups: dict[str, StateGroup] = {}
        for table, part in parts.items():
            self._take(table, part)

    def _take(self, table: str, part: Extension[Any], accept: Accept = lambda methods: None) -> None:
        """Check its names, then register it. Raises what one of these raises; it is not registered
        then."""
        methods, groups = tuple(part.methods()), part.state_groups()
        problems = [
            f"its extension names the {kind} {name}: the name must begin with {' or '.join((table, *part.names))}"
            for kind, names in (("method", [m.name for m in methods]), ("state group", groups))
            for name in names
            if not any(re.match(rf"{re.escape(word)}([._]|$)", name) for word in (table, *part.names))
        ]
        if problems:
            raise ConfigError(table, problems)
        accept(methods)
        part.registered()
        self._parts[table] = part
        self.methods += methods
        self.state_groups |= groups

    def demand(self, word: str, accept: Accept = lambda methods: None) -> tuple[Method[Context], ...]:
        """Make the extension without a table whose methods begin with this word, once. Returns its methods; none: no
        such one is installed. ``accept`` raises for methods that cannot be taken. Raises RefusedError if it cannot be
        made, for `MADE_AGAIN_S` without another attempt, and after `close`."""
        if word not in self._demanded:
            self.require_well(word)
            if self._core is None or word in self._parts:
                return ()
            before, part = len(self.methods), None
            try:
                if (found := find_on_demand(word)) is None:
                    return ()
                part = cast("type[Extension[Any]]", found)(self._core, found.Config())
                self._take(word, part, accept)
            except Exception as error:
                if part is not None:
                    self._close(part)
                raise self.failed(word, error) from error
            self._demanded[word] = self.methods[before:]
        return self._demanded[word]

    def require_well(self, word: str) -> None:
        """Raises RefusedError if this one is not to be made now."""
        if self._closed:
            raise RefusedError("skygcs is shutting down")
        until_s, refusal = self._failed.get(word, (-math.inf, None))
        if refusal is not None and self._core is not None and self._core.now() < until_s:
            raise refusal

    def failed(self, word: str, error: Exception) -> RefusedError:
        """Report that this one could not be imported or made. Returns the refusal of calls from now on."""
        self._on_fault(error)
        refusal = RefusedError(f"the extension of {word} cannot be made, see the log: {type(error).__name__}: {error}")
        if self._core is not None:
            self._failed[word] = (self._core.now() + MADE_AGAIN_S, refusal)
        return refusal

    def __iter__(self) -> Iterator[Extension[Any]]:
        return iter(tuple(self._parts.values()))  # one may be made on demand while these are started

    def __getitem__(self, table: str) -> Extension[Any]:
        """The extension of this table, or of this first word of methods. Raises KeyError."""
        return self._parts[table]

    def flights_elsewhere(self) -> dict[str, NewFlight]:
        """Makers of flights elsewhere, by their values of `ControlSettings.at`."""
        return {part.control_at: part.new_flight for part in self if part.control_at is not None}

    def places_of_control(self) -> dict[str, str]:
        """Their values of `ControlSettings.at`, with the names of their tables."""
        return {part.control_at: table for table, part in self._parts.items() if part.control_at is not None}

    def groups_of(self, vehicle: VehicleActor, now: float, names: frozenset[str] | None) -> dict[str, Any]:
        """Their groups of a vehicle's state: all, or those in ``names``. The group of one that fails is None."""
        groups: dict[str, Any] = {}
        for name, read in self.state_groups.items():
            if names is None or name in names:
                try:
                    groups[name] = read(vehicle, now)
                except Exception as error:
                    self._on_fault(error)
                    groups[name] = None
        return groups

    def order_refusal(self, vehicle: Vehicle, plan: Plan, now: float) -> str | None:
        """Why an order must not be sent; None: no extension objects. One whose check fails refuses the order: it may
        have had a reason."""
        if plan.emergency or plan.order in ENDS_FLIGHT:
            return None
        for table, part in self._parts.items():
            try:
                refusal = part.order_refusal(vehicle, plan, now)
            except Exception as error:
                self._on_fault(error)
                refusal = f"[{table}] could not check it, and its fault is in the log; remove the table to fly without"
            if refusal is not None:
                return refusal
        return None

    def send_gates(self) -> SendGates:
        """Their gates. Raises what one raises that cannot give its gate: nothing may be sent without it."""
        gates = {table: gate for table, part in self._parts.items() if (gate := part.send_gate()) is not None}
        return SendGates(gates, self._on_fault)

    def info(self) -> dict[str, Any]:
        """Return what they show in daemon.info, by the names of their tables."""
        return {table: info for table, part in self._parts.items() if (info := part.info()) is not None}

    def announcements(self) -> dict[str, str]:
        """Return what the log says of them when the daemon is up, by the names of their tables."""
        return {table: text for table, part in self._parts.items() if (text := part.announcement())}

    def bytes_per_s(self, channel_id: int) -> float:
        """The bytes that they send on a channel. One that fails counts as none, which is reported."""
        sent = 0.0
        for part in self._parts.values():
            try:
                sent += part.bytes_per_s(channel_id)
            except Exception as error:
                self._on_fault(error)
        return sent

    def runs(self) -> Iterator[tuple[str, Coroutine[Any, Any, None]]]:
        """The work of each, by the name of its table."""
        for table, part in self._parts.items():
            yield table, repeated(part.run, self._on_fault)

    async def serve(self, new_session: NewSession) -> None:
        """Let all accept clients in ways of their own, until it is cancelled."""
        async with asyncio.TaskGroup() as group:
            for table, part in self._parts.items():
                serving = repeated(functools.partial(part.serve, new_session), self._on_fault)
                group.create_task(serving, name=f"clients of {table}")

    def woke(self, why: str) -> None:
        """Pass a sleep or a standstill on to all."""
        for part in self._parts.values():
            try:
                part.woke(why)
            except Exception as error:
                self._on_fault(error)

    def close(self) -> None:
        """Close all extensions; no further one is made."""
        self._closed = True
        for part in self._parts.values():
            self._close(part)

    def _close(self, part: Extension[Any]) -> None:
        try:
            part.close()
        except Exception as error:
            self._on_fault(error)

    async def ended(self) -> None:
        """Wait for the end of all, as long as the slowest takes."""

        async def ended(part: Extension[Any]) -> None:
            try:
                await part.ended()
            except Exception as error:
                self._on_fault(error)

        await asyncio.gather(*map(ended, self._parts.values()))


async def repeated(work: Callable[[], Awaitable[None]], on_fault: Callable[[Exception], None]) -> None:
    """Do this work to its end; after a fault of ours, which goes to ``on_fault``, again `AGAIN_S` later."""
    while True:
        try:
            return await work()
        except Exception as error:
            on_fault(error)
        await asyncio.sleep(AGAIN_S)
