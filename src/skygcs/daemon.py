"""Composition root: config -> objects -> task groups; ordered shutdown.

What only some fleet files ask for (motion capture, metrics, the web page) is imported by those daemons alone, before a
link is open.

Two nested groups: the inner one runs links and clocks, the outer one the recorder and the RPC server. A stop ends the
inner group first, so that what links did last is still recorded and reported.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skygcs import __version__
from skygcs.config.files import open_regular
from skygcs.config.models import FleetConfig
from skygcs.core.control.deadman import DeadMan
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.msgids import HEARTBEAT, RADIO, RADIO_STATUS
from skygcs.errors import LinkError
from skygcs.rpc.address import default_socket_path
from skygcs.rpc.server import RpcServer
from skygcs.runtime.admission_reports import AdmissionReports
from skygcs.runtime.air_planner import AirPlanner
from skygcs.runtime.correction_feed import CorrectionFeed
from skygcs.runtime.event_log import EventLog
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.ground_orders import GroundOrders
from skygcs.runtime.hub import Hub
from skygcs.runtime.leftover_streams import WATCHED, LeftoverStreams
from skygcs.runtime.link_view import LinkView, LinkWatch
from skygcs.runtime.linktable import LinkTable
from skygcs.runtime.message_sender import MessageSender
from skygcs.runtime.operator_watchdog import OperatorWatchdog
from skygcs.runtime.param_cache import ParamCache, default_cache_dir
from skygcs.runtime.planning_queue import PlanningQueue
from skygcs.runtime.recorder import Recorder
from skygcs.runtime.renumbering import Renumbering
from skygcs.runtime.route_reports import RouteReports
from skygcs.runtime.signing_keys import Signing, SigningStore, default_state_dir
from skygcs.runtime.signing_setup import SigningSetup
from skygcs.runtime.vehicle_actor import VehicleActor

if TYPE_CHECKING:  # see above
    from skygcs.metrics.endpoint import MetricsEndpoint
    from skygcs.rpc.companion_parts import CompanionParts
    from skygcs.runtime.mocap_feed import MocapFeed
    from skygcs.runtime.web_child import WebChild

MAX_TOKEN_BYTES = 4096

HEARTBEAT_PERIOD_S = 1.0
"""MAVLink heartbeat protocol: 1 Hz; a SiK radio sends no RADIO_STATUS without it."""

GCS = 6
ONBOARD_COMPUTER = 18
"""MAV_TYPE of our heartbeats; a companion's must not look like a ground station's to the autopilot's failsafe."""

UNDO_S = 3.0
"""For what undoes itself when the daemon is stopped: five round trips of a nine-node radio. With PARK_S after it the
links are open for 5 s at most; what could not be undone by then is in the journal."""

NOTE_S = 0.5
"""For files that say what was not undone; the disk may be stuck."""

PARK_S = 2.0
"""Two transmissions of the order to hold; who stops the daemon is not to wait for a vehicle that does not answer."""

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
        self.hub = Hub(config, dialect, self.loop, publish, recorder=self.recorder, signing=self.signing)
        self.links = LinkTable(config, dialect, self.hub, self.loop, publish, self.signing)
        self.link_watch = LinkWatch(self.hub)
        self.third_party = AdmissionReports(self.hub, own, dialect, publish)
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
        reports = RouteReports(self.fleet, publish, own.route_timeout_s)
        self.hub.connect(self.fleet if own.keep_vehicles else None, reports)
        self.air = AirPlanner(self.hub, self.fleet, self.link_watch, dialect, publish)
        self.leftover_streams = LeftoverStreams(self.hub, self.fleet, dialect, own.route_timeout_s, publish)
        self.mocap = self._mocap_feed(view)
        dead_man = DeadMan(own.operator_timeout_s, own.operator_lost)
        self.operator_watchdog = OperatorWatchdog(dead_man, self.fleet, self.loop, publish)
        self.ground_orders = self._relayed_orders()
        self._observe()
        # what clients of the socket ask for
        self.renumbering = Renumbering(self.hub, self.fleet, self.loop, publish, source)
        self.signing_setup = SigningSetup(self.hub, self.fleet, self.signing, self.loop, publish)
        self.corrections = CorrectionFeed(self.hub, self.fleet, self.now)
        self.message_sender = MessageSender(self.hub, self.fleet, self.links, self.now)
        self.planning = PlanningQueue(self.loop, self.fleet.plans.processes.compute)
        self.socket_path = own.socket or default_socket_path()
        self.companions = self._companion_parts()
        tls = None if self.companions is None else self.companions.listener
        token = _read_token("daemon", own.token_file)
        self.rpc = RpcServer(self, self.socket_path, tcp_port=own.tcp_port, token=token, tls=tls)
        self.metrics = self._metrics_endpoint()
        self.web = self._web_child()

    def _companion_parts(self) -> CompanionParts | None:
        """The daemon's part as a companion, or towards companions; None without their tables."""
        if self.config.companion is None and self.config.companions is None:
            return None
        from skygcs.rpc.companion_parts import CompanionParts

        parts = CompanionParts(self.config, self.links, self.loop, self.event_log.publish, self.hub.fault)
        self.fleet.companions.update(parts.links.by_vehicle())
        return parts

    def _metrics_endpoint(self) -> MetricsEndpoint | None:
        """What Prometheus scrapes; None without [metrics]."""
        config = self.config.metrics
        if config is None:
            return None
        from skygcs.metrics.endpoint import MetricsEndpoint

        return MetricsEndpoint(config, _read_token("metrics", config.token_file), self.event_log, self.now)

    def _web_child(self) -> WebChild | None:
        """The process of the web page; None without [web]."""
        if self.config.web is None:
            return None
        from skygcs.runtime.web_child import WebChild

        return WebChild(self.config.web, self.socket_path, self.loop, self.event_log.publish)

    def _new_recorder(self) -> Recorder:
        own = self.config.daemon
        return Recorder(
            own.log_dir,
            max_bytes=int(own.record_max_mb * 1e6),
            max_age_s=own.record_max_minutes * 60.0,
            on_event=self.event_log.publish,
        )

    def _mocap_feed(self, view: LinkView) -> MocapFeed | None:
        """What feeds vehicles with poses; None without [mocap]."""
        config = self.config
        if config.mocap is None or not config.daemon.keep_vehicles:
            return None
        from skygcs.runtime.mocap_feed import MocapFeed

        feed = MocapFeed(config, self.hub, self.fleet, self.links, self.loop, self.event_log.publish)
        view.pose_bytes_per_s = feed.bytes_per_s
        return feed

    def _relayed_orders(self) -> GroundOrders | None:
        """What carries out a ground's orders of control; None unless this is a companion."""
        companion = self.config.companion
        if companion is None:
            return None
        lost, lost_s = companion.ground_lost, companion.ground_lost_s
        return GroundOrders(companion.vehicle, lost, lost_s, self.fleet, self.loop, self.event_log.publish)

    def _observe(self) -> None:
        """Give frames and events to what reads them."""
        known = set(self.dialect.messages)
        self.hub.add_observer({RADIO_STATUS, RADIO} & known, None, self.link_watch.on_radio)
        self.hub.add_observer(set(WATCHED) & known, None, self.leftover_streams.on_frame)
        if self.operator_watchdog.watching:
            self.hub.add_observer({HEARTBEAT}, None, self.operator_watchdog.on_frame)
        self.event_log.on("reboot", self.hub.on_reboot)
        self.event_log.on("reboot", self.leftover_streams.on_reboot)
        if self.ground_orders is not None:
            self.hub.add_observer({HEARTBEAT}, None, self.ground_orders.on_heartbeat)
        if self.mocap is not None:
            mocap = self.mocap
            self.event_log.on("reboot", mocap.on_reboot)
            self.event_log.on("vehicle_discovered", lambda event: mocap.refresh())  # it may share a link with others

    # -- life

    async def run(self) -> None:
        """Run until `stop`. Raises LinkError/ConfigError-like SkygcsErrors only before `ready` is set."""
        self.rpc.claim()
        try:
            if self.metrics is not None:
                self.metrics.claim()
            self.fleet.undo.report()
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
            if self.metrics is not None:
                await self.metrics.close()
            await self.rpc.close()

    async def _run_inner(self) -> None:
        async with asyncio.TaskGroup() as group:
            clocks = [
                group.create_task(self._every(FLEET_TICK_S, lambda: self.fleet.tick(self.now())), name="fleet tick"),
                group.create_task(self._every(FLEET_TICK_S, self.event_log.tick), name="events"),
                group.create_task(self._every(1.0, lambda: self.hub.tick(self.now())), name="hub tick"),
                group.create_task(
                    self._every(LINK_CHOICE_S, lambda: self.hub.choose_links(self.now())), name="choice of links"
                ),
                group.create_task(self._every(1.0, lambda: self.link_watch.tick(self.now())), name="watch of links"),
                group.create_task(self._every(1.0, lambda: self.air.tick(self.now())), name="air plan"),
                group.create_task(self._every(0.1, lambda: self.air.step(self.now())), name="air requests"),
                group.create_task(self._every(1.0, self._tick_third_party), name="third-party traffic"),
                group.create_task(
                    self._every(1.0, lambda: self.operator_watchdog.tick(self.now())), name="operator watchdog"
                ),
            ]
            clocks.append(group.create_task(self.fleet.monitor.run(), name="monitor"))
            if self.ground_orders is not None:
                orders = self.ground_orders
                tick = self._every(FLEET_TICK_S, lambda: orders.tick(self.now()))
                clocks.append(group.create_task(tick, name="watch over the ground"))
            signing = group.create_task(self.signing.run(), name="signing")
            if self.config.daemon.heartbeat:
                heartbeat = self._every(HEARTBEAT_PERIOD_S, self._heartbeat_task)
                clocks.append(group.create_task(heartbeat, name="heartbeat"))
            self.links.start(group)
            if self.companions is not None:
                clocks.append(group.create_task(self.companions.run(), name="companions"))
            if self.mocap is not None:
                from skygcs.runtime.mocap_feed import TICK_S

                mocap = self.mocap
                clocks.append(group.create_task(mocap.run(), name="motion capture"))
                tick = self._every(TICK_S, lambda: mocap.tick(self.now()))
                clocks.append(group.create_task(tick, name="motion capture tick"))
            try:
                await self.rpc.start()  # after the links: a restart in flight forwards first
                if self.metrics is not None:
                    await self.metrics.start(self)
                self.ready.set()
                if self.web is not None:
                    clocks.append(group.create_task(self.web.run(), name="web page"))
                await self._stopping.wait()
                await self.fleet.wind_down(UNDO_S)  # while the links are open
                await self._park()
            finally:  # also if a part of the daemon has failed: nothing flies on then
                for clock in clocks:
                    clock.cancel()
                if self.mocap is not None:
                    self.mocap.close()
                self.operator_watchdog.close()
                if self.ground_orders is not None:
                    self.ground_orders.close()
                self.planning.close()
                self.fleet.close()  # orders in progress end, and report so, before the links are gone
                await self.fleet.ended(NOTE_S)
                await self.fleet.plans.processes.close()
            await self.links.close()
            signing.cancel()  # after the last message that was signed

    async def _park(self) -> None:
        """Order vehicles that are flown by setpoints to hold before these stop: an ArduCopter in attitude control would
        only level."""
        flown = [actor.name for actor in self.fleet.flown() if actor.offboard.sends_setpoints]
        if flown:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(PARK_S):
                    await self.fleet.command_all(flown, VehicleActor.hold)

    async def reload(self, config: FleetConfig) -> list[str]:
        """Apply another version of the fleet file: links that differ are closed, changed or opened, all others go on.
        Returns a line for each difference; those beyond links are named, and need a restart."""
        before, self._file_config = self._file_config, config
        lines = await self.links.replace(before.links, config.links)
        for table in type(config).model_fields:
            if table != "links" and getattr(before, table) != getattr(config, table):
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
        kind = GCS if self.config.companion is None else ONBOARD_COMPUTER
        values = {"type": kind, "autopilot": 8, "base_mode": 0, "system_status": 4, "mavlink_version": 3}
        self.hub.send_heartbeat(self.dialect.find("HEARTBEAT"), values)

    # -- what a person asks

    def _tick_operator(self) -> None:
        self.operator_watchdog.tick(self.now())

    def _tick_third_party(self) -> None:
        self.third_party.tick(self.now())
        self.leftover_streams.tick(self.now())

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
            "clients": self.rpc.stats(),
            "web": None if self.web is None else self.web.status(),
            "companion_of": None if self.config.companion is None else self.config.companion.vehicle,
            "to_undo": len(self.fleet.journal.left()),
        }

    def companions_status(self) -> dict[str, Any]:
        """For companions.status."""
        unconfigured: dict[str, Any] = {"companions": [], "companion": None, "announced": None, "problem": None}
        return unconfigured if self.companions is None else self.companions.status()

    def mocap_status(self) -> dict[str, Any]:
        """For mocap.status."""
        unconfigured: dict[str, Any] = {"configured": False, "vehicles": [], "bodies_seen": {}}
        return unconfigured if self.mocap is None else self.mocap.status()


def _read_token(table: str, path: Path | None) -> str | None:
    """The token of a table of the fleet file; raises LinkError if the file is missing, empty or readable by others."""
    if path is None:
        return None
    try:
        with open_regular(path) as file:
            mode = os.fstat(file.fileno()).st_mode
            token = file.read(MAX_TOKEN_BYTES).decode().strip()
    except OSError as error:
        raise LinkError(f"{table}.token_file {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise LinkError(f"{table}.token_file {path}: is not text") from None
    if mode & 0o077:
        raise LinkError(f"{table}.token_file {path}: others can read it; chmod 600 {path}")
    if len(token) < 16:
        raise LinkError(f"{table}.token_file {path}: the token needs at least 16 characters")
    return token
