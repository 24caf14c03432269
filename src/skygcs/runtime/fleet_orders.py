"""Orders to one, some or all vehicles of the fleet: which of them refuse or wait, what is sent as one frame, and the
outcomes by name."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Collection, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from skygcs.core.geo import Origin, world_from_enu
from skygcs.core.monitor.mission_ways import MissionRun
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.protocols.command import CommandSpec, Outcome
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle import mission_orders, orders
from skygcs.core.vehicle.autopilot import copter_mode
from skygcs.core.vehicle.formation import moved, offsets_en_m, too_close
from skygcs.core.vehicle.gate import HARMLESS_COMMANDS
from skygcs.core.vehicle.order_ledger import ClientIdentity
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.orders import is_place
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime import home_orders
from skygcs.runtime.command_client import BroadcastCommand
from skygcs.runtime.components import ComponentActor
from skygcs.runtime.return_members import read_return_height
from skygcs.runtime.returns import Returns, Waiting
from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.runtime.task_set import ASKED_NOW, ORDER_SERIAL, Asked, TaskSet, ask
from skygcs.runtime.vehicle_actor import SHUTDOWN, VehicleActor
from skygcs.runtime.vehicle_services import VehicleServices
from skygcs.runtime.vehicle_ways import Destination

Order = Callable[..., Coroutine[Any, Any, Any]]
"""An order is the method of VehicleActor that carries it out, `VehicleActor.arm`, or a function of
`runtime.home_orders` or of an extension. It returns an Outcome, or what the ``shaped`` of `command_all` makes
of one."""

Own = dict[VehicleActor, dict[str, Any]]
"""Arguments that a vehicle gets of its own."""

Each = Callable[[Sequence[VehicleActor]], Coroutine[Any, Any, tuple[Own, dict[VehicleActor, str]]]]
"""Decides the arguments of each vehicle, and why some do not get the order."""

COMPONENT_ORDERS: Mapping[Order, Order] = {
    VehicleActor.command: ComponentActor.command,
    VehicleActor.request_message: ComponentActor.request_message,
    VehicleActor.set_message_interval: ComponentActor.set_message_interval,
    VehicleActor.request_stream: ComponentActor.request_stream,
}
"""Orders that components other than autopilots take, too, and their methods."""

BROADCAST: Mapping[Order, Callable[[Vehicle, float], Plan]] = {
    VehicleActor.land: orders.land,
    VehicleActor.rtl: orders.rtl,
}
"""Orders for all vehicles that may be sent as one frame, with the functions that plan them. A broadcast also reaches
vehicles that were never heard here and must be safe for them. A disarming would drop a flying vehicle, and a mode has
different numbers on different vehicle types."""

CARRIED_ON = frozenset[Order](
    {VehicleActor.land, VehicleActor.rtl, VehicleActor.hold, VehicleActor.stop, VehicleActor.disarm}
)
"""Orders that end a flight are carried on to their outcome, even if the client that gave them disconnects meanwhile."""

MODE_ORDERS: Mapping[str, Order] = {
    "AUTO.LAND": VehicleActor.land,
    "AUTO.RTL": VehicleActor.rtl,
    "LAND": VehicleActor.land,
    "RTL": VehicleActor.rtl,
}
"""Modes of a copter that are what an order does: ordering the mode in flight is giving that order, with all that the
fleet does for it. ``force`` sets the mode alone."""

UNKNOWN_WAY = f"so it is not known who comes near whom; {orders.FORCE_HINT}"

OTHERS_READ_S = 5.0
"""How long missions that begin wait for those that fly and may have changed: then these are compared as they were last
known, and go on being read for the next start."""

MAX_KEPT = 64
"""Kept orders in progress at one time; further ones end when their client disconnects. Each lasts seconds."""


class Reports(Protocol):
    """Receiver that gets the outcomes of an order as they come. Must not raise."""

    def begun(self, vehicles: Iterable[str], /) -> None:
        """The order goes to these vehicles, by name."""
        ...

    def ended(self, vehicle: str, outcome: Any, /) -> None:
        """The order has ended for one of them, with what the order returns for it."""
        ...


class Unreported:
    """`Reports` to nothing."""

    def begun(self, vehicles: Iterable[str], /) -> None:
        return

    def ended(self, vehicle: str, outcome: Any, /) -> None:
        return


Actor = VehicleActor | ComponentActor
"""A vehicle or component, which takes orders."""


class Targets(Protocol):
    """The part of `runtime.fleet.Fleet` that is used here."""

    vehicles: dict[int, VehicleActor]
    refused_vehicles: int

    @property
    def origin(self) -> Origin | None: ...
    def resolve(self, expression: str | int | Sequence[str | int]) -> list[VehicleActor]: ...
    def resolve_any(self, expression: str | int | Sequence[str | int]) -> list[Actor]: ...


@dataclass(slots=True, eq=False)
class Given:
    """One call of `command_all`. ``outcomes``: of those for which it has ended."""

    order: Order
    serial: int
    reports: Reports
    by_person: bool
    shaped: Callable[[Outcome], Any]
    each: Each | None
    moves: bool
    outcomes: dict[str, Any] = field(default_factory=dict)
    ended_by: str = "the client that gave it is gone"
    """Why it ends, if it is cancelled."""

    def ended(self, vehicle: str, outcome: Any) -> None:
        self.outcomes[vehicle] = outcome
        self.reports.ended(vehicle, outcome)

    def cancelled(self) -> Outcome:
        """The outcome for one for which it had not ended when it was cancelled."""
        return Outcome(False, "cancelled", f"cancelled: {self.ended_by}")

    def all_outcomes(self, actors: Sequence[Actor]) -> dict[str, Any]:
        """The outcomes by name; of a vehicle for which the order had not ended, that it was cancelled."""
        return {actor.name: self.outcomes.get(actor.name, self.cancelled()) for actor in actors}


@dataclass(frozen=True, slots=True)
class Decided:
    """An order to several as it is given: who does not get it, and why; each vehicle's own arguments, where they are
    sent, and how those return that are one of several."""

    refusals: Mapping[Actor, str]
    own_arguments: Mapping[VehicleActor, Mapping[str, Any]]
    sent: Mapping[VehicleActor, Destination]
    returning: Mapping[VehicleActor, Waiting]


class FleetOrders:
    """`command_all` for each order. ``ends_only``: set when the daemon ends; only the orders of `CARRIED_ON` are taken
    then. Call `close` at the end."""

    def __init__(
        self,
        targets: Targets,
        services: VehicleServices,
        monitor: SeparationMonitor,
        returns: Returns,
    ) -> None:
        self.ends_only = False
        self._targets = targets
        self._links, self._monitor, self._returning = services.links, monitor, returns
        self.on_ending: list[Callable[[Collection[object], str], None]] = []
        """Called with the vehicles and the name of each order that ends a flight, before it is given."""
        self._dialect, self._send = services.dialect, services.send
        self._loop, self._on_event = services.loop, services.on_event
        self._kept = TaskSet(services.loop, services.on_event)
        self._begun: dict[Given, asyncio.Task[Any]] = {}
        """Those in ``_kept`` that have begun."""
        self._generation = 0
        """Number of calls of `close`."""
        self._closed_by = SHUTDOWN

    def close(self, why: str = SHUTDOWN) -> None:
        """End the orders that go on without their client; each is answered, and so reported."""
        self._generation += 1
        self._closed_by = why
        for given, task in self._begun.items():
            given.ended_by = why
            task.cancel()

    async def command_all(
        self,
        expression: str | int | Sequence[str | int],
        order: Order,
        /,
        *args: Any,
        reports: Reports | None = None,
        by_person: bool = True,
        shaped: Callable[[Outcome], Any] = lambda outcome: outcome,
        each: Each | None = None,
        moves: bool = True,
        **arguments: Any,
    ) -> dict[str, Outcome]:
        """Give one order (`VehicleActor.arm`) to every target vehicle at once; returns the outcomes by name.

        Raises TargetError before anything is sent. An order to all vehicles that fits in one frame is broadcast; each
        vehicle's answer is still awaited, and a vehicle that does not answer gets its own frame. When the caller is
        cancelled, the orders of `CARRIED_ON` go on, all others end; `close` ends those with an answer. Raises
        RefusedError for a stop, or a disarming of a duplicate system id, without the confirmation it needs
        (``confirm``, see `core.vehicle.orders`). ``reports`` gets each vehicle's outcome when it comes. ``by_person``:
        False for an order of the daemon's own, which a pilot who takes the vehicle meanwhile ends. ``shaped``: makes of
        an Outcome what the order returns, where the order itself is not reached. ``each``: decides what each vehicle
        gets. ``moves``: False for an order that moves no vehicle.
        """
        name = order.__name__
        if self.ends_only and order not in CARRIED_ON:
            raise RefusedError("skygcs is shutting down: it takes no further orders but land, rtl, hold, stop, disarm")
        vehicles = [] if order in COMPONENT_ORDERS else self._targets.resolve(expression)
        actors: list[Actor] = [*vehicles] or self._targets.resolve_any(expression)
        if order is VehicleActor.set_mode and (same := self._order_of_mode(vehicles, **arguments)) is not None:
            order, name, arguments = same, same.__name__, {}
        if order in (VehicleActor.stop, VehicleActor.disarm):
            action = arguments["action"] if order is VehicleActor.stop else "disarm"
            twice = {actor.name: actor.vehicle.duplicate_where for actor in vehicles}
            orders.require_confirmed(action, twice, arguments.pop("confirm", None))
        if order in CARRIED_ON:
            for taken in self.on_ending:
                taken(actors, name)
        # the serial is made here, as what is carried on begins a turn of the loop later
        given = Given(order, ask(), reports or Unreported(), by_person, shaped, each, moves)
        if order not in CARRIED_ON or len(self._kept) >= MAX_KEPT:
            return await self._give(actors, given, args, arguments)
        work = self._carry_on(actors, given, args, arguments, self._generation)
        return await asyncio.shield(self._kept.start(work, f"{name} {', '.join(a.name for a in actors)}"[:100]))

    def _order_of_mode(self, vehicles: Sequence[VehicleActor], *, name: str = "", force: bool = False) -> Order | None:
        """The order that this mode is, if all of these are copters that have it, of which one flies."""
        now = self._loop.time()
        if force or not any(is_flying(actor.vehicle, now) for actor in vehicles):
            return None
        same = {MODE_ORDERS.get(copter_mode(actor.vehicle, name) or "") for actor in vehicles}
        return same.pop() if len(same) == 1 else None

    async def _carry_on(
        self,
        actors: list[Actor],
        given: Given,
        args: tuple[Any, ...],
        arguments: dict[str, Any],
        generation: int,
    ) -> dict[str, Outcome]:
        """`_give` without its client, as a task of its own. The client gets an answer, whatever ends the order."""
        if generation != self._generation:
            given.ended_by = self._closed_by
            self._report_cancelled(actors, given)
            return given.all_outcomes(actors)
        task = asyncio.current_task()
        assert task is not None
        self._begun[given] = task
        try:
            return await self._give(actors, given, args, arguments)
        except asyncio.CancelledError:
            return given.all_outcomes(actors)
        finally:
            del self._begun[given]

    def _report_cancelled(self, actors: Sequence[Actor], given: Given) -> None:
        """Report an order that ended before it was sent to any vehicle."""
        for vehicle in (actor for actor in actors if isinstance(actor, VehicleActor)):
            outcome = vehicle.outcomes.finish(given.order.__name__, given.cancelled())
            given.ended(vehicle.name, given.shaped(outcome))

    async def push_origin(
        self,
        expression: str | int | Sequence[str | int],
        *,
        home: bool = False,
        force: bool = False,
        reports: Reports | None = None,
    ) -> dict[str, Outcome]:
        """Send the origin to each vehicle; see `home_orders.push_origin`. Raises RefusedError, TargetError."""
        if self._targets.origin is None:
            raise RefusedError("there is no origin to send; set one first")
        order = home_orders.push_origin
        return await self.command_all(expression, order, self._targets.origin, reports=reports, home=home, force=force)

    def setpoint(
        self, expression: str | int | Sequence[str | int], client: ClientIdentity, /, **setpoint: Any
    ) -> dict[str, Outcome]:
        """One setpoint of a client's stream to each of the vehicles; see `VehicleActor.setpoint`. Each follows it or
        refuses it for itself. Raises TargetError.
        """
        actors = self._targets.resolve(expression)
        if len(actors) > 1 and setpoint.get("pos_enu_m") is not None:
            one_place = "several vehicles were sent to one position; send each its own setpoint"
            return {actor.name: Outcome(False, "refused", f"refused: {one_place}") for actor in actors}
        return {actor.name: self._setpoint(actor, client, setpoint) for actor in actors}

    def _setpoint(self, actor: VehicleActor, client: ClientIdentity, setpoint: dict[str, Any]) -> Outcome:
        why = self._links.authority_refusal(actor.sysid)
        return actor.setpoint(client, **setpoint) if why is None else Outcome.refused(why)

    async def _decide(self, actors: Sequence[Actor], given: Given, arguments: dict[str, Any]) -> Decided:
        """Decide what each vehicle is to do; takes out of ``arguments`` what is only for that. Nothing is sent yet."""
        order, vehicles = given.order, [actor for actor in actors if isinstance(actor, VehicleActor)]
        asked = {actor: actor.runner.precedence.asked(given.serial) for actor in vehicles}
        # why it is not sent: a take-off that did not end, authority
        refusals = dict[Actor, str]()
        if order is VehicleActor.goto:
            refusals.update((await self._takeoffs_ended(vehicles, arguments, asked)).items())
        for actor in actors if order is not VehicleActor.stop else ():
            if (why := self._links.authority_refusal(actor.sysid)) is not None:
                refusals[actor] = why
        # what each vehicle is to do: places of its own, or why it stays
        going = [actor for actor in vehicles if order is VehicleActor.goto and actor not in refusals]
        own_arguments, staying, sent = Own(), dict[VehicleActor, str](), dict[VehicleActor, Destination]()
        if going:
            own_arguments, staying, sent = self._going(going, arguments)
        elif given.each is not None:
            own_arguments, staying = await given.each(vehicles)
        refusals.update(staying.items())
        # the order of returns, other missions, a newer order meanwhile
        returning = await self._returns(given, vehicles, refusals, arguments) if order is VehicleActor.rtl else {}
        free = [actor for actor in vehicles if actor not in refusals]
        refusals.update((await self._mission_refusals(free, order, arguments)).items())
        refusals.update(self._late(given, {actor: asked[actor] for actor in free}).items())
        for actor in vehicles if order is VehicleActor.takeoff else ():
            height_m = arguments.get("height_m")
            height_m = actor.config.takeoff_height_m if height_m is None else height_m
            if actor not in refusals and (up := self._monitor.ways.sent_up(actor, height_m)) is not None:
                sent[actor] = up
        return Decided(refusals, own_arguments, sent, returning)

    async def _give(
        self, actors: list[Actor], given: Given, args: tuple[Any, ...], arguments: dict[str, Any]
    ) -> dict[str, Outcome]:
        """Decide what each vehicle is to do, give the order, and refuse it to those that do not get it."""
        given.reports.begun([actor.name for actor in actors])
        try:
            decided = await self._decide(actors, given, arguments)
        except asyncio.CancelledError:
            self._report_cancelled(actors, given)
            raise
        order, refusals = given.order, decided.refusals
        vehicles = [actor for actor in actors if isinstance(actor, VehicleActor)]
        waits = refusals or any(one.holds_first for one in decided.returning.values())
        broadcast: BroadcastCommand | None = None
        names = {actor: actor.name for actor in actors}
        tasks: dict[Actor, asyncio.Task[Outcome]] = {}
        try:
            for actor, reason in refusals.items():
                given.ended(actor.name, given.shaped(actor.refuse(order.__name__, reason)))
                self._arrives(decided, actor)
            # one frame to all where the order may be broadcast, then one task per vehicle for its answer
            broadcast = None if waits else self._broadcast_command(vehicles, order)
            async with asyncio.TaskGroup() as group:
                for actor in actors:
                    if actor in refusals:
                        continue
                    own = decided.own_arguments.get(actor, {}) if isinstance(actor, VehicleActor) else {}
                    returns = decided.returning.get(actor) if isinstance(actor, VehicleActor) else None
                    work = self._guarded(actor, given, returns, args, {**arguments, **own})
                    tasks[actor] = group.create_task(work, name=f"{order.__name__} {actor.name}")
                    tasks[actor].add_done_callback(functools.partial(self._arrives, decided, actor))
                if broadcast is not None:
                    await asyncio.sleep(0)  # every task waits for its answer now: none can come too early
                    # if one was refused, or waits for the end of a newer order, each gets its own frame
                    behind = any(vehicle.runner.ledger.is_behind(given.serial) for vehicle in vehicles)
                    if not behind and not any(task.done() for task in tasks.values()):
                        self._broadcast(broadcast)
        finally:
            for actor in decided.sent.keys() - tasks.keys() - refusals.keys():
                self._arrives(decided, actor)  # a fault kept the order from it
            for vehicle in vehicles:
                vehicle.commands.end_broadcast(broadcast)
            self._returning.run(decided.returning.values())
        return {name: tasks[a].result() if a in tasks else given.outcomes[name] for a, name in names.items()}

    def _arrives(self, decided: Decided, actor: Actor, task: asyncio.Task[Outcome] | None = None) -> None:
        """The order to one vehicle has ended, whatever the others of it still do. ``task``: None: it was not sent."""
        if isinstance(actor, VehicleActor) and (sent := decided.sent.get(actor)) is not None:
            outcome = _outcome(task)
            self._monitor.ways.arriving(actor, sent, ok=outcome.ok, number=outcome.order_number)

    async def _guarded(
        self,
        actor: Actor,
        given: Given,
        returns: Waiting | None,
        args: tuple[Any, ...],
        arguments: dict[str, Any],
    ) -> Outcome:
        """Carry out the order to one vehicle and report its outcome, also of an internal fault, which ends no other.
        ``returns``: it is one of several that return. To be run as a task of its own; a newer order may have been sent
        between its making and its start."""
        order = given.order
        ORDER_SERIAL.set(given.serial)
        ASKED_NOW.set(given.by_person)
        late = self._late(given, {actor: Asked(given.serial)}) if isinstance(actor, VehicleActor) else {}
        method = order if isinstance(actor, VehicleActor) else COMPONENT_ORDERS[order]
        outcome: Outcome
        try:
            if late:
                outcome = given.shaped(actor.refuse(order.__name__, *late.values()))
            elif returns is not None:
                outcome = await self._returning.carry_out(returns)
            else:
                outcome = await method(actor, *args, **arguments)
        except Exception as error:
            why = f"failed inside skygcs: {error!r}"
            self._on_event(Event("fault", actor.name, actor.sysid, f"{order.__name__} {why}", {}))
            outcome = given.shaped(Outcome(False, "failed", why))
        given.ended(actor.name, outcome)
        return outcome

    async def _mission_refusals(
        self, actors: list[VehicleActor], order: Order, arguments: Mapping[str, Any]
    ) -> dict[VehicleActor, str]:
        """Why missions are not begun or gone on with, by whatever order, unless ``force``: they lead too near each
        other, or to others that fly."""
        now, starting = self._loop.time(), dict[VehicleActor, int]()
        for actor in actors:
            first = mission_orders.flown_from(actor.vehicle, now, order.__name__, arguments)
            if first is not None and actor.vehicle.connected and not actor.vehicle.replayed:
                starting[actor] = first
        others = [a for a in self._targets.vehicles.values() if a not in starting and is_flying(a.vehicle, now)]
        alone = {a: MissionRun(a.missions.items, first) for a, first in starting.items() if a.missions.items}
        self._monitor.ways.begin_missions(alone)
        if arguments.get("force") or self._monitor.mode == "off" or not starting:
            return {}
        if len(starting) + len(others) < 2:  # one alone may only land on one that stands: nothing is read for that
            return await self._monitor.mission_refusals(alone)
        heard = [a for a in others if a.vehicle.connected and not a.vehicle.replayed]
        flying = [a for a in heard if a.vehicle.mode in mission_orders.MISSION_MODES]
        reading = [actor.missions.known_items() for actor in starting]
        reading += [actor.missions.known_items(within_s=OTHERS_READ_S) for actor in flying]
        read = await asyncio.gather(*reading)
        if blind := [actor.name for actor in flying if actor.missions.items is None]:
            text = f"the mission that {blind[0]} flies could not be read: {UNKNOWN_WAY}"
            return dict.fromkeys(starting, text)
        known = await self.with_return_heights(
            {a: MissionRun(items, starting[a]) for a, items in zip(starting, read, strict=False) if items is not None}
        )
        text = f"its mission could not be read: {UNKNOWN_WAY}"
        unread = {actor: text for actor in starting if actor not in known}
        return {**unread, **await self._monitor.mission_refusals(known)}

    async def with_return_heights(self, runs: Mapping[VehicleActor, MissionRun]) -> dict[VehicleActor, MissionRun]:
        """These runs with the heights of their returns, which are read; without an answer any height is possible."""
        if self._monitor.mode == "off":
            return dict(runs)

        async def one(actor: VehicleActor, run: MissionRun) -> MissionRun:
            flies = bool(actor.vehicle.abilities.return_heights)
            known = run.returns and flies and actor.vehicle.connected and not actor.vehicle.replayed
            return run._replace(height=await read_return_height(actor)) if known else run

        found = await asyncio.gather(*(one(actor, run) for actor, run in runs.items()))
        return dict(zip(runs, found, strict=True))

    async def _returns(
        self, given: Given, actors: list[VehicleActor], refusals: Mapping[Actor, str], arguments: dict[str, Any]
    ) -> dict[VehicleActor, Waiting]:
        """Before the order to return: who has to wait, and for whom."""
        at_end = arguments.pop("at_end", "hold")
        returning = [actor for actor in actors if actor not in refusals]
        return await self._returning.begin(returning, given.serial, at_end=at_end)

    async def _takeoffs_ended(
        self, actors: list[VehicleActor], arguments: Mapping[str, Any], asked: dict[VehicleActor, Asked]
    ) -> dict[VehicleActor, str]:
        """Before a goto: wait until no take-off of these vehicles is under way, unless ``force``, so that they leave
        together from where they will be; returns why some do not go. Control that begins after a take-off is no newer
        order: the mode in ``asked`` is renewed when the take-off of that vehicle has ended."""

        async def ended(actor: VehicleActor) -> str | None:
            given_in = actor.vehicle.origin_generation
            why = await actor.takeoffs.ended()
            asked[actor] = actor.runner.precedence.asked(asked[actor].serial)
            if why is None and "enu_m" in arguments and actor.vehicle.origin_generation != given_in:
                return "the fleet's frame was changed while it waited for the end of its take-off: order it anew"
            return why

        waiting = {actor: why for actor in actors if (why := actor.takeoffs.under_way()) is not None}
        if arguments.get("force") or not waiting:
            return {}
        for actor, why in waiting.items():
            text, data = f"goto: waits until its take-off has ended: {why}", {"order": "goto", "result": "in_progress"}
            self._on_event(Event("command", actor.name, actor.sysid, text, data))
        ends = await asyncio.gather(*(ended(actor) for actor in waiting))
        return _overtaken(asked) | {a: why for a, why in zip(waiting, ends, strict=True) if why is not None}

    def _late(self, given: Given, asked: Mapping[VehicleActor, Asked]) -> dict[VehicleActor, str]:
        """Those that were ordered something else while this order waited, and why it does not go to them. What ends a
        flight goes out although the mode has changed: a failsafe of the vehicle's own may have changed it. A newer
        order does not make void what moves nothing, nor the stop, which has the last word."""
        if not given.moves or given.order is VehicleActor.stop:
            return {}
        return _overtaken(asked, by_mode=given.order not in CARRIED_ON)

    def _going(
        self, actors: list[VehicleActor], arguments: dict[str, Any]
    ) -> tuple[dict[VehicleActor, dict[str, Any]], dict[VehicleActor, str], dict[VehicleActor, Destination]]:
        """Split a goto: the arguments of each vehicle's own, why some stay, and where those go that do.

        One that would come too close to a vehicle that is not sent with it stays, unless ``force``, and is in the way
        of the others then. ``together``: vehicles that the caller keeps apart from these itself.
        """
        together = arguments.pop("together", None)
        apart = frozenset(a.vehicle.key for a in (() if together is None else self._targets.resolve(together)))
        own_arguments, staying = self._formation(actors, arguments)
        places: dict[VehicleActor, tuple[float, float, float]] = {}
        for actor in (actor for actor in actors if actor not in staying):
            where = {**arguments, **own_arguments.get(actor, {})}
            try:
                to = actor.destination(**where)
            except RefusedError:
                continue  # the order itself says why
            places[actor] = (to.lat_deg, to.lon_deg, to.alt_amsl_m)
        if not (arguments.get("force") or apart):
            unlike = self._monitor.unlike_refusals([actor.vehicle for actor in places])
            staying |= {actor: unlike[actor.vehicle.key] for actor in places if actor.vehicle.key in unlike}
            places = {actor: place for actor, place in places.items() if actor not in staying}
        # each that stays is one more in the way of those that go
        stayed: frozenset[int] | None = None
        while not arguments.get("force") and (stayed is None or stayed):
            keys = apart | {actor.vehicle.key for actor in places}
            refusals = {a: self._monitor.goto_refusal(a.vehicle, to, keys, only=stayed) for a, to in places.items()}
            stays = {actor: why for actor, why in refusals.items() if why is not None}
            staying |= stays
            places = {actor: place for actor, place in places.items() if actor not in stays}
            stayed = frozenset(actor.vehicle.key for actor in stays)
        sent = {actor: self._monitor.ways.sent_to(actor, place) for actor, place in places.items()}
        return own_arguments, staying, sent

    def _formation(
        self, actors: list[VehicleActor], arguments: dict[str, Any]
    ) -> tuple[dict[VehicleActor, dict[str, Any]], dict[VehicleActor, str]]:
        """The targets of several vehicles that are sent to one position, and the refusals of those that cannot fly.

        They keep their positions relative to each other; their mean goes to the given position. Only vehicles that can
        fly now count for the mean: an old position would shift the others. ``same_place`` sends all to the same point.
        """
        if arguments.pop("same_place", False) or len(actors) < 2:
            return {}, {}
        now = self._loop.time()
        here: dict[VehicleActor, tuple[float, float, float]] = {}
        ends: dict[VehicleActor, tuple[float, float, float]] = {}
        staying: dict[VehicleActor, str] = {}
        height_m, enu_m = arguments.get("height_m"), arguments.get("enu_m")
        for actor in actors:
            try:
                here[actor], home_amsl_m = orders.require_going(actor.vehicle, now)
            except RefusedError as error:
                staying[actor] = str(error)
                continue
            own_amsl_m = here[actor][2] if height_m is None else home_amsl_m + height_m
            # all move by the same horizontal offset and keep their distances; with enu_m all get one height
            ends[actor] = (*here[actor][:2], own_amsl_m if enu_m is None else 0.0)
        close = None if arguments.get("force") else too_close(ends)
        if close is not None:
            text = f"{close[0].name} and {close[1].name} would end {close[2]:.1f} m apart at about the same height"
            text += "; move them apart first, or insist with same_place (--same-place) or force (--force)"
            return {}, staying | dict.fromkeys(ends, text)
        places: dict[VehicleActor, dict[str, Any]] = {}
        for actor, (east_m, north_m) in offsets_en_m({a: place[:2] for a, place in here.items()}).items():
            lat_deg, lon_deg = arguments.get("lat_deg"), arguments.get("lon_deg")
            if enu_m is not None and len(enu_m) == 3 and self._targets.origin is not None:
                x_m, y_m, _ = world_from_enu((east_m, north_m, 0.0), self._targets.origin)
                places[actor] = {"enu_m": [enu_m[0] + x_m, enu_m[1] + y_m, enu_m[2]]}
            elif lat_deg is not None and lon_deg is not None and is_place(lat_deg, lon_deg):
                # an impossible position stays as it is: every vehicle refuses it with the reason
                lat, lon = moved(lat_deg, lon_deg, (east_m, north_m))
                places[actor] = {"lat_deg": lat, "lon_deg": lon}
        return places, staying

    def _broadcast_command(self, actors: list[VehicleActor], order: Order) -> BroadcastCommand | None:
        """A broadcast if all vehicles are targets, none refuses, all get the same frame, and no other vehicle hears it.

        ArduPilot acts on it. PX4 does not: it accepts commands for its own system id only (MavlinkReceiver,
        evaluate_target_ok), and gets its own frame at once.
        """
        hearers = [a for a in actors if a.vehicle.family == "ardupilot"]
        if order not in BROADCAST or len(hearers) < 2 or not self._links.may_broadcast():
            return None
        if set(actors) != set(self._targets.vehicles.values()) or self._targets.refused_vehicles:
            return None  # an autopilot was heard that is not a target, or one was dropped since they were named
        specs: set[CommandSpec] = set()
        for actor in actors:
            plan = actor.plan(BROADCAST[order])
            if plan is None or len(plan.steps) != 1 or plan.steps[0].command is None:
                return None
            specs.add(plan.steps[0].command)
        if len(specs) != 1 or not HARMLESS_COMMANDS.issuperset(spec.command for spec in specs):
            return None  # a mode has another meaning to the next vehicle
        broadcast = BroadcastCommand(specs.pop())
        for actor in hearers:
            actor.commands.expect_broadcast(broadcast)
        return broadcast

    def _broadcast(self, broadcast: BroadcastCommand) -> None:
        broadcast.sent = True
        info = self._dialect.by_name[broadcast.spec.message]
        self._send(info, broadcast.spec.values(0, 0, 0), 0, 0, Priority.COMMAND)


def _overtaken(asked: Mapping[VehicleActor, Asked], *, by_mode: bool = True) -> dict[VehicleActor, str]:
    """Vehicles for which the order comes too late, and why; see `OrderPrecedence.overtaken`."""
    late = {actor: actor.runner.precedence.overtaken(at, by_mode=by_mode) for actor, at in asked.items()}
    return {actor: why for actor, why in late.items() if why is not None}


def _outcome(task: asyncio.Task[Outcome] | None) -> Outcome:
    """The outcome of an order; of one that has none, that it was cancelled."""
    if task is None or not task.done() or task.cancelled() or task.exception() is not None:
        return Outcome(False, "cancelled", "cancelled")
    return task.result()
