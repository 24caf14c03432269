"""The fleet: adds vehicles by their heartbeats, names them by the fleet file, and gives orders to one, some or all."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from skygcs.config.models import FleetConfig, VehicleConfig
from skygcs.core.geo import Origin, world_from_enu
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.monitor.mission_ways import MissionRun
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.plan.flight_record import FlightRecord
from skygcs.core.protocols.command import CommandSpec, Outcome
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.routing.state_source import KNOWN_BY, Known
from skygcs.core.vehicle import mission_orders, orders, stop, targets
from skygcs.core.vehicle.decoder import Decoder
from skygcs.core.vehicle.flight_lock import Forgetting, LinkLoss
from skygcs.core.vehicle.flight_note import KEPT_MESSAGES, FlightNote, lost_place
from skygcs.core.vehicle.formation import moved, offsets_en_m, too_close
from skygcs.core.vehicle.gate import HARMLESS_COMMANDS
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.orders import is_place
from skygcs.core.vehicle.statustext import StatusText
from skygcs.core.vehicle.supply import MAYBE_FLYING_S, may_fly
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.disk_writer import DiskWriter
from skygcs.errors import RefusedError, TargetError
from skygcs.events import Event
from skygcs.links.base import Channel, StateUpdate
from skygcs.runtime.command_client import BroadcastCommand, SendFn
from skygcs.runtime.components import ComponentActor, Components
from skygcs.runtime.fence_orders import FenceOutcome
from skygcs.runtime.flight_journal import FlightJournal
from skygcs.runtime.flight_locks import FlightLocks
from skygcs.runtime.param_cache import ParamCache
from skygcs.runtime.plans import Plans
from skygcs.runtime.preflight_run import Unheard, examine_all
from skygcs.runtime.returns import Returns
from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.runtime.sleep_watch import SleepWatch
from skygcs.runtime.task_set import TaskSet, fault
from skygcs.runtime.trajectories import Trajectories
from skygcs.runtime.undo_journal import UndoJournal
from skygcs.runtime.undo_orders import UndoOrders
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import (
    NewFlight,
    OnEvent,
    OrderRefusal,
    VehicleLinks,
    VehicleServices,
    WideLinks,
    no_order_refusal,
)
from skygcs.runtime.world_frame import World

MAX_VEHICLES_OF_LINK = 250
"""System ids 1..250 by convention; more on one link can only be noise or a forged stream of heartbeats ..."""

MAX_VEHICLES = 300
"""... which leaves room for vehicles of other links. One that the fleet file names always has its place."""

Order = Callable[..., Coroutine[Any, Any, Any]]
"""An order is the method of VehicleActor that carries it out: `VehicleActor.arm`. It returns an Outcome; orders of the
fence return a FenceOutcome, those of the onboard logs a LogsOutcome."""

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

MAX_KEPT = 64
"""Kept orders in progress at one time; further ones end when their client disconnects. Each lasts seconds."""


UNKNOWN_S = 60.0
"""After a start with a journal that cannot be read, a vehicle that is heard within this time may have been flown by the
daemon before; later ones have flown without us for as long."""

OWN_IDS_AGAIN_S = 60.0
"""Between two reports of an autopilot that has our own ids."""


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


class Expected(NamedTuple):
    """The vehicle ``key`` is expected under another system id, on this link and until then. ``when_lost``: only once it
    is no longer heard under the old one."""

    key: int
    link: str
    until: float
    when_lost: bool = False


Actor = VehicleActor | ComponentActor
"""A vehicle or component, which takes orders."""


class Fleet:
    """`on_frame` for every good frame from a link, `tick` at 1 to 10 Hz. ``vehicles`` is keyed sysid << 8 | compid."""

    def __init__(
        self,
        config: FleetConfig,
        dialect: Dialect,
        send: SendFn,
        loop: asyncio.AbstractEventLoop,
        on_event: OnEvent,
        *,
        links: VehicleLinks | None = None,
        param_cache: ParamCache | None = None,
        probes: bool = False,
    ) -> None:
        """``send``: `Hub.send`. ``links``: `LinkView`; None: no link is narrow. ``param_cache``: the store of
        parameters; None: no store. ``probes``: True if the uplinks are probed."""
        self.config = config
        self.vehicles: dict[int, VehicleActor] = {}
        self.refused_vehicles = 0
        self.flights_elsewhere: dict[str, NewFlight] = {}  # the daemon adds those of its extensions
        self.on_woke: list[Callable[[float], None]] = []
        """Called with the seconds after a sleep of the computer."""
        self.order_refusal: OrderRefusal = no_order_refusal  # the daemon sets that of its extensions
        self._dialect, self._send, self._loop, self._on_event = dialect, send, loop, on_event
        self._links, self._kept = links or WideLinks(), TaskSet(loop, on_event)
        self.locks = FlightLocks(self._links.links_to)  # of the flights under way
        self.world = World(_origin(config), self.vehicles, self.locks, on_event)
        self._of_system: dict[int, set[int]] = {}  # the keys of ``vehicles`` by system id
        self._ending = False
        own = config.daemon
        self._own_key = own.sysid << 8 | own.compid
        self._own_ids_at = -math.inf
        self.disk = DiskWriter(loop, on_event)
        self.journal = UndoJournal(own.log_dir / "undo")
        self.undo = UndoOrders(self.journal, self.vehicles, loop.time, self.disk, on_event)
        self.monitor = SeparationMonitor(config.monitor, self.vehicles, loop, on_event)
        self.returns = Returns(self.monitor.footprint, loop, on_event)
        param_cache = param_cache or ParamCache(None)
        param_cache.disk = self.disk
        self._services = self._new_services(param_cache, probes=probes)
        self.sleep = SleepWatch(self._woke)
        self.flights = FlightJournal(own.log_dir, self.disk, on_event)
        self._owed: dict[int, str] = {}
        """By key, who flew a vehicle that was dropped in the air, for when it is heard again."""
        self._unknown_until = -math.inf
        """Until when a vehicle that is heard first may have been flown by the daemon before."""
        self._recalled: dict[int, float] = {}
        """By key, until when a vehicle of the journal may be heard before it is reported as lost."""
        self._met_on: dict[int, str] = {}
        """By key, the link on which a vehicle was first heard."""
        self._duplicates: dict[int, str] = {}
        """By key, where two autopilots send with these ids; the vehicles read it, too (`Vehicle.duplicates`)."""
        self.trajectories = Trajectories(self.vehicles.values, loop, on_event, self.monitor, self.locks)
        self.plans = Plans(self, self.trajectories, self._links, loop, on_event)
        self._decoder = Decoder(dialect)
        self.components = Components(self._services, self._decoder, self._name_of_system, self.vehicles_of)
        """All components beside the autopilots of ``vehicles``."""
        self._configs = {c.sysid: c for c in config.vehicle_configs()}
        self._expected: dict[int, Expected] = {}
        """By the system id under which a vehicle will come back (`Renumbering`)."""

    def _new_services(self, param_cache: ParamCache, *, probes: bool) -> VehicleServices:
        own = self.config.daemon
        return VehicleServices(
            (own.sysid, own.compid),
            self._dialect,
            self._send,
            self._loop,
            self._on_event,
            self._links,
            self.flown_vehicles,
            param_cache,
            self.journal,
            self.disk,
            self.monitor,
            log_dir=own.log_dir,
            flights_elsewhere=self.flights_elsewhere,
            locks=self.locks,
            preflight_valid_s=60 * own.preflight_valid_minutes,
            probes=probes,
            order_refusal=lambda vehicle, plan, now: self.order_refusal(vehicle, plan, now),
            asleep=lambda: self.sleep.check(),
        )

    def on_frame(self, key: int, frame: Frame, channel_label: str, now: float) -> None:
        """Hot: one dict lookup for the frames of vehicles, one comparison for all others. Never raises."""
        actor = self.vehicles.get(key)
        if actor is not None:
            actor.on_frame(frame, channel_label, now)
        elif frame.msgid == HEARTBEAT and discovers(frame):
            self._discover(key, frame, channel_label, now)
        else:
            self.components.on_frame(key, frame, now)

    def state_update_only(self, key: int, frame: Frame, channel_label: str) -> StateUpdate | None:
        """The state update for frames like this one (heartbeats: with the same payload), until `forget_flows` of the
        links is called. None: each frame must be given to `on_frame`."""
        actor = self.vehicles.get(key)
        if actor is not None:
            return actor.state_update_only(frame, channel_label)
        return None if discovers(frame) else self.components.state_update(key, frame)

    def tick(self, now: float) -> None:
        """Call `tick` of every vehicle, even if one fails; the first exception is raised at the end."""
        fault: Exception | None = None
        self.sleep.check()
        for actor in list(self.vehicles.values()):
            try:
                actor.tick(now)
            except Exception as error:
                fault = fault or error
        self.components.tick(now)
        self.trajectories.tick(now)
        self.plans.tick(now)
        if self._recalled:
            self._report_recalled(now)
        self._note_flights(now)
        if fault is not None:
            raise fault

    def on_station_frame(self, frame: Frame, channel: Channel, now: float) -> None:
        """A message of another station, one of `STATION_MESSAGES`, to one of the vehicles."""
        system, component = frame.target()
        for key in self._of_system.get(system, ()) if system and channel.config.type != "replay" else ():
            if component in (0, key & 0xFF):
                self.vehicles[key].unattended.on_station(frame, now)

    async def wind_down(self, timeout_s: float) -> None:
        """The daemon ends: accept only orders that end a flight, cancel orders that undo themselves, and wait this long
        for the undo. Changes that are not undone stay in the journal."""
        self._ending = True
        tasks = {
            self._loop.create_task(actor.wind_down(), name=f"{actor.name} undo") for actor in self.vehicles.values()
        }
        tasks.add(self._loop.create_task(self.plans.wind_down(), name="the plan's undo"))
        if not tasks:
            return
        done, late = await asyncio.wait(tasks, timeout=timeout_s)
        for task in late:
            task.cancel()
        for task in done:
            if (text := fault(task)) is not None:
                self._on_event(Event("fault", None, None, text, {}))

    async def ended(self, timeout_s: float) -> None:
        """After `close`: wait until the changes that could not be undone have been noted."""
        tasks = {self._loop.create_task(actor.fence.ended()) for actor in self.vehicles.values()}
        if tasks:
            _, late = await asyncio.wait(tasks, timeout=timeout_s)
            for task in late:
                task.cancel()

    def close(self) -> None:
        """End all orders in flight as cancelled."""
        for actor in self.vehicles.values():
            actor.close()
        if self.config.daemon.keep_vehicles:
            self._note_flights(self._loop.time())  # what was held at the end is not held again at the next begin
        self.components.close()
        self.monitor.close()
        self.returns.close()
        self.plans.close()
        self._kept.close()

    def set_duplicate(self, key: int, where: str | None) -> None:
        """Note where two autopilots send as ``key`` (sysid << 8 | compid), known or not: most orders to it are refused.
        None: only one is left."""
        if where is None:
            self._duplicates.pop(key, None)
        elif key in self._duplicates or len(self._duplicates) < MAX_VEHICLES:
            self._duplicates[key] = where
        actor = self.vehicles.get(key)
        if actor is not None:
            actor.set_duplicate(where)

    def known(self, key: int) -> Known | None:
        """The last frames of a live vehicle, to compare with those of another channel; None without such a vehicle."""
        actor = self.vehicles.get(key)
        return None if actor is None or actor.vehicle.replayed else actor.vehicle.last_frames(KNOWN_BY)

    def may_fly(self, key: int) -> bool:
        """True if this is a vehicle that may be in the air now (`core.vehicle.supply`)."""
        actor = self.vehicles.get(key)
        return actor is not None and may_fly(actor.vehicle, self._loop.time())

    def replaced(self, key: int) -> None:
        """Another vehicle has replaced this one, or it has restarted and is heard on another channel."""
        actor = self.vehicles.get(key)
        if actor is not None:
            actor.restarted("another vehicle, or this one restarted, is heard over another channel", self._loop.time())

    def link_changed(self, key: int, channel_id: int) -> None:
        """This vehicle's state comes over another channel from now on, which also gets its orders."""
        actor = self.vehicles.get(key)
        if actor is not None:
            actor.link_changed(channel_id, self._loop.time())

    def source_changed(self, key: int) -> None:
        """``key`` is heard only in a recording from now on, or live after all (`VehicleLinks.is_replayed`). Its state
        is of another time and place: it is dropped, and its next heartbeat adds it anew."""
        self.components.forget(key)
        if key in self.vehicles:
            self._drop(key)

    def resolve(self, expression: str | int | Sequence[str | int]) -> list[VehicleActor]:
        """The vehicles of a target expression, by sysid. Raises TargetError naming the part and what exists."""
        return targets.select(expression, self.vehicles.values())

    def resolve_any(self, expression: str | int | Sequence[str | int]) -> list[Actor]:
        """`resolve` with components: "7/191" and "alpha/191" may also name components. Raises TargetError."""
        vehicles: list[Actor] = [*self.vehicles.values()]
        return targets.select_any(expression, vehicles, [*self.components.all()])

    def sources(self, expression: str | int | Sequence[str | int]) -> set[int]:
        """The sources (sysid << 8 | compid) of a target expression; a vehicle's name or system id gives component 0,
        the whole system. Raises TargetError."""
        named = [
            part for part in targets.parts_of(expression) if not targets.names_component(part, self.vehicles.values())
        ]
        keys = {actor.sysid << 8 | actor.compid for actor in self.resolve_any(expression)}
        whole = self.resolve(named) if named else []
        return keys | {actor.sysid << 8 for actor in whole if self._is_first(actor)}

    def latest(self, target: str | int, message: str | int) -> dict[str, Any] | None:
        """The last frame of a message: of a vehicle's autopilot, else the newest of its system's other components; or
        of the named component. None if none has come. Raises TargetError, RefusedError."""
        found = self.resolve_any(target)
        if len(found) != 1:
            names = ", ".join(actor.name for actor in found[:10])
            raise TargetError(f"{target} names {len(found)} vehicles ({names}); give one")
        (actor,) = found
        reading = actor.latest(message)
        if reading is not None or actor.sysid << 8 not in self.sources(target):
            return reading
        others = [r for c in self.components.of_system(actor.sysid) if (r := c.latest(message)) is not None]
        return min(others, key=lambda r: float(r["age_s"]), default=None)

    def names_of(self, sysid: int, compid: int) -> tuple[str | None, str]:
        """The vehicle of a source's system, or None, and the source's name: "alpha" for an autopilot, "alpha/191" for
        another component, "7/191" without a vehicle."""
        actor = self.vehicles.get(sysid << 8 | compid)
        if actor is not None:
            return actor.name, actor.name
        return self._name_of_system(sysid), self.components.name_of(sysid, compid)

    def components_status(self) -> list[dict[str, Any]]:
        """All components of all systems that were heard, except ours: as in a vehicle's state, with system id and
        vehicle."""
        now = self._loop.time()
        sysids = {key >> 8 for key in self.vehicles} | {actor.sysid for actor in self.components.all()}
        return [
            {"sysid": sysid, "vehicle": self._name_of_system(sysid), **component}
            for sysid in sorted(sysids)
            for component in self._system(sysid, now)
        ]

    def companion_of(self, actor: VehicleActor) -> dict[str, Any] | None:
        """The computer on a vehicle as it is heard by MAVLink (`VehicleState.companion`); None: it is not heard. An
        extension that knows more of it fills in the rest."""
        heard_at = self.components.onboard_computer_heard_at(actor.sysid)
        if heard_at is None:
            return None
        unknown = dict.fromkeys(("name", "link", "since_s", "error", "version"))
        return {**unknown, "age_s": round(self._loop.time() - heard_at, 2)}

    def forget(self, expression: str | int | Sequence[str | int], *, force: bool = False) -> dict[str, Outcome]:
        """Forget vehicles that are gone: "all" does not include them any more, and a new heartbeat adds them again.

        Refused without ``force`` for one that is connected, or was lost while armed and may still fly. Routes to it
        expire by themselves. Raises TargetError.
        """
        return {actor.name: self._forget(actor, force=force) for actor in self.resolve(expression)}

    def _forget(self, actor: VehicleActor, *, force: bool) -> Outcome:
        now = self._loop.time()
        silence_s = actor.vehicle.silence_s(now) or 0.0
        ago = f"{silence_s:.0f} s" if silence_s < 120 else f"{silence_s / 60:.0f} min"
        refusal = None
        if actor.vehicle.connected:
            refusal = f"it was heard {ago} ago; {orders.FORCE_HINT}: its next heartbeat adds it again"
        elif actor.vehicle.armed and silence_s < MAYBE_FLYING_S:
            refusal = f"it was lost armed {ago} ago and may still fly; {orders.FORCE_HINT}"
        if (locked := self.locks.refusal(Forgetting(actor.vehicle.key))) is not None:
            return actor.refuse("forget", locked)
        if refusal is not None and not force:
            return actor.refuse("forget", refusal)
        self._drop(actor.vehicle.key)
        if not self.vehicles_of(actor.sysid):
            self.components.forget_system(actor.sysid)
        text = f"{actor.name} (system {actor.sysid}) is forgotten, last heard {ago} ago"
        self._on_event(Event("vehicle_forgotten", actor.name, actor.sysid, text, {"compid": actor.compid}))
        return Outcome(True, "accepted", text)

    def expect(self, sysid: int, expected: Expected | None) -> None:
        """Expect a known vehicle to return under this system id and keep its name; None: no longer."""
        if expected is None:
            self._expected.pop(sysid, None)
        else:
            self._expected[sysid] = expected

    def expect_when_lost(self, sysid: int) -> None:
        """Take frames with this system id for the expected vehicle only once that is no longer heard."""
        if (expected := self._expected.get(sysid)) is not None:
            self._expected[sysid] = expected._replace(when_lost=True)

    def configured_name(self, sysid: int) -> str | None:
        """The vehicle with this system id in the fleet file, after any `Renumbering`."""
        config = self._configs.get(sysid)
        return None if config is None else config.name

    def find(self, expression: str | int) -> VehicleActor:
        """Exactly one vehicle. Raises TargetError."""
        found = self.resolve(expression)
        if len(found) != 1:
            raise TargetError(f"{expression!r} names {len(found)} vehicles; one is wanted")
        return found[0]

    @property
    def origin(self) -> Origin | None:
        """Origin of the world frame; None: it is not set yet."""
        return self.world.origin

    @property
    def origin_generation(self) -> int:
        """Increases with every change of the origin."""
        return self.world.generation

    def origin_status(self) -> dict[str, Any]:
        """See `World.status`."""
        return self.world.status()

    def set_origin(self, origin: Origin | None, *, force: bool = False) -> None:
        """See `World.set`."""
        self.world.set(origin, force=force)

    def set_origin_from(self, target: str | int, *, heading: bool = False, force: bool = False) -> None:
        """See `World.set_from_vehicle`. Raises TargetError, too."""
        self.world.set_from_vehicle(self.find(target), self._loop.time(), heading=heading, force=force)

    async def push_origin(
        self,
        expression: str | int | Sequence[str | int],
        *,
        home: bool = False,
        force: bool = False,
        reports: Reports | None = None,
    ) -> dict[str, Outcome]:
        """Send the origin to each vehicle; see `VehicleActor.push_origin`. Raises RefusedError, TargetError."""
        if self.origin is None:
            raise RefusedError("there is no origin to send; set one first")
        order = VehicleActor.push_origin
        return await self.command_all(expression, order, self.origin, reports=reports, home=home, force=force)

    async def command_all(
        self,
        expression: str | int | Sequence[str | int],
        order: Order,
        /,
        *args: Any,
        reports: Reports | None = None,
        **arguments: Any,
    ) -> dict[str, Outcome]:
        """Give one order (`VehicleActor.arm`) to every target vehicle at once; returns the outcomes by name.

        Raises TargetError before anything is sent. An order to all vehicles that fits in one frame is broadcast; each
        vehicle's answer is still awaited, and a vehicle that does not answer gets its own frame. When the caller is
        cancelled, the orders of `CARRIED_ON` go on, all others end. Raises RefusedError for a stop, or a disarming of a
        duplicate system id, without the confirmation it needs (``confirm``, see `core.vehicle.stop`). ``reports`` gets
        each vehicle's outcome when it comes.
        """
        name = order.__name__
        if self._ending and order not in CARRIED_ON:
            raise RefusedError("skygcs is shutting down: it takes no further orders but land, rtl, hold, stop, disarm")
        vehicles = [] if order in COMPONENT_ORDERS else self.resolve(expression)
        actors: list[Actor] = [*vehicles] or self.resolve_any(expression)
        if order in (VehicleActor.stop, VehicleActor.disarm):
            action = arguments["action"] if order is VehicleActor.stop else "disarm"
            twice = {actor.name: actor.vehicle.duplicate_where for actor in vehicles}
            stop.require_confirmed(action, twice, arguments.pop("confirm", None))
        work = self._command(actors, order, args, arguments, reports or Unreported())
        if order not in CARRIED_ON or len(self._kept) >= MAX_KEPT:
            return await work
        return await asyncio.shield(self._kept.start(work, f"{name} {', '.join(a.name for a in actors)}"[:100]))

    def setpoint(self, expression: str | int | Sequence[str | int], /, **setpoint: Any) -> dict[str, Outcome]:
        """One setpoint to each of the vehicles; see `VehicleActor.setpoint`. Raises TargetError, and RefusedError for
        one position for several vehicles.
        """
        actors = self.resolve(expression)
        if len(actors) > 1 and setpoint.get("pos_enu_m") is not None:
            one_place = "several vehicles were sent to one position; send each its own setpoint"
            return {actor.name: Outcome(False, "refused", f"refused: {one_place}") for actor in actors}
        return {actor.name: self._setpoint(actor, setpoint) for actor in actors}

    def _setpoint(self, actor: VehicleActor, setpoint: dict[str, Any]) -> Outcome:
        why = self._links.authority_refusal(actor.sysid)
        return actor.setpoint(**setpoint) if why is None else Outcome.refused(why)

    def authority_gained(self, sysid: int) -> None:
        """Repeat the stream requests to each autopilot of this system: the gate has blocked them until now."""
        for key in sorted(self._of_system.get(sysid, ())):
            self.vehicles[key].streams.restart(self._loop.time())

    def authority_lost(self, sysid: int, text: str) -> None:
        """Call `VehicleActor.authority_lost` of each autopilot of a system."""
        for key in sorted(self._of_system.get(sysid, ())):
            self.vehicles[key].authority_lost(text)

    async def preflight(
        self,
        expression: str | int | Sequence[str | int],
        *,
        fix: bool = False,
        confirmed: Mapping[str, Mapping[str, float]] | None = None,
    ) -> dict[str, Any]:
        """See `examine_all`; includes the vehicles of the fleet file that are not heard. Raises TargetError."""
        heard = list(self.vehicles.values())
        unheard = [Unheard(config) for sysid, config in self._configs.items() if not self._of_system.get(sysid)]
        everything: list[VehicleActor | Unheard] = [*heard, *unheard]
        found = targets.select(expression, everything)
        vehicles = {v.name: v if isinstance(v, Unheard) else v.preflight for v in found}
        return await examine_all(vehicles, fix=fix, confirmed=confirmed)

    def preflight_status(self, expression: str | int | Sequence[str | int]) -> dict[str, Any]:
        """See `Preflight.status`. Raises TargetError."""
        return {actor.name: actor.preflight.status() for actor in self.resolve(expression)}

    def everybody(self) -> list[VehicleActor]:
        """All vehicles that are known."""
        return list(self.vehicles.values())

    def flown(self) -> list[VehicleActor]:
        """The vehicles that are controlled by setpoints, or about to be."""
        return [actor for actor in self.vehicles.values() if actor.offboard.controller.active]

    def link_loss_refusal(self, link: str) -> str | None:
        """Why this link must not be closed now: a flight needs it; None if it may."""
        alone = (key for key, actor in self.vehicles.items() if self._links.links_to(actor.vehicle) == {link})
        return self.locks.refusal(LinkLoss(link, frozenset(alone)))

    def next_control_tick(self) -> float:
        """When the next control tick of any vehicle is due, in loop time; in the past: one is late; inf: none."""
        return min((clock.due for clock in self._services.running_clocks), default=math.inf)

    def flown_vehicles(self) -> list[Vehicle]:
        """The state of each vehicle to which setpoints are sent over the daemon's links."""
        return [actor.vehicle for actor in self.vehicles.values() if actor.offboard.sends_setpoints]

    async def _command(
        self,
        actors: list[Actor],
        order: Order,
        args: tuple[Any, ...],
        arguments: dict[str, Any],
        reports: Reports,
    ) -> dict[str, Outcome]:
        reports.begun([actor.name for actor in actors])
        vehicles = [actor for actor in actors if isinstance(actor, VehicleActor)]
        climbing = await self._takeoffs_ended(vehicles, arguments) if order is VehicleActor.goto else {}
        own_arguments, staying, places = (
            self._going([actor for actor in vehicles if actor not in climbing], arguments)
            if order is VehicleActor.goto
            else ({}, {}, {})
        )
        refusals: dict[Actor, str] = dict((*climbing.items(), *staying.items()))
        for actor in actors if order is not VehicleActor.stop else ():
            if (why := self._links.authority_refusal(actor.sysid)) is not None:
                refusals[actor] = why
        waiting = await self._returns(vehicles, refusals, arguments) if order is VehicleActor.rtl else {}
        free = [actor for actor in vehicles if actor not in refusals]
        refusals.update((await self._mission_refusals(free, order, arguments)).items())
        refused = {
            actor.name: _shaped(order, actor.refuse(order.__name__, reason)) for actor, reason in refusals.items()
        }
        for name, outcome in refused.items():
            reports.ended(name, outcome)
        broadcast = None if waiting else self._broadcast_command(vehicles, order)
        names = {actor: actor.name for actor in actors}
        tasks: dict[Actor, asyncio.Task[Outcome]] = {}
        try:
            async with asyncio.TaskGroup() as group:
                for actor in actors:
                    if actor in refusals:
                        continue
                    own = own_arguments.get(actor, {}) if isinstance(actor, VehicleActor) else {}
                    if isinstance(actor, VehicleActor) and actor in waiting:
                        work = self._guarded(actor, order, self.returns.wait, (waiting[actor],), {})
                    else:
                        method = order if isinstance(actor, VehicleActor) else COMPONENT_ORDERS[order]
                        work = self._guarded(actor, order, method, args, {**arguments, **own})
                    call = _reported(reports, actor.name, work)
                    tasks[actor] = group.create_task(call, name=f"{order.__name__} {actor.name}")
                if broadcast is not None:
                    await asyncio.sleep(0)  # every task waits for its answer now: none can come too early
                    self._broadcast(broadcast)
        finally:
            for vehicle in vehicles:
                vehicle.commands.end_broadcast(broadcast)
            self.returns.run()
            for actor in places:
                self.monitor.arriving(actor, ok=actor in tasks and _succeeded(tasks[actor]))
        return {name: tasks[a].result() if a in tasks else refused[name] for a, name in names.items()}

    async def _guarded(
        self, actor: Actor, order: Order, method: Order, args: tuple[Any, ...], arguments: dict[str, Any]
    ) -> Outcome:
        """Contain an internal fault in the order to one vehicle. ``method``: what carries it out."""
        try:
            outcome: Outcome = await method(actor, *args, **arguments)
        except Exception as error:
            self._on_event(
                Event("fault", actor.name, actor.sysid, f"{order.__name__} failed inside skygcs: {error!r}", {})
            )
            failed: Outcome = _shaped(order, Outcome(False, "failed", f"failed inside skygcs: {error!r}"))
            return failed
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
        others = [a for a in self.vehicles.values() if a not in starting and is_flying(a.vehicle, now)]
        if arguments.get("force") or self.monitor.mode == "off" or not starting or len(starting) + len(others) < 2:
            return {}
        read = await asyncio.gather(*(actor.missions.known_items() for actor in starting))
        known = {
            a: MissionRun(items, starting[a]) for a, items in zip(starting, read, strict=True) if items is not None
        }
        text = f"its mission could not be read, so it is not known whom it comes near; {orders.FORCE_HINT}"
        unread = {actor: text for actor in starting if actor not in known}
        return {**unread, **await self.monitor.mission_refusals(known)}

    async def _returns(
        self, actors: list[VehicleActor], refusals: Mapping[Actor, str], arguments: dict[str, Any]
    ) -> dict[VehicleActor, str]:
        """Before the order to return: who has to wait, and for whom. A single vehicle never has to."""
        at_end = arguments.pop("at_end", "hold")
        returning = [actor for actor in actors if actor not in refusals]
        return await self.returns.begin(returning, at_end=at_end) if len(returning) > 1 else {}

    async def _takeoffs_ended(
        self, actors: list[VehicleActor], arguments: Mapping[str, Any]
    ) -> dict[VehicleActor, str]:
        """Before a goto: wait until no take-off of these vehicles is under way, unless ``force``, so that they leave
        together from where they will be; returns why some do not go."""
        waiting = {actor: why for actor in actors if (why := actor.takeoffs.under_way()) is not None}
        if arguments.get("force") or not waiting:
            return {}
        for actor, why in waiting.items():
            text, data = f"goto: waits until its take-off has ended: {why}", {"order": "goto", "result": "in_progress"}
            self._on_event(Event("command", actor.name, actor.sysid, text, data))
        ends = await asyncio.gather(*(actor.takeoffs.ended() for actor in waiting))
        return {actor: why for actor, why in zip(waiting, ends, strict=True) if why is not None}

    def _going(
        self, actors: list[VehicleActor], arguments: dict[str, Any]
    ) -> tuple[
        dict[VehicleActor, dict[str, Any]], dict[VehicleActor, str], dict[VehicleActor, tuple[float, float, float]]
    ]:
        """Split a goto: the arguments of each vehicle's own, why some stay, and the places of those that go.

        One that would come too close to a vehicle that is not sent with it stays, unless ``force``. ``together``:
        vehicles that the caller keeps apart from these itself.
        """
        together = arguments.pop("together", None)
        own_arguments, staying = self._formation(actors, arguments)
        apart = [*actors, *(() if together is None else self.resolve(together))]
        keys = frozenset(actor.vehicle.key for actor in apart)
        places: dict[VehicleActor, tuple[float, float, float]] = {}
        for actor in actors:
            if actor in staying:
                continue
            where = {**arguments, **own_arguments.get(actor, {})}
            try:
                to = orders.destination(actor.vehicle, self._loop.time(), limit_m=actor.config.goto_limit_m, **where)
            except RefusedError:
                continue  # the order itself says why
            place = (to.lat_deg, to.lon_deg, to.alt_amsl_m)
            why = None if where.get("force") else self.monitor.goto_refusal(actor.vehicle, place, keys)
            if why is None:
                places[actor] = place
            else:
                staying[actor] = why
        for actor, place in places.items():
            self.monitor.sent_to(actor, place)
        return own_arguments, staying, places

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
            if enu_m is not None and len(enu_m) == 3 and self.origin is not None:
                x_m, y_m, _ = world_from_enu((east_m, north_m, 0.0), self.origin)
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
        if len(actors) != len(self.vehicles) or self.refused_vehicles:
            return None  # an autopilot was heard that is not a target
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

    def _refuse_own_ids(self, frame: Frame, channel_label: str, now: float) -> None:
        """An autopilot has our own ids: it would take our orders for its own words, and we its for ours."""
        self.refused_vehicles += 1
        if now - self._own_ids_at >= OWN_IDS_AGAIN_S:
            self._own_ids_at = now
            text = (
                f"an autopilot on {channel_label} has our own ids {frame.sysid}/{frame.compid}: it is no vehicle here; "
                "give it another system id, or set daemon.sysid"
            )
            self._on_event(Event("conflict", None, frame.sysid, text, {"link": channel_label}))

    def _discover(self, key: int, frame: Frame, channel_label: str, now: float) -> None:
        # check the ids and the limits
        if key == self._own_key:
            self._refuse_own_ids(frame, channel_label, now)
            return
        if not self._has_place(frame.sysid, channel_label):
            self.refused_vehicles += 1
            if self.refused_vehicles == 1:
                text = (
                    f"more than {MAX_VEHICLES} vehicles, or {MAX_VEHICLES_OF_LINK} on one link: "
                    f"{frame.sysid}/{frame.compid} on {channel_label} and later ones are ignored, but for those that "
                    "the fleet file names"
                )
                data = {"limit": MAX_VEHICLES, "limit_of_link": MAX_VEHICLES_OF_LINK, "link": channel_label}
                self._on_event(Event("conflict", None, frame.sysid, text, data))
            return
        self._replace_expected(frame, channel_label, now)
        unknown = "nobody knows who, as the journal cannot be read," if now < self._unknown_until else None
        flown_before = self._owed.pop(frame.sysid << 8 | frame.compid, unknown)
        actor = self._add(frame.sysid, frame.compid, channel_label, flown_before)
        config, vehicle = actor.config, actor.vehicle
        actor.on_frame(frame, channel_label, now)
        # report it
        kind = vehicle.enum_name("MAV_TYPE", vehicle.type)
        data = {"compid": frame.compid, "autopilot": vehicle.family, "type": kind, "link": channel_label}
        text = f"{vehicle.family} {kind.lower()}, system {frame.sysid}, {vehicle.mode}, over {channel_label}"
        self._on_event(Event("vehicle_discovered", config.name, frame.sysid, text, data))
        if config.autopilot is not None and config.autopilot != vehicle.family:
            text = f"the fleet file says {config.autopilot}, its heartbeat says {vehicle.family}"
            data = {"expected": config.autopilot, "autopilot": vehicle.family}
            self._on_event(Event("conflict", config.name, frame.sysid, text, data))

    def _add(self, sysid: int, compid: int, link: str, flown_before: str | None = None) -> VehicleActor:
        """Make a vehicle and its actor, and put them into the tables."""
        key = sysid << 8 | compid
        config = self._config_of(sysid, compid)
        vehicle = Vehicle(
            sysid,
            compid,
            self._dialect,
            name=config.name,
            groups=config.groups,
            timeout_s=self.config.daemon.vehicle_timeout_s,
            decoder=self._decoder,
            replayed=self._links.is_replayed(key),
        )
        vehicle.transmitter = config.preflight.transmitter
        vehicle.system = lambda now: self._system(sysid, now)
        vehicle.other_texts = lambda: self._other_texts(key)
        vehicle.duplicates = self._duplicates
        configured = config.named if self.config.vehicles else None
        actor = VehicleActor(vehicle, config, self._services, configured=configured, flown_before=flown_before)
        # into the tables
        self.components.forget(key)
        self.vehicles[key] = actor
        self._of_system.setdefault(sysid, set()).add(key)
        self._met_on[key] = link
        self._links.forget_flows()
        self.world.join(actor)
        return actor

    def recall(self) -> None:
        """Take what flew from the journal of the daemon before: one that was in the air counts as lost there until it
        is heard, and one that our setpoints flew is held then."""
        self._recall(self.flights.recall())
        if self.flights.unreadable:
            self._unknown_until = self._loop.time() + UNKNOWN_S

    def _recall(self, notes: Iterable[FlightNote]) -> None:
        now, unix_now = self._loop.time(), time.time()
        for note in notes:
            self.plans.recalled[note.key] = FlightRecord(note.flown_s, note.dropped_percent)
            parser = FrameParser(self._dialect)
            frames = [(f, at) for at, raw in note.frames for f in parser.feed_datagram(raw) if f.info is not None]
            heard_at = max((at for frame, at in frames if frame.msgid == HEARTBEAT), default=-math.inf)
            # a clock that was set back meanwhile, as on a computer without a battery for it, makes no note too old
            if not note.in_air or note.key in self.vehicles or not unix_now - heard_at < MAYBE_FLYING_S:
                continue
            actor = self._add(note.sysid, note.compid, "", note.flown_by and f"{note.flown_by} before a restart")
            actor.vehicle.recall((frame, now - max(0.0, unix_now - at)) for frame, at in frames)
            self._recalled[note.key] = now + self.config.daemon.vehicle_timeout_s

    def _report_recalled(self, now: float) -> None:
        """Report vehicles of the journal that were not heard meanwhile."""
        for key, due in list(self._recalled.items()):
            actor = self.vehicles.get(key)
            if actor is None or actor.vehicle.connected or now >= due:
                del self._recalled[key]
                if actor is not None and not actor.vehicle.connected:
                    text = f"{lost_place(actor.vehicle, now)}; it was flying before skygcs was restarted"
                    self._on_event(Event("vehicle_lost", actor.name, actor.sysid, text, {"in_air": True}))

    def _note_flights(self, now: float) -> None:
        """Note in the journal what flies."""
        actors = [a for a in self.vehicles.values() if not a.vehicle.replayed]
        states = tuple((a.vehicle.key, is_flying(a.vehicle, now), a.unattended.watch.owed_to) for a in actors)
        if not self.flights.due(states, now, flying=any(flying for _, flying, _ in states)):
            return
        self.flights.note(self._notes(now, time.time() - now), states, now)

    def _notes(self, now: float, to_unix_s: float) -> list[FlightNote]:
        """Return what flies, or has flown. ``to_unix_s``: from the loop's clock to Unix time."""
        notes = []
        for actor in (a for a in self.vehicles.values() if not a.vehicle.replayed):
            flying, flown_by = is_flying(actor.vehicle, now), actor.unattended.watch.owed_to
            vehicle, (flown_s, dropped) = actor.vehicle, self.plans.record(actor).consumption
            frames = tuple((at + to_unix_s, f.raw) for f, at in vehicle.last_frames(KEPT_MESSAGES))
            if flying or flown_s > 0.0:
                notes.append(
                    FlightNote(vehicle.sysid, vehicle.compid, vehicle.name, flying, flown_by, frames, flown_s, dropped)
                )
        return notes

    def _woke(self, slept_s: float) -> None:
        """The computer slept, and the loop's clock with it: what was known of vehicles is forgotten, as by a restart.
        Flights under our control end; what flew is looked for, and held when it is heard."""
        now = self._loop.time()
        text = (
            f"this computer slept for {slept_s:.0f} s: control has ended, nothing that was known of vehicles counts; "
            "a ground station must not sleep (systemd-inhibit, or the settings of its power)"
        )
        self._on_event(Event("warning", None, None, text, {"slept_s": round(slept_s, 1)}))
        notes = self._notes(now, time.time() - now - slept_s)
        for key in list(self.vehicles):
            self._drop(key)
        for component in list(self.components.all()):
            self.components.forget(component.sysid << 8 | component.compid)
        self._recall(notes)
        for listener in self.on_woke:
            listener(slept_s)

    def _first(self, sysid: int) -> VehicleActor | None:
        """The vehicle of a system: its autopilot with the lowest component id."""
        keys = self._of_system.get(sysid)
        return self.vehicles[min(keys)] if keys else None

    def vehicles_of(self, sysid: int) -> list[Vehicle]:
        """The vehicles of one system: more than one only if it has two autopilots."""
        return [self.vehicles[key].vehicle for key in sorted(self._of_system.get(sysid, ()))]

    def _is_first(self, actor: Actor) -> bool:
        return actor is self._first(actor.sysid)

    def _name_of_system(self, sysid: int) -> str | None:
        first = self._first(sysid)
        return None if first is None else first.name

    def _system(self, sysid: int, now: float) -> list[dict[str, Any]]:
        """Its components, autopilots among them, by component id."""
        own = [self.vehicles[key].describe(now) for key in self._of_system.get(sysid, ())]
        others = [actor.component.describe(now) for actor in self.components.of_system(sysid)]
        return sorted((*own, *others), key=lambda component: int(component["compid"]))

    def _other_texts(self, key: int) -> list[tuple[StatusText, int]]:
        first = self._first(key >> 8)
        if first is None or first.vehicle.key != key:
            return []
        return [(text, c.compid) for c in self.components.of_system(key >> 8) for text in c.component.texts]

    def _has_place(self, sysid: int, link: str) -> bool:
        """True if there is room for a new vehicle; if necessary the vehicle that was lost first is removed."""
        if sysid in self._configs and not any(key >> 8 == sysid for key in self.vehicles):
            return True
        unnamed = [key for key in self.vehicles if key >> 8 not in self._configs]
        on_link = [key for key in unnamed if self._met_on[key] == link]
        if len(on_link) >= MAX_VEHICLES_OF_LINK:
            return self._drop_lost(on_link)
        return len(self.vehicles) < MAX_VEHICLES or self._drop_lost(unnamed)

    def _drop_lost(self, keys: list[int]) -> bool:
        """Forget one lost vehicle of these, a disarmed one before an armed one. False if all are heard, or may fly."""
        lost = [key for key in keys if not self.vehicles[key].vehicle.connected and not self.may_fly(key)]
        if not lost:
            return False
        actor = self._drop(min(lost, key=lambda key: bool(self.vehicles[key].vehicle.armed)))
        text = f"{actor.name}, which is lost, is forgotten to make room for another of {MAX_VEHICLES} vehicles"
        self._on_event(Event("vehicle_lost", actor.name, actor.sysid, text, {"forgotten": True}))
        return True

    def _replace_expected(self, heartbeat: Frame, link: str, now: float) -> None:
        """If this is a vehicle that was given a new system id, remove the entry of the old id; the name stays."""
        expected = self._expected.get(heartbeat.sysid)
        if expected is None or now > expected.until or link != expected.link:
            return
        old = self.vehicles.get(expected.key)
        fields = heartbeat.fields()
        if old is None or (fields["type"], fields["autopilot"]) != (old.vehicle.type, old.vehicle.autopilot):
            return
        if expected.when_lost and old.vehicle.connected:
            return
        del self._expected[heartbeat.sysid]
        config = self._configs.pop(old.sysid, None)
        if config is not None and heartbeat.sysid not in self._configs:
            self._configs[heartbeat.sysid] = config.model_copy(update={"sysid": heartbeat.sysid})
        self._drop(expected.key)
        self.components.forget_system(old.sysid)
        text = f"{old.name} was system {old.sysid} and is {heartbeat.sysid} now"
        self._on_event(Event("vehicle_forgotten", old.name, old.sysid, text, {"sysid": heartbeat.sysid}))

    def _drop(self, key: int) -> VehicleActor:
        actor = self.vehicles.pop(key)
        owed_to = actor.unattended.watch.owed_to
        if owed_to is not None and may_fly(actor.vehicle, self._loop.time()) and len(self._owed) < MAX_VEHICLES:
            self._owed[key] = owed_to
        self._of_system[key >> 8].discard(key)
        del self._met_on[key]
        actor.close()
        self._links.forget_flows()
        return actor

    def _config_of(self, sysid: int, compid: int) -> VehicleConfig:
        """Names are unique: a second autopilot of one system gets its component id after the name."""
        config = self._configs.get(sysid) or self.config.default_vehicle(sysid)
        taken = {actor.name for actor in self.vehicles.values()}
        if config.name in taken:
            config = config.model_copy(update={"name": f"{config.name}-{compid}"})
        return config


async def _reported(reports: Reports, name: str, work: Awaitable[Outcome]) -> Outcome:
    """Await the outcome of an order to one vehicle, and report it."""
    outcome = await work
    reports.ended(name, outcome)
    return outcome


def _shaped(order: Order, outcome: Outcome) -> Any:
    """An outcome that the order itself did not make, with the keys of those that it makes."""
    if order in (VehicleActor.set_fence, VehicleActor.read_fence, VehicleActor.test_fence):
        return FenceOutcome(outcome)
    if order in (VehicleActor.list_logs, VehicleActor.get_logs):
        from skygcs.runtime.onboard_logs import LogsOutcome  # rpc.onboard_logs has imported it

        return LogsOutcome.without_logs(outcome)
    return outcome


def _origin(config: FleetConfig) -> Origin | None:
    return None if config.origin is None else Origin(**config.origin.model_dump())


def _succeeded(task: asyncio.Task[Outcome]) -> bool:
    """True if an order ended well."""
    return task.done() and not task.cancelled() and task.exception() is None and task.result().ok
