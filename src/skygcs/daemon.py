"""Composition root: config -> objects -> task groups; ordered shutdown.

Two nested groups: the inner one runs links and clocks, the outer one the recorder and the RPC server. A stop ends the
inner group first, so that what links did last is still recorded and reported.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, cast

from skygcs import __version__
from skygcs.config.checks import control_place_problems
from skygcs.config.extension_tables import find_owners, word_problems
from skygcs.config.files import read_token
from skygcs.config.models import NO_TABLES, FleetConfig
from skygcs.core.control.deadman import DeadMan
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.msgids import HEARTBEAT, RADIO, RADIO_STATUS
from skygcs.errors import ConfigError
from skygcs.extension import Extension, Extensions
from skygcs.rpc.address import default_socket_path
from skygcs.rpc.server import RpcServer
from skygcs.runtime.alarm_book import AlarmBook
from skygcs.runtime.components import ONBOARD_COMPUTER
from skygcs.runtime.event_log import EventLog
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.leftover_streams import WATCHED, LeftoverStreams
from skygcs.runtime.link_view import LinkView, LinkWatch
from skygcs.runtime.linktable import LinkTable
from skygcs.runtime.loop_clock import BEAT_S
from skygcs.runtime.operator_watchdog import OperatorWatchdog
from skygcs.runtime.param_cache import ParamCache, default_cache_dir
from skygcs.runtime.radios import Radios
from skygcs.runtime.recorder import Recorder
from skygcs.runtime.renumbering import Renumbering
from skygcs.runtime.route_reports import RouteReports
from skygcs.runtime.signing_keys import Signing, SigningStore, default_state_dir
from skygcs.runtime.unattended_holds import STATION_MESSAGES
from skygcs.runtime.vehicle_actor import VehicleActor

if TYPE_CHECKING:  # see above
    from skygcs.core.vehicle.vehicle import Vehicle

HEARTBEAT_PERIOD_S = 1.0
"""MAVLink heartbeat protocol: 1 Hz; a SiK radio sends no RADIO_STATUS without it."""

GCS = 6
"""MAV_TYPE of our heartbeats; aboard a vehicle it is ONBOARD_COMPUTER, as they must not look like a ground station's to
the autopilot's failsafe."""

UNDO_S = 3.0
"""Seconds for the changes that undo themselves when the daemon is stopped: five round trips of a nine-node radio. With
PARK_S after it the links are open for 5 s at most; the journal keeps the changes that are not undone by then."""

NOTE_S = 0.5
"""Seconds for writing the files that list the changes not undone; the disk may be stuck."""

PARK_S = 2.0
"""Two transmissions of the order to hold; the end of the daemon does not wait for a vehicle that does not answer."""

LINK_CHOICE_S = 0.2
"""A fifth of the shortest silence after which another link to a vehicle is used."""

FLEET_TICK_S = 0.2
"""How late a lost vehicle may be noticed; its timeout is seconds."""


class Daemon:
    """One running skygcs. `run` until `stop`; the rest answers the RPC methods (loop thread only)."""

    def __init__(self, config: FleetConfig, dialect: Dialect, *, source: str = "<built in>") -> None:
        self.config = config
        self._file_config = config  # as it was read last
        self.dialect = dialect
        self.source = source
        self.loop = asyncio.get_running_loop()
        self.started_at = self.loop.time()
        self.ready = asyncio.Event()
        self._stopping = asyncio.Event()
        own = config.daemon
        # events, recorder, keys
        self.event_log = EventLog(self.loop.time)
        publish = self.event_log.publish
        self.recorder = self._new_recorder() if own.record else None
        self.signing = Signing(dialect, publish, SigningStore(default_state_dir()))
        # links
        keys = self.signing
        self.hub = Hub(config, dialect, self.loop, publish, recorder=self.recorder, signing=keys)
        self.links = LinkTable(config, dialect, self.hub, self.loop, publish, self.signing)
        self.link_watch = LinkWatch(self.hub)
        # vehicles
        view = LinkView(self.hub, self.links, self.link_watch)
        self.fleet = Fleet(
            config,
            dialect,
            self.hub.send,
            self.loop,
            publish,
            links=view,
            param_cache=ParamCache(default_cache_dir()),
            probes=own.heartbeat,
        )
        self.alarms = AlarmBook(config.alarms, self.event_log, self._vehicles, own.log_dir, self.fleet.disk)
        self.signing.disk = self.fleet.disk
        self.links.loss_refusal = self.fleet.link_loss_refusal
        reports = RouteReports(self.fleet, publish, own.route_timeout_s)
        self.hub.connect(self.fleet if own.keep_vehicles else None, reports)
        self.air = Radios(config, self.hub, self.fleet, self.link_watch, publish)
        self.leftover_streams = LeftoverStreams(self.hub, self.fleet, dialect, own.route_timeout_s, publish)
        dead_man = DeadMan(own.operator_timeout_s, own.operator_lost)
        self.operator_watchdog = OperatorWatchdog(dead_man, self.fleet, self.loop, publish)
        self._observe()
        # what clients of the socket ask for
        self.renumbering = Renumbering(self.hub, self.fleet, self.loop, publish, source)
        self.socket_path = own.socket or default_socket_path()
        token = read_token("daemon", own.token_file)
        self.hub.asleep = self.hub.reading.asleep = self.fleet.sleep.check
        self.rpc = RpcServer(self, self.socket_path, tcp_port=own.tcp_port, token=token)
        self.extensions = self._new_extensions()
        self._connect_extensions(view)
        self._forget_after_pauses()

    def _vehicles(self) -> Iterator[Vehicle]:
        return (actor.vehicle for actor in self.fleet.vehicles.values())

    def _new_extensions(self) -> Extensions:
        """The extensions whose tables the fleet file has. Raises ConfigError for one that cannot be made."""
        tables = self.config.extensions
        owners, unusable = find_owners(set(tables))
        if unusable or owners.keys() != tables.keys():
            missing = [f"no extension is installed for [{name}]" for name in tables.keys() - owners.keys()]
            raise ConfigError(self.source, [*(f"{name}: {text}" for name, text in unusable.items()), *missing])
        if taken := word_problems(owners):
            raise ConfigError(self.source, taken)
        made = {name: cast("type[Extension[Any]]", owners[name])(self, table) for name, table in tables.items()}
        extensions = Extensions(made, self.hub.fault, self)
        if problems := control_place_problems(self.config, extensions.places_of_control()):
            raise ConfigError(self.source, [f"{'.'.join(map(str, p.path))}: {p.text}" for p in problems])
        return extensions

    def _new_recorder(self) -> Recorder:
        own = self.config.daemon
        return Recorder(
            own.log_dir,
            max_bytes=int(own.record_max_mb * 1e6),
            max_age_s=own.record_max_minutes * 60.0,
            on_event=self.event_log.publish,
        )

    def _observe(self) -> None:
        """Give frames and events to what reads them."""
        known = set(self.dialect.messages)
        self.hub.observers.add({RADIO_STATUS, RADIO} & known, None, self.link_watch.on_radio)
        self.hub.observers.add(set(WATCHED) & known, None, self.leftover_streams.on_frame)
        stations = {self.dialect.by_name[name].msgid for name in STATION_MESSAGES if name in self.dialect.by_name}
        self.hub.observers.add(stations, None, self.fleet.on_station_frame)
        if self.operator_watchdog.watching:
            self.hub.observers.add({HEARTBEAT}, None, self.operator_watchdog.on_frame)
        self.event_log.on("reboot", self.hub.on_reboot)
        self.event_log.on("reboot", self.leftover_streams.on_reboot)

    def _connect_extensions(self, view: LinkView) -> None:
        """Give them orders to check, frames to observe and vehicles to gate, and leave them their part of the links."""
        self.hub.gate_sending(self.extensions.send_gates())
        self.fleet.order_refusal = self.extensions.order_refusal
        self.fleet.plans.on_fault = self.fleet.locks.on_fault = self.hub.fault
        self.fleet.flights_elsewhere.update(self.extensions.flights_elsewhere())
        view.taken_bytes_per_s = self.extensions.bytes_per_s
        for extension in self.extensions:
            if msgids := set(extension.observed_msgids()):
                self.hub.observers.add(msgids, None, extension.on_frame)

    def _forget_after_pauses(self) -> None:
        """After a sleep or a standstill nothing of before is used: what clients asked for, what waits in sockets and
        what waits to be sent may be hours old."""
        self.fleet.on_woke += (
            lambda _: self.hub.woke(),
            lambda pause: self.rpc.close_sessions(f"{pause.text}: connect anew"),
            lambda pause: self.operator_watchdog.slept(pause.missed_s),
            lambda pause: self.extensions.woke(pause.text),
        )

    # -- life

    async def run(self) -> None:
        """Run until `stop`. Raises SkygcsError only before `ready` is set."""
        self.rpc.claim()
        try:
            for extension in self.extensions:
                extension.claim()
            self.alarms.recall()
            for report in self.fleet.journal.reports():
                self.event_log.publish(report)
            if self.config.daemon.keep_vehicles:
                self.fleet.notes.recall_journal()
            async with asyncio.TaskGroup() as outer:
                recording = None
                if self.recorder is not None:
                    recording = outer.create_task(self.recorder.run(), name="recorder")
                try:
                    await self._run_inner()
                finally:
                    if self.recorder is not None and recording is not None:
                        recording.cancel()
                        await self.recorder.close()
        finally:
            self.event_log.flush()
            self.alarms.close()
            try:
                await self.fleet.disk.close()
                self.extensions.close()  # for one that was claimed by a daemon that then did not start
                await self.extensions.ended()
            finally:  # also when that is cancelled: a socket that stays keeps the next daemon from its start
                await self.rpc.close()

    async def _run_inner(self) -> None:
        async with asyncio.TaskGroup() as group:
            clocks = self._start_clocks(group)
            signing = group.create_task(self.signing.run(), name="signing")
            if self.config.daemon.heartbeat:
                heartbeat = self._every(HEARTBEAT_PERIOD_S, self._heartbeat_task)
                clocks.append(group.create_task(heartbeat, name="heartbeat"))
            self.links.start(group)
            try:
                await self.rpc.start()  # after the links: a restart in flight forwards first
                for extension in self.extensions:
                    await extension.start()
                self.ready.set()
                await self._stopping.wait()
                await self.fleet.wind_down(UNDO_S)  # while the links are open
                await self._park()
            finally:  # also if a part of the daemon has failed: nothing flies on then
                for clock in clocks:
                    clock.cancel()
                self.operator_watchdog.close()
                self.extensions.close()
                self.renumbering.close()
                self.fleet.close()  # orders in progress end, and report so, before the links are gone
                await self.fleet.ended(NOTE_S)
            await self.links.close()
            signing.cancel()  # after the last message that was signed

    def _start_clocks(self, group: asyncio.TaskGroup) -> list[asyncio.Task[None]]:
        """Start the periodic tasks, which run until the daemon ends."""
        clocks = [
            group.create_task(self._every(BEAT_S, self.fleet.sleep.beat), name="watch of standstills"),
            group.create_task(self._every(FLEET_TICK_S, lambda: self.fleet.tick(self.now())), name="fleet tick"),
            group.create_task(self._every(FLEET_TICK_S, self.event_log.tick), name="events"),
            group.create_task(self._every(1.0, self.alarms.tick), name="alarms"),
            group.create_task(self._every(1.0, lambda: self.hub.tick(self.now())), name="hub tick"),
            group.create_task(
                self._every(LINK_CHOICE_S, lambda: self.hub.choose_links(self.now())), name="choice of links"
            ),
            group.create_task(self._every(1.0, lambda: self.link_watch.tick(self.now())), name="watch of links"),
            group.create_task(self._every(1.0, lambda: self.air.tick(self.now())), name="radios"),
            group.create_task(self._every(0.1, lambda: self.air.step(self.now())), name="air requests"),
            group.create_task(
                self._every(1.0, lambda: self.leftover_streams.tick(self.now())), name="leftover streams"
            ),
            group.create_task(
                self._every(1.0, lambda: self.operator_watchdog.tick(self.now())), name="operator watchdog"
            ),
        ]
        clocks.append(group.create_task(self.fleet.monitor.run(), name="monitor"))
        if self.hub.send_gates is not None:
            clocks.append(group.create_task(self._every(FLEET_TICK_S, self.check_sending), name="gates of sending"))
        for extension in self.extensions:
            for clock in extension.clocks():
                clocks.append(group.create_task(self._every(clock.period_s, clock.action), name=clock.name))
        clocks += [group.create_task(run, name=table) for table, run in self.extensions.runs()]
        return clocks

    async def _park(self) -> None:
        """Order vehicles that are flown by setpoints to hold before these stop: an ArduCopter in attitude control would
        only level."""
        flown = [actor.name for actor in self.fleet.flown() if actor.offboard.sends_setpoints]
        if flown:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(PARK_S):
                    await self.fleet.orders.command_all(flown, VehicleActor.hold, by_person=False)

    async def reload(self, config: FleetConfig) -> list[str]:
        """Apply another version of the fleet file: links that differ are closed, changed or opened, all others go on.
        Returns a line for each difference; those beyond links are named, and need a restart."""
        before, self._file_config = self._file_config, config
        lines = await self.links.replace(before.links, config.links)
        for table in type(config).model_fields:
            if table not in {"links", *NO_TABLES} and getattr(before, table) != getattr(config, table):
                lines.append(f"[{table}] differs: it is applied by a restart")
        for table in sorted(before.extensions.keys() | config.extensions.keys()):
            if before.extensions.get(table) != config.extensions.get(table):
                lines.append(f"[{table}] differs: it is applied by a restart")
        return lines or ["the fleet file is as before: nothing changes"]

    def stop(self) -> None:
        """End `run` in order. Idempotent; safe as a signal handler of the loop."""
        self._stopping.set()

    @property
    def stopping(self) -> bool:
        return self._stopping.is_set()

    async def stopped(self) -> None:
        """Wait until `stop` is called."""
        await self._stopping.wait()

    async def _every(self, period_s: float, action: Callable[[], None]) -> None:
        """One clock of the daemon. A fault behind one tick is reported once and does not stop the others."""
        while True:
            try:
                action()
            except Exception as error:
                self.hub.fault(error)
            await asyncio.sleep(period_s)

    def _heartbeat_task(self) -> None:
        kind = GCS if self.config.aboard is None else ONBOARD_COMPUTER
        values = {"type": kind, "autopilot": 8, "base_mode": 0, "system_status": 4, "mavlink_version": 3}
        self.hub.send_heartbeat(self.dialect.find("HEARTBEAT"), values)

    def check_sending(self) -> None:
        """Compare the gates with the last look, a few times a second and after a change that is to show at once."""
        if (gates := self.hub.send_gates) is not None:
            for sysid, refusal in gates.changes(self.hub.boot_clock()):
                self.fleet.authority_changed(sysid, refusal)

    def now(self) -> float:
        """The loop's clock."""
        return self.loop.time()

    def info(self) -> dict[str, Any]:
        own = self.config.daemon
        return {
            "version": __version__,
            "pid": os.getpid(),
            "sysid": own.sysid,
            "compid": own.compid,
            "dialect": self.dialect.name,
            "fleet_file": self.source,
            "socket": str(self.socket_path),
            "operator_timeout_s": own.operator_timeout_s,
            "uptime_s": round(self.now() - self.started_at, 1),
            "vehicles": len(self.fleet.vehicles),
            "faults": self.hub.faults,
            "stale_frames": self.hub.stale_frames,
            "clients": self.rpc.stats(),
            "companion_of": self.config.aboard,
            "to_undo": self.fleet.journal.number_left,
            **self.extensions.info(),
        }
