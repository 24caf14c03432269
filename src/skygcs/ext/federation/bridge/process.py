"""`skygcs federation run`: makes the parts of the bridge, runs them, and handles signals.

Each part runs in a task of its own. A part that fails is reported and run again after a pause; the others go on.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import secrets
import socket
import ssl
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skygcs import __version__
from skygcs.back_off import BackOff
from skygcs.config.models import FleetConfig
from skygcs.config.station_path import station_socket
from skygcs.ending_signals import ending_signals
from skygcs.errors import ConfigError, SkygcsError
from skygcs.events import Event
from skygcs.ext.federation.bridge.bus import Bus, BusOptions
from skygcs.ext.federation.bridge.nkeys_files import read_seed
from skygcs.ext.federation.bridge.one_bridge import OneBridge
from skygcs.ext.federation.bridge.station import Part, Reports, Station
from skygcs.ext.federation.config import FederationConfig, FederationMetricsConfig
from skygcs.ext.federation.protocol.bridge_election import BridgeElection, BridgeState

if TYPE_CHECKING:  # each is imported by the stations that have it
    from skygcs.ext.federation.bridge.publisher import Publisher
    from skygcs.ext.federation.bridge.station_view import StationView
    from skygcs.ext.federation.protocol.own_states import OwnStates
    from skygcs.ext.federation.protocol.remote_sites import RemoteSites

RUN_ID_BYTES = 8
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
"""Pause before a part that failed is run again, doubling."""

ONE_BRIDGE = "one bridge"
SITE_PARTS = frozenset({"publisher", "conflicts", "orders of other stations", "logs"})
"""They act under the site's name: they run while this is the site's active bridge."""

LEASES = "leases"
"""It goes on without a hub, also before one was there; so it runs unless another bridge is active."""

STEADY_S = 30.0
"""After a part has run for this time its pause begins with FIRST_PAUSE_S again."""

CANCEL_AGAIN_S = 0.5
"""Pause before a task that did not end is cancelled again."""


@dataclass(frozen=True, slots=True)
class FederationOptions:
    """Options of the process."""

    daemon_address: str
    """Address of the station's daemon; the station socket is in the same folder."""
    daemon_token: str | None = None
    with_daemon: bool = True
    """False for a station without a daemon, such as an observer's laptop."""
    supervised: bool = False
    """True if a daemon started it: the process ends when its standard input ends."""


class FederationProcess:
    """The bridge. `run` returns after `stop`."""

    def __init__(self, fleet: FleetConfig, options: FederationOptions) -> None:
        table = fleet.extensions.get("federation")
        if not isinstance(table, FederationConfig):
            raise ConfigError("federation", ["the fleet file has no table [federation]"])
        self.options = options
        self.config = table
        self.report = Reports()
        loop = asyncio.get_running_loop()
        name = self.config.site or socket.gethostname().partition(".")[0].lower()
        self.bus = Bus(bus_options(self.config, name), loop, self.report)
        self.station = Station(
            config=self.config,
            fleet=fleet,
            name=name,
            run_id=secrets.token_hex(RUN_ID_BYTES),
            bus=self.bus,
            daemon_address=options.daemon_address if options.with_daemon else None,
            daemon_token=options.daemon_token,
            socket_path=_station_socket(options.daemon_address),
            loop=loop,
            report=self.report,
        )
        self.station.methods["federation.status"] = self._status
        self.parts = make_parts(self.station)
        self._stopping = asyncio.Event()
        self._acting: dict[str, asyncio.Task[None]] = {}
        """Parts that act under the site's name, while they run."""

    async def _status(self, _: dict[str, Any]) -> dict[str, Any]:
        """This bridge: version, names, the connection to the hub, counters."""
        return self.status()

    def status(self) -> dict[str, Any]:
        """Status for federation.status, JSON-able."""
        return {
            "version": __version__,
            "pid": os.getpid(),
            "station": self.station.name,
            "site": self.station.site,
            "role": self.config.role,
            "run": self.station.run_id,
            "daemon": self.station.daemon_address,
            "hub": self.bus.status(),
            "parts": {name: part.status() for name, part in self.parts.items()},
        }

    async def run(self, on_ready: Callable[[FederationProcess], None] | None = None) -> None:
        """Run all parts until `stop`. ``on_ready``: called once when they have been started."""
        parts = {name: part for name, part in self.parts.items() if not self._acts_as_site(name)}
        tasks = [asyncio.create_task(self._part(name, part), name=name) for name, part in parts.items()]
        tasks.append(asyncio.create_task(self._act_as_site(), name="acting as the site"))
        tasks.append(asyncio.create_task(self.bus.run(), name="hub"))
        stopping = asyncio.create_task(self._stopping.wait(), name="stop")
        try:
            if on_ready is not None:
                on_ready(self)
            await asyncio.wait({stopping, *tasks}, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                if task.done():
                    task.result()
        finally:
            stopping.cancel()
            # the parts first: leases are released while the hub is connected
            await cancelled([*tasks[:-1], *self._acting.values()])
            await cancelled(tasks[-1:])

    def _acts_as_site(self, name: str) -> bool:
        return ONE_BRIDGE in self.parts and (name in SITE_PARTS or name == LEASES)

    async def _act_as_site(self) -> None:
        """Run the parts that act under the site's name as long as no other bridge does."""
        one = self.parts.get(ONE_BRIDGE)
        if not isinstance(one, OneBridge):
            await asyncio.Event().wait()
            return
        changed = asyncio.Event()
        one.on_change = changed.set
        while True:
            changed.clear()
            wanted = set()
            if one.state is BridgeState.ACTIVE:
                wanted = {name for name in self.parts if self._acts_as_site(name)}
            elif one.state is BridgeState.ASKING and LEASES in self.parts:
                wanted = {LEASES}
            unwanted = set(self._acting) - wanted
            await cancelled([self._acting[name] for name in unwanted])
            for name in unwanted:
                del self._acting[name]
            for name in wanted - set(self._acting):
                self._acting[name] = asyncio.create_task(self._part(name, self.parts[name]), name=name)
            await changed.wait()

    async def _part(self, name: str, part: Part) -> None:
        """Run one part without end."""
        back_off = BackOff(FIRST_PAUSE_S, LONGEST_PAUSE_S, STEADY_S)
        while True:
            began = self.station.now()
            try:
                await part.run()
                reason = "it has ended"
            except SkygcsError as error:
                reason = str(error)
            except Exception as error:
                reason = f"{type(error).__name__}: {error}"
            pause_s = back_off.after(self.station.now() - began)
            text = f"federation: {name} has failed ({reason}); it is run again in {pause_s:g} s"
            self.report(Event("fault", None, None, text, {"part": name, "reason": reason}))
            await asyncio.sleep(pause_s)

    def stop(self) -> None:
        """End `run`. Idempotent; safe as a signal handler of the loop."""
        self._stopping.set()


async def cancelled(tasks: Sequence[asyncio.Task[Any]]) -> None:
    """Cancel tasks until all have ended. A single cancellation can be lost: a TaskGroup that fails at that moment, for
    example because the daemon ends, raises the errors of its tasks instead, and nats-py returns the answer that arrives
    while it connects."""
    waiting = set(tasks)
    while waiting:
        for task in waiting:
            task.cancel()
        _, waiting = await asyncio.wait(waiting, timeout=CANCEL_AGAIN_S)


def make_parts(station: Station) -> dict[str, Part]:
    """The parts of this station by name, in the order in which they are started. A part is imported only by stations
    that have it.

    A site with a daemon has all parts; an operator and an observer only those that read other sites and send requests
    to them.
    """
    from skygcs.ext.federation.bridge.orders_sent import OrdersSent
    from skygcs.ext.federation.bridge.readers import Readers
    from skygcs.ext.federation.bridge.station_methods import OUTCOME
    from skygcs.ext.federation.bridge.station_view import StationView
    from skygcs.ext.federation.protocol.remote_sites import RemoteSites

    parts: dict[str, Part] = {}
    sites = RemoteSites(station.site, station.run_id)
    subscribe_hz = station.config.subscribe_hz
    readers = Readers(station.bus, sites, station.clock, own_site=station.site, subscribe_hz=subscribe_hz)
    parts["readers"] = readers
    parts["station socket"] = view = StationView(station, sites, readers)  # for CLI, page and programs
    orders = OrdersSent(station.name, station.config.role, station.bus, sites, station.loop, clock=station.clock.now_s)
    parts["orders to other sites"] = view.orders = orders
    station.methods[OUTCOME] = orders.answer_outcome
    if station.site is not None and (link := station.daemon_link("publisher")) is not None:
        from skygcs.ext.federation.bridge.logs import SiteLogs
        from skygcs.ext.federation.bridge.orders_part import OrdersTakenPart
        from skygcs.ext.federation.bridge.publisher import Publisher
        from skygcs.ext.federation.protocol.own_states import OwnStates

        rate_hz, share = station.config.rate_hz, station.config.share
        states = OwnStates(station.site, station.run_id, 1.0 / rate_hz, share)
        election = BridgeElection(station.run_id, socket.gethostname(), os.getpid())
        parts[ONE_BRIDGE] = one = OneBridge(station.bus, station.site, election, station.clock.now_s, station.report)
        view.one_bridge = one.status
        parts["publisher"] = publisher = Publisher(station.bus, link, station.clock, states, rate_hz)
        if station.fleet.monitor.mode != "off":
            parts["conflicts"] = _conflict_watch(station, states, sites, view, publisher)
        taken = parts["orders of other stations"] = OrdersTakenPart(station, station.site, link.address, states, sites)
        taken.others_took_orders = lambda: one.stood_by
        if station.config.vehicles and (daemon := station.daemon_link("leases")) is not None:
            from skygcs.ext.federation.bridge.leases import Leases

            leases = parts[LEASES] = Leases(station, daemon)
            leases.why_standby = one.why_standby
            publisher.lease_of, taken.not_held = leases.lease_of, leases.not_held
        parts["logs"] = SiteLogs(station.bus, station.site, station.run_id, station.fleet.daemon.log_dir)
    if station.config.metrics is not None:
        parts["metrics"] = _metrics(station.config.metrics, station, sites, parts)
    return parts


def _metrics(config: FederationMetricsConfig, station: Station, sites: RemoteSites, parts: dict[str, Part]) -> Part:
    """The part that serves metrics for Prometheus. Raises ConfigError if prometheus-client is not installed."""
    try:
        from skygcs.ext.federation.bridge.metrics import FederationMetrics
    except ModuleNotFoundError:
        raise ConfigError("federation.metrics", ["needs prometheus-client: pip install 'skygcs[metrics]'"]) from None
    return FederationMetrics(config, station, sites, parts)


def _conflict_watch(
    station: Station, states: OwnStates, sites: RemoteSites, view: StationView, publisher: Publisher
) -> Part:
    """The part that watches our vehicles against those of other sites."""
    from skygcs.ext.federation.bridge.conflict_watch import ConflictWatch

    async def send(event: Event, record: Mapping[str, Any]) -> None:
        station.report(event)
        view.show_event(record)
        await publisher.send_event(record)

    watch = ConflictWatch(station.fleet, states, sites, station.clock.now_s, send)
    view.conflicts = watch.described
    return watch


def bus_options(config: FederationConfig, name: str) -> BusOptions:
    """The options of the connection to the hub. Raises ConfigError, also for the key file."""
    key = read_seed(config.nkey)
    return BusOptions(config.servers, key.seed, key.public_key, tls_context(config), f"skygcs {config.role} {name}")


def tls_context(config: FederationConfig) -> ssl.SSLContext | None:
    """The TLS context of the connections to the hub; None if no server of the list uses TLS. Raises ConfigError for
    files that cannot be used."""
    if not config.uses_tls:
        return None
    try:
        context = ssl.create_default_context(cafile=None if config.ca is None else os.fspath(config.ca))
    except (OSError, ssl.SSLError) as error:
        raise ConfigError("federation.ca", [f"{config.ca}: {_file_reason(error)}"]) from None
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if config.cert is not None:
        try:
            context.load_cert_chain(config.cert, config.key)
        except (OSError, ssl.SSLError) as error:
            raise ConfigError("federation.cert", [f"{config.cert}, {config.key}: {_file_reason(error)}"]) from None
    return context


def _file_reason(error: OSError) -> str:
    return error.strerror or str(error) if not isinstance(error, ssl.SSLError) else f"no PEM file: {error.reason}"


def _station_socket(daemon_address: str) -> Path:
    from skygcs.rpc.address import default_socket_path

    return Path(station_socket(str(default_socket_path()) if "://" in daemon_address else daemon_address))


async def serve_federation(fleet: FleetConfig, options: FederationOptions) -> None:
    """Run the process until one of `ending_signals`."""
    process = FederationProcess(fleet, options)
    loop = asyncio.get_running_loop()
    for number in ending_signals():
        loop.add_signal_handler(number, process.stop)
    if options.supervised:
        loop.add_reader(sys.stdin, _on_input, loop, process)
    try:
        await process.run(_freeze)
    finally:
        if options.supervised:
            with contextlib.suppress(OSError, ValueError):
                loop.remove_reader(sys.stdin)


def _freeze(_: FederationProcess) -> None:
    """Exclude the objects of the modules, which stay until the end, from garbage collection: a full one would take
    25 ms longer each time."""
    gc.collect()
    gc.freeze()


def _on_input(loop: asyncio.AbstractEventLoop, process: FederationProcess) -> None:
    """Stop when standard input is closed: the daemon has ended or was killed."""
    if not os.read(sys.stdin.fileno(), 4096):
        loop.remove_reader(sys.stdin)
        process.stop()
