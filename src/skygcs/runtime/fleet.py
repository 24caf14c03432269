"""The fleet: adds vehicles by their heartbeats, names them by the fleet file, finds them by what orders name, and notes
what flies. Orders to them: `runtime.fleet_orders`."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from skygcs.config.models import FleetConfig, VehicleConfig
from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.protocols.command import Outcome
from skygcs.core.routing.state_source import KNOWN_BY, Known
from skygcs.core.vehicle import orders, targets
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.flight_evidence import MAYBE_FLYING_S, may_fly
from skygcs.core.vehicle.flight_lock import Forgetting, LinkLoss
from skygcs.core.vehicle.status_texts import StatusText
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.disk_writer import DiskWriter
from skygcs.errors import TargetError
from skygcs.events import Event
from skygcs.links.base import Channel, StateUpdate
from skygcs.runtime.command_client import SendFn
from skygcs.runtime.components import Components
from skygcs.runtime.fleet_orders import Actor, FleetOrders
from skygcs.runtime.flight_locks import FlightLocks
from skygcs.runtime.flight_notes import FlightJournal, FlightNotes
from skygcs.runtime.home_orders import WorldFrame
from skygcs.runtime.loop_clock import SleepWatch, Standstill, boot_clock
from skygcs.runtime.param_cache import ParamCache
from skygcs.runtime.plan_place import PlanPlace
from skygcs.runtime.returns import Returns
from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.runtime.task_set import fault
from skygcs.runtime.trajectories import Trajectories
from skygcs.runtime.undo_journal import UndoJournal
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import (
    MAX_VEHICLES,
    NewFlight,
    OnEvent,
    OrderRefusal,
    VehicleLinks,
    VehicleServices,
    no_order_refusal,
)

MAX_VEHICLES_OF_LINK = 250
"""System ids 1..250 by convention; more on one link can only be noise or a forged stream of heartbeats. One that
the fleet file names always has its place."""

ROOM_AGAIN_S, ROOM_FOR_KNOWN_S = 1.0, 0.05
"""From one look for a place on a link where there was none to the next, and for ids that were refused before: made-up
ones seldom come again, and would else take every place. To forget a vehicle and to meet another costs some 5 ms; a peer
that makes up thousands a second is to cost no more than a tenth of the time."""

MAX_TURNED_AWAY = 4096
"""Ids that were refused, the last ones: a flood of 1,000 a second leaves a vehicle's until its next heartbeats."""

OWN_IDS_AGAIN_S = 60.0
"""Between two reports of an autopilot that has our own ids."""


class Expected(NamedTuple):
    """The vehicle ``key`` is expected under another system id, on this link and until then. ``when_lost``: only once it
    is no longer heard under the old one."""

    key: int
    link: str
    until: float
    when_lost: bool = False


@dataclass(frozen=True, slots=True)
class Unheard:
    """A vehicle of the fleet file from which nothing has come since the daemon started."""

    config: VehicleConfig
    compid: int = 1

    @property
    def name(self) -> str:
        return self.config.name

    @property
    def sysid(self) -> int:
        return self.config.sysid

    @property
    def groups(self) -> tuple[str, ...]:
        return self.config.groups


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
        links: VehicleLinks,
        param_cache: ParamCache | None = None,
        probes: bool = False,
    ) -> None:
        """``send``: `Hub.send`. ``links``: `LinkView`. ``param_cache``: the store of parameters; None: no store.
        ``probes``: True if the uplinks are probed."""
        self.config = config
        self.vehicles: dict[int, VehicleActor] = {}
        self.refused_vehicles = 0
        self.flights_elsewhere: dict[str, NewFlight] = {}  # the daemon adds those of its extensions
        self.on_woke: list[Callable[[Standstill], None]] = []
        """Called after a sleep of the computer or a standstill of this process."""
        self.order_refusal: OrderRefusal = no_order_refusal  # the daemon sets that of its extensions
        self._dialect, self._send, self._loop, self._on_event = dialect, send, loop, on_event
        self._links = links
        self.locks = FlightLocks(self._links.links_to, self._report_fault)  # of the flights under way
        self.world = WorldFrame(_origin(config), self.vehicles, self.locks, on_event)
        self._of_system: dict[int, set[int]] = {}  # the keys of ``vehicles`` by system id
        own = config.daemon
        self._own_key = own.sysid << 8 | own.compid
        self._own_ids_at = -math.inf
        # orders and what is kept of them on disk
        self.disk = DiskWriter(loop, on_event)
        self.journal = UndoJournal(own.log_dir / "undo")
        self.monitor = SeparationMonitor(config.monitor, self.vehicles, loop, on_event)
        self.returns = Returns(self.monitor, self.vehicles, loop, on_event)
        param_cache = param_cache or ParamCache(None)
        param_cache.disk = self.disk
        self._services = self._new_services(param_cache, probes=probes)
        self.orders = FleetOrders(self, self._services, self.monitor, self.returns)
        self.sleep = SleepWatch(self._woke, loop)
        self._met_on: dict[int, str] = {}  # by key, the link on which a vehicle was first heard
        self._room_sought_at: dict[str, float] = {}  # by link, where there was none
        self._turned_away: dict[int, None] = {}  # keys that were refused for lack of room, the last ones
        self._duplicates: dict[int, str] = {}
        """By key, where two autopilots send with these ids; the vehicles read it, too (`SharedIds.others`)."""
        self.trajectories = Trajectories(self.vehicles.values, loop, on_event, self.monitor, self.locks)
        self.plans = PlanPlace(loop.time, self._report_fault, self.trajectories.pause_plans)
        lost_s, waits = own.vehicle_timeout_s, self.returns.waits
        journal = FlightJournal(own.log_dir, self.disk, on_event, boot_clock(loop))
        self.notes = FlightNotes(self.vehicles, self._add, waits, journal, lost_s, dialect, loop, on_event)
        # other components, and configured vehicles
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

    def _report_fault(self, error: Exception) -> None:
        self._on_event(Event("fault", None, None, f"{type(error).__name__}: {error}", {}))

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
        """Call `tick` of every vehicle and every part, even if one fails; the first exception is raised at the end."""
        first: Exception | None = None
        if self.sleep.check():
            return
        parts = self.components.tick, self.trajectories.tick, lambda _: self.plans.tick(), self.notes.tick
        for tick in (*(actor.tick for actor in self.vehicles.values()), *parts):
            try:
                tick(now)
            except Exception as error:
                first = first or error
        if first is not None:
            raise first

    def on_station_frame(self, frame: Frame, channel: Channel, now: float) -> None:
        """A message of another station, one of `STATION_MESSAGES`, to one of the vehicles."""
        system, component = frame.target()
        for key in self._of_system.get(system, ()) if system and channel.config.type != "replay" else ():
            if component in (0, key & 0xFF):
                self.vehicles[key].unattended.on_station(frame, now)

    async def wind_down(self, timeout_s: float) -> None:
        """The daemon ends: accept only orders that end a flight, cancel orders that undo themselves, and wait this long
        for the undo. Changes that are not undone stay in the journal."""
        self.orders.ends_only = True
        tasks = {
            self._loop.create_task(actor.wind_down(), name=f"{actor.name} undo") for actor in self.vehicles.values()
        }
        tasks.add(self._loop.create_task(self.plans.wind_down(), name="the plan's undo"))
        done, late = await asyncio.wait(tasks, timeout=timeout_s)
        for task in late:
            task.cancel()
        for task in done:
            if (text := fault(task)) is not None:
                self._on_event(Event("fault", None, None, text, {}))

    async def ended(self, timeout_s: float) -> None:
        """After `close`: wait until the changes that could not be undone have been noted."""
        tasks = {self._loop.create_task(actor.ended()) for actor in self.vehicles.values()}
        if tasks:
            _, late = await asyncio.wait(tasks, timeout=timeout_s)
            for task in late:
                task.cancel()

    def close(self) -> None:
        """End all orders in flight as cancelled."""
        for actor in self.vehicles.values():
            actor.close()
        if self.config.daemon.keep_vehicles:
            self.notes.note_flights(self._loop.time())  # what was held at the end is not held again at the next begin
        self.components.close()
        self.monitor.close()
        self.returns.close()
        self.orders.close()

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
        """True if this is a vehicle that may be under way now (`core.vehicle.flight_evidence`)."""
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
        return targets.select(expression, self.vehicles.values(), self.unheard())

    def resolve_any(self, expression: str | int | Sequence[str | int]) -> list[Actor]:
        """`resolve` with components: "7/191" and "alpha/191" may also name components. Raises TargetError."""
        vehicles: list[Actor] = [*self.vehicles.values()]
        return targets.select_any(expression, vehicles, [*self.components.all()], self.unheard())

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
    def links(self) -> VehicleLinks:
        """The daemon's knowledge of the links to the vehicles."""
        return self._links

    @property
    def origin(self) -> Origin | None:
        """Origin of the world frame; None: it is not set yet."""
        return self.world.origin

    @property
    def origin_generation(self) -> int:
        """Increases with every change of the origin."""
        return self.world.generation

    def origin_status(self) -> dict[str, Any]:
        """See `WorldFrame.status`."""
        return self.world.status()

    def set_origin(self, origin: Origin | None, *, force: bool = False) -> None:
        """See `WorldFrame.set`."""
        self.world.set(origin, force=force)

    def set_origin_from(self, target: str | int, *, heading: bool = False, force: bool = False) -> None:
        """See `WorldFrame.set_from_vehicle`. Raises TargetError, too."""
        self.world.set_from_vehicle(self.find(target), self._loop.time(), heading=heading, force=force)

    def authority_changed(self, sysid: int, refusal: str | None) -> None:
        """A gate has closed a system for this reason, or opened it (None): end the work on each of its autopilots, or
        repeat its stream requests, which the gate has blocked until now. Each change is an event."""
        for actor in [self.vehicles[key] for key in sorted(self._of_system.get(sysid, ()))]:
            if refusal is None:
                actor.streams.restart(self._loop.time())
            else:
                actor.authority_lost(refusal)
        name = self.configured_name(sysid)
        text = refusal or f"{name or f'system {sysid}'} may be commanded from here"
        self._on_event(Event("authority", name, sysid, text, {"held": refusal is None}))

    def unheard(self) -> list[Unheard]:
        """The vehicles of the fleet file that are not heard."""
        return [Unheard(config) for sysid, config in self._configs.items() if not self._of_system.get(sysid)]

    def everybody(self) -> list[VehicleActor]:
        """All vehicles that the fleet knows."""
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

    def _refuse_own_ids(self, frame: Frame, channel_label: str, now: float) -> None:
        """An autopilot has our own ids: it would take our orders for its own words, and we its for ours."""
        self.refused_vehicles += 1
        if now - self._own_ids_at >= OWN_IDS_AGAIN_S:
            self._own_ids_at = now
            text = (
                f"an autopilot on {channel_label} has our own ids {frame.sysid}/{frame.compid}: it is not a vehicle "
                "here; give it another system id, or set daemon.sysid"
            )
            self._on_event(Event("conflict", None, frame.sysid, text, {"link": channel_label}))

    def _discover(self, key: int, frame: Frame, channel_label: str, now: float) -> None:
        # check the ids and the limits
        if key == self._own_key:
            self._refuse_own_ids(frame, channel_label, now)
            return
        if not self._has_place(key, channel_label, now):
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
        actor = self._add(frame.sysid, frame.compid, channel_label, self.notes.flown_before(key, now))
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
        vehicle.ids.others = self._duplicates
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

    def _woke(self, pause: Standstill) -> None:
        """The computer slept, or this process stood still: what was known of vehicles is forgotten, as by a restart.
        Flights under our control end; what flew is looked for, and held when it is heard."""
        now = self._loop.time()
        text = f"{pause.text}: control has ended, nothing that was known of vehicles counts"
        if pause.slept:
            text += "; a ground station must not sleep (systemd-inhibit, or the settings of its power)"
        data = {"slept_s" if pause.slept else "stood_still_s": round(pause.seconds, 1)}
        self._on_event(Event("warning", None, None, text, data))
        # what would go on ordering beyond the actors
        self._contained(self.returns.end, pause.text)
        notes = self.notes.of_flights(now, time.time() - now - pause.missed_s)
        self._contained(self.orders.close, pause.text)
        self._contained(self.monitor.close)
        for key, actor in list(self.vehicles.items()):
            self._contained(actor.outcomes.cut_stops, pause.text)
            self._contained(self._drop, key, pause.text)
        for component in list(self.components.all()):
            self._contained(self.components.forget, component.sysid << 8 | component.compid, pause.text)
        self._contained(self.notes.recall, notes, pause.name)
        for listener in self.on_woke:
            self._contained(listener, pause)

    def _contained(self, step: Callable[..., object], *arguments: object) -> None:
        """A step of a wake, whose fault keeps no other from being done."""
        try:
            step(*arguments)
        except Exception as error:
            self._report_fault(error)

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
        """All components of one system, autopilots among them, by component id."""
        own = [self.vehicles[key].describe(now) for key in self._of_system.get(sysid, ())]
        others = [actor.component.describe(now) for actor in self.components.of_system(sysid)]
        return sorted((*own, *others), key=lambda component: int(component["compid"]))

    def _other_texts(self, key: int) -> list[tuple[StatusText, int]]:
        first = self._first(key >> 8)
        if first is None or first.vehicle.key != key:
            return []
        return [(text, c.compid) for c in self.components.of_system(key >> 8) for text in c.component.texts]

    def _has_place(self, key: int, link: str, now: float) -> bool:
        """True if there is room for a new vehicle; if necessary one that is lost is removed, on each link one in
        `ROOM_AGAIN_S`, or in `ROOM_FOR_KNOWN_S`."""
        sysid = key >> 8
        if len(self.vehicles) < MAX_VEHICLES_OF_LINK or (sysid in self._configs and not self._of_system.get(sysid)):
            return True
        again_s = ROOM_FOR_KNOWN_S if key in self._turned_away else ROOM_AGAIN_S
        self._turned_away[key] = None
        if len(self._turned_away) > MAX_TURNED_AWAY:
            del self._turned_away[next(iter(self._turned_away))]
        if now - self._room_sought_at.get(link, -math.inf) < again_s:
            return False
        unnamed = [key for key in self.vehicles if key >> 8 not in self._configs]
        on_link = [key for key in unnamed if self._met_on[key] == link]
        if len(on_link) < MAX_VEHICLES_OF_LINK and len(self.vehicles) < MAX_VEHICLES:
            return True
        self._room_sought_at[link] = now
        return self._drop_lost(on_link if len(on_link) >= MAX_VEHICLES_OF_LINK else unnamed)

    def _drop_lost(self, keys: list[int]) -> bool:
        """Forget one lost vehicle of these: a disarmed one before an armed one, and that which is silent for longest.
        So a vehicle that fades for a moment outlasts strangers that come and go. False if all are heard, or may fly."""
        lost = [key for key in keys if not self.vehicles[key].vehicle.connected and not self.may_fly(key)]
        if not lost:
            return False
        now, found = self._loop.time(), {key: self.vehicles[key].vehicle for key in lost}
        actor = self._drop(max(lost, key=lambda key: (not found[key].armed, found[key].silence_s(now) or 0.0)))
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

    def _drop(self, key: int, why: str = "it was forgotten") -> VehicleActor:
        actor = self.vehicles.pop(key)
        self.notes.dropped(actor)
        self._of_system[key >> 8].discard(key)
        del self._met_on[key]
        actor.close(why)
        self._links.forget_flows()
        return actor

    def _config_of(self, sysid: int, compid: int) -> VehicleConfig:
        """Names are unique: a second autopilot of one system gets its component id after the name."""
        config = self._configs.get(sysid) or self.config.default_vehicle(sysid)
        taken = {actor.name for actor in self.vehicles.values()}
        if config.name in taken:
            config = config.model_copy(update={"name": f"{config.name}-{compid}"})
        return config


def _origin(config: FleetConfig) -> Origin | None:
    return None if config.origin is None else Origin(**config.origin.model_dump())
