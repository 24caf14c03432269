"""Composition root: config -> objects -> task groups; ordered shutdown.

Two nested groups: the inner one runs links and clocks, the outer one the recorder and the RPC server. A stop ends the
inner group first, so that what links did last is still recorded and told.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path
from typing import Any

import structlog

from skygcs import __version__
from skygcs.config.endpoints import endpoint_text
from skygcs.config.models import FleetConfig
from skygcs.config.regular_file import open_regular
from skygcs.core.control.deadman import DeadMan
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import HEARTBEAT, RADIO, RADIO_STATUS
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.routing.decision import RouteNote
from skygcs.core.routing.table_room import MAX_CHANNEL_ROUTES, MAX_LINK_ROUTES
from skygcs.core.vehicle.event_limiter import EventLimiter
from skygcs.errors import LinkError
from skygcs.events import Event
from skygcs.links.base import Channel
from skygcs.rpc.address import default_socket_path
from skygcs.rpc.server import RpcServer
from skygcs.runtime.admission_reports import AdmissionReports
from skygcs.runtime.air_planner import AirPlanner
from skygcs.runtime.correction_feed import CorrectionFeed
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.leftover_streams import WATCHED, LeftoverStreams
from skygcs.runtime.link_watch import LinkWatch
from skygcs.runtime.linktable import LinkTable
from skygcs.runtime.message_sender import MessageSender
from skygcs.runtime.operator_watchdog import OperatorWatchdog
from skygcs.runtime.param_cache import ParamCache, default_cache_dir
from skygcs.runtime.recorder import Recorder
from skygcs.runtime.renumbering import Renumbering
from skygcs.runtime.signing_keys import Signing, why_silent
from skygcs.runtime.signing_setup import SigningSetup
from skygcs.runtime.signing_store import SigningStore, default_state_dir
from skygcs.runtime.uplink import setpoint_bytes_per_s, stream_refusal
from skygcs.runtime.vehicle_actor import VehicleActor

MAX_EVENTS = 1000
"""Events kept for `events.recent`: an hour of a chatty fleet; each is some 300 bytes."""

MAX_TOKEN_BYTES = 4096

HEARTBEAT_PERIOD_S = 1.0
"""MAVLink heartbeat protocol: 1 Hz; a SiK radio sends no RADIO_STATUS without it."""

UNDO_S = 3.0
"""For what undoes itself when the daemon is stopped: five round trips of a nine-node radio. With PARK_S after it the
links are open for 5 s at most; what could not be undone by then is in the journal."""

NOTE_S = 0.5
"""For files that say what was not undone; the disk may be stuck."""

PARK_S = 2.0
"""Two transmissions of the order to hold; who stops the daemon is not to wait for a vehicle that does not answer."""

FLEET_TICK_S = 0.2
"""How late a lost vehicle may be noticed; its timeout is seconds."""

log = structlog.get_logger("skygcs")

_QUIET_KINDS = frozenset({"statustext", "command", "route"})
"""Events that are told to subscribers and logged at debug or info, not as changes of the daemon's own state."""

_NOTE_KINDS = {
    "conflict": "conflict",
    "out_of_bounds": "warning",
    "crowded": "warning",
    "crowded_over": "warning",
}


_STATE_NOTES = {
    "duplicate": "duplicate",
    "duplicate_over": "duplicate",
    "ignored": "conflict",
    "switched": "route",
    "replaced": "conflict",
}


def _named(channel: Channel | None) -> str:
    """A channel for a person: its link and the peer's address."""
    return "a closed channel" if channel is None else f"{channel.link.name} ({channel.peer})"


def _state_text(note: RouteNote, here: str, there: str) -> str:
    """What a person is shown of a change of a vehicle's channels: ``here`` is the present one, ``there`` the other."""
    ids = f"{note.sysid}/{note.compid}"
    if note.kind == "duplicate":
        return (
            f"two vehicles with system id {note.sysid} are on the air: one over {here}, which supplies its state, "
            f"another over {there} ({note.why}), which is ignored; until that ends it takes only hold, land, rtl and "
            "stop, which go to both, and a confirmed disarm; switch one off and give it another id (PX4: MAV_SYS_ID, "
            "ArduPilot: SYSID_THISMAV)"
        )
    if note.kind == "duplicate_over":
        return f"only one vehicle with system id {note.sysid} is heard any more: it takes all orders again"
    if note.kind == "ignored":
        return (
            f"{note.count} frames with the ids {ids} over {there} contradict the vehicle over {here} ({note.why}): "
            "they are ignored"
        )
    if note.kind == "switched":
        return f"{ids} is followed over {there} now, before over {here}"
    return (
        f"{ids} is another vehicle now, or has restarted: it is heard over {there}, before over {here}; nothing that "
        "was known of it counts any more"
    )


def _is_warning(event: Event) -> bool:
    """True for what a person should look at although the daemon goes on: a link that is down (not one that has come to
    its end), an internal fault, a warning."""
    return event.kind in ("warning", "fault", "undo", "uplink_lost") or (
        event.kind == "link_down" and not event.data.get("finished")
    )


class Daemon:
    """One running skygcs. `run` until `stop`; the rest answers the RPC methods (loop thread only)."""

    def __init__(self, config: FleetConfig, dialect: Dialect, *, source: str = "<built in>") -> None:
        self.config = config
        self.dialect = dialect
        self.source = source
        self.loop = asyncio.get_running_loop()
        self.started_at = self.loop.time()
        self.events: deque[dict[str, Any]] = deque(maxlen=MAX_EVENTS)
        self.ready = asyncio.Event()
        self._stopping = asyncio.Event()
        self._event_watchers: list[Callable[[dict[str, Any]], None]] = []
        self._event_limiter = EventLimiter()
        own = config.daemon
        self.recorder: Recorder | None = None
        if own.record:
            self.recorder = Recorder(
                own.log_dir,
                max_bytes=int(own.record_max_mb * 1e6),
                max_age_s=own.record_max_minutes * 60.0,
                on_event=self.on_event,
            )
        self.fleet = Fleet(
            config,
            dialect,
            self._send,
            self.loop,
            self.on_event,
            self._may_broadcast,
            lambda sysid, compid: setpoint_bytes_per_s(self.hub, self.fleet, sysid, compid),
            lambda sysid, compid, px4: stream_refusal(self.hub, self.fleet, sysid, compid, px4=px4),
            ParamCache(default_cache_dir()),
            lambda key: self.link_watch.of(key, self.now()),
            probes=own.heartbeat,
        )
        self.signing = Signing(dialect, self.on_event, SigningStore(default_state_dir()))
        self.hub = Hub(
            config,
            dialect,
            self.loop,
            on_vehicle_frame=self.fleet.on_frame if own.keep_vehicles else None,
            record=self.recorder.offer if self.recorder is not None else None,
            on_note=self._on_note,
            on_fault=self._on_fault,
            on_replayed=self.fleet.set_replayed,
            signing=self.signing,
            on_key=self._on_key,
            record_many=self.recorder.offer_many if self.recorder is not None else None,
            state_update_only=self.fleet.state_update_only,
            on_event=self.on_event,
        )
        self.hub.router.known = self.fleet.known
        self.hub.router.on_replaced = self.fleet.replaced
        self.link_watch = LinkWatch(self.hub)
        self.hub.add_observer({RADIO_STATUS, RADIO} & set(dialect.messages), None, self.link_watch.on_radio)
        self.fleet.on_roster = self.hub.forget_flows
        self.fleet.why_silent = self._why_silent
        self.operator_watchdog = OperatorWatchdog(
            DeadMan(own.operator_timeout_s, own.operator_lost), self.fleet, self.loop, self.on_event
        )
        if self.operator_watchdog.watching:
            self.hub.add_observer({HEARTBEAT}, None, self._on_heartbeat)
        self.air = AirPlanner(self.hub, self.fleet, self.link_watch, dialect, self.on_event)
        self.third_party = AdmissionReports(self.hub, own, dialect, self.on_event)
        self.leftover_streams = LeftoverStreams(self.hub, self.fleet, dialect, own.route_timeout_s, self.on_event)
        self.hub.add_observer(set(WATCHED) & set(dialect.messages), None, self.leftover_streams.on_frame)
        self.links = LinkTable(config, dialect, self.hub, self.loop, self.on_event, self.signing)
        self.renumbering = Renumbering(self.hub, self.fleet, self.loop, self.on_event, source)
        self.signing_setup = SigningSetup(self.hub, self.fleet, self.signing, self.loop, self.on_event)
        self._keys_told: set[str] = set()
        self._corrections = CorrectionFeed(self.hub, self.fleet, self.now)
        self._message_sender = MessageSender(self.hub, self.fleet, self.links, self.now)
        self.socket_path = own.socket or default_socket_path()
        self.rpc = RpcServer(self, self.socket_path, tcp_port=own.tcp_port, token=_read_token(own.token_file))

    # -- life

    async def run(self) -> None:
        """Run until `stop`. Raises LinkError/ConfigError-like SkygcsErrors only before `ready` is set."""
        self.rpc.claim()
        self.fleet.undo.report()
        try:
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
            self._publish_events(self._event_limiter.flush(self.now()))
            await self.rpc.close()

    async def _run_inner(self) -> None:
        async with asyncio.TaskGroup() as group:
            clocks = [
                group.create_task(self._every(FLEET_TICK_S, lambda: self.fleet.tick(self.now())), name="fleet tick"),
                group.create_task(self._every(FLEET_TICK_S, self._tick_events), name="events"),
                group.create_task(self._every(1.0, lambda: self.hub.tick(self.now())), name="hub tick"),
                group.create_task(self._every(1.0, lambda: self.link_watch.tick(self.now())), name="watch of links"),
                group.create_task(self._every(1.0, lambda: self.air.tick(self.now())), name="air plan"),
                group.create_task(self._every(0.1, lambda: self.air.step(self.now())), name="air requests"),
                group.create_task(self._every(1.0, self._tick_third_party), name="third-party traffic"),
                group.create_task(self._every(1.0, lambda: self.operator_watchdog.tick(self.now())), name="watchman"),
            ]
            signing = group.create_task(self.signing.run(), name="signing")
            if self.config.daemon.heartbeat:
                beat = self._every(HEARTBEAT_PERIOD_S, self._heartbeat_task)
                clocks.append(group.create_task(beat, name="heartbeat"))
            self.links.start(group)
            try:
                await self.rpc.start()  # after the links: a restart in flight forwards first
                self.ready.set()
                await self._stopping.wait()
                await self.fleet.wind_down(UNDO_S)  # while the links are open
                await self._park()
            finally:  # also if a part of the daemon has failed: nothing flies on then
                for clock in clocks:
                    clock.cancel()
                self.operator_watchdog.close()
                self.fleet.close()  # who waits for an outcome is told before the links are gone
                await self.fleet.ended(NOTE_S)
            await self.links.close()
            signing.cancel()  # after the last message that was signed

    async def _park(self) -> None:
        """Who is flown by setpoints is told to hold before they cease: an ArduCopter's attitude would only level."""
        flown = [actor.name for actor in self.fleet.flown()]
        if flown:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(PARK_S):
                    await self.fleet.command_all(flown, VehicleActor.hold)

    def stop(self) -> None:
        """End `run` in order. Idempotent; safe as a signal handler of the loop."""
        self._stopping.set()

    @property
    def stopping(self) -> bool:
        return self._stopping.is_set()

    async def stopped(self) -> None:
        """Wait until somebody asked the daemon to stop."""
        await self._stopping.wait()

    async def _every(self, period_s: float, action: Callable[[], None]) -> None:
        """One clock of the daemon. A fault behind one tick is told once and does not ground the fleet."""
        while True:
            try:
                action()
            except Exception as error:
                self.hub.fault(error)
            await asyncio.sleep(period_s)

    def _on_heartbeat(self, frame: Frame, channel: Channel, now: float) -> None:
        """The operator of a recording is nobody who watches."""
        if channel.config.type != "replay":
            self.operator_watchdog.on_heartbeat(frame, now)

    def _heartbeat_task(self) -> None:
        values = {"type": 6, "autopilot": 8, "base_mode": 0, "system_status": 4, "mavlink_version": 3}
        self.hub.send_heartbeat(self.dialect.find("HEARTBEAT"), values)

    # -- sending

    def _send(
        self,
        info: MessageInfo,
        values: Mapping[str, Any],
        sysid: int,
        compid: int,
        priority: Priority,
        /,
        *,
        everywhere: bool = False,
        key: Hashable | None = None,
    ) -> bool:
        return self.hub.send(info, values, sysid, compid, priority, key, everywhere=everywhere)

    def _why_silent(self, sysid: int, compid: int) -> str:
        actor = self.fleet.vehicles.get(sysid << 8 | compid)
        slot = None if actor is None else actor.vehicle.slots.get(HEARTBEAT)
        links = [self.hub.channels[i].config for i in self.hub.ways(sysid, compid)]
        return why_silent(None if slot is None else slot.frame, links)

    def _may_broadcast(self) -> bool:
        """False if a link does not take frames of every source: who is kept out there would still hear us."""
        return not any(
            link.enabled
            and (link.allow_src_sys_in or link.block_src_sys_in or link.allow_src_comp_in or link.block_src_comp_in)
            for link in self.links.configs.values()
        )

    def send_message(
        self,
        name: str,
        fields: Mapping[str, Any],
        target: str | list[str] | None = None,
        link: str | None = None,
        *,
        force: bool = False,
    ) -> dict[str, Any]:
        """Any message of the dialect by name; see `MessageSender.send`."""
        return self._message_sender.send(name, fields, target, link, force=force)

    # -- events

    def on_event(self, event: Event) -> None:
        """Act on it, and publish it unless too many of its kind came (`EventLimiter`)."""
        if event.kind == "reboot" and event.sysid is not None:
            for key in [k for k in self.fleet.vehicles if k >> 8 == event.sysid]:
                self.hub.restart_source(key)
                self.leftover_streams.forget(key)
        self._publish_events(self._event_limiter.offer(event, self.now()))

    def _tick_third_party(self) -> None:
        self.third_party.tick(self.now())
        self.leftover_streams.tick(self.now())

    def _tick_events(self) -> None:
        self._publish_events(self._event_limiter.tick(self.now()))

    def _publish_events(self, events: Iterable[Event]) -> None:
        for event in events:
            self._publish_event(event)

    def _publish_event(self, event: Event) -> None:
        """Log it, keep it, show it to the watchers. A watcher's fault is its own."""
        record = {
            "time_unix_s": round(time.time(), 3),
            "kind": event.kind,
            "vehicle": event.vehicle,
            "sysid": event.sysid,
            "text": event.text,
            "data": event.data,
        }
        self.events.append(record)
        level = log.debug if event.kind in _QUIET_KINDS else log.warning if _is_warning(event) else log.info
        level(event.text, kind=event.kind, **({"vehicle": event.vehicle} if event.vehicle else {}))
        for watcher in tuple(self._event_watchers):
            try:
                watcher(record)
            except Exception as error:
                self._event_watchers.remove(watcher)
                log.error("an event watcher failed and was removed", error=repr(error))

    def _on_note(self, note: RouteNote, channel: Channel | None) -> None:
        if note.kind in _STATE_NOTES:
            self._on_state_note(note, channel)
            return
        where, who = _named(channel), f"{note.sysid}/{note.compid}"
        recorded = channel is not None and channel.config.type == "replay"
        text = {
            "out_of_bounds": _beyond(note, where, channel),
            "learned": f"{who} heard on {where}",
            "expired": f"{who} not heard on {where} for {self.config.daemon.route_timeout_s:g} s, route forgotten",
            "cleared": f"{who} restarted (SYSTEM_TIME went back), its routes are learned anew",
            "crowded": f"{where} has no room for a route to {who}: more sources were heard there, or on its link, than "
            f"the {MAX_CHANNEL_ROUTES} ({MAX_LINK_ROUTES}) that are kept; only autopilots find room, in place "
            "of others; other links are not affected; allow_from or signing keep strangers out",
            "crowded_over": f"{where}: the link has room for further routes again",
            "conflict": f"{where} sends frames with our own id {who}: they are dropped; "
            "give one of the two another daemon.sysid or daemon.compid",
            "echo": f"{who} in the recording {where} is heard live as well: the recorded one is not shown"
            if recorded
            else f"{where} hands back frames of {who}, which is heard on a link of its own: they are dropped",
        }[note.kind]
        kind = _NOTE_KINDS.get(note.kind, "route")
        self.on_event(Event(kind, None, note.sysid, text, {"change": note.kind, "compid": note.compid}))

    def _on_state_note(self, note: RouteNote, channel: Channel | None) -> None:
        """What has changed about the channels of a vehicle (`core.state_source`)."""
        key = note.sysid << 8 | note.compid
        there, here = _named(channel), _named(self.hub.channels.get(note.present_id))
        if note.kind in ("duplicate", "duplicate_over"):
            where = f"its state comes over {here}, the other one sends over {there}"
            self.fleet.set_duplicate(key, where if note.kind == "duplicate" else None)
        text = _state_text(note, here, there)
        data = {"change": note.kind, "compid": note.compid, "link": there, "present": here, "ignored": note.count}
        vehicle = self.fleet.vehicles.get(key)
        name = None if vehicle is None else vehicle.name
        self.on_event(Event(_STATE_NOTES[note.kind], name, note.sysid, text, data))

    def _on_key(self, sysid: int, channel: Channel) -> None:
        """Told once per link: who sends it will repeat it."""
        link = channel.link.name
        if link not in self._keys_told:
            self._keys_told.add(link)
            text = (
                f"{link} ({channel.peer}): system {sysid} sent a signing key (SETUP_SIGNING); keys are not forwarded: "
                "connect directly, or use skygcs-cli signing setup"
            )
            self.on_event(Event("signing", None, sysid, text, {"link": link}))

    def signing_status(self) -> dict[str, Any]:
        """Keys, links with their rules, and counters per channel."""
        channels: dict[str, list[Channel]] = {}
        for channel in self.hub.channels.values():
            channels.setdefault(channel.link.name, []).append(channel)
        return self.signing.status(channels)

    def _on_fault(self, text: str) -> None:
        self.on_event(Event("fault", None, None, f"internal fault, please report it: {text}", {}))

    def subscribe_events(self, watcher: Callable[[dict[str, Any]], None]) -> Callable[[], None]:
        """Call ``watcher`` with every event from now on; returns how to stop it."""
        self._event_watchers.append(watcher)

        def remove() -> None:
            if watcher in self._event_watchers:
                self._event_watchers.remove(watcher)

        return remove

    def subscribe_messages(
        self, names: set[str] | None, keys: set[int] | None, watcher: Callable[[Frame, Channel, float], None]
    ) -> Callable[[], None]:
        """Call ``watcher`` with every accepted frame of these names and sources; KeyError for an unknown name."""
        msgids = None if names is None else {self.dialect.find(n).msgid for n in names}
        return self.hub.add_observer(msgids, keys, watcher)

    # -- links

    async def add_link(self, name: str, link: Mapping[str, Any]) -> None:
        """See `LinkTable.add`."""
        await self.links.add(name, link)

    async def change_link(self, name: str, link: Mapping[str, Any]) -> None:
        """See `LinkTable.change`."""
        await self.links.change(name, link)

    async def remove_link(self, name: str) -> None:
        """See `LinkTable.remove`."""
        await self.links.remove(name)

    def client_alive(self) -> None:
        """A client of the socket asked for something."""
        self.operator_watchdog.on_client()

    # -- what a person asks

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
            "uptime_s": round(self.now() - self.started_at, 1),
            "vehicles": len(self.fleet.vehicles),
            "faults": self.hub.faults,
            "clients": self.rpc.stats(),
            "to_undo": len(self.fleet.journal.left()),
        }

    def air_status(self) -> list[dict[str, Any]]:
        """See `AirPlanner.status`."""
        return self.air.status(self.now())

    def select_vehicles(self, keys: set[int]) -> None:
        """See `AirPlanner.select`."""
        self.air.select(keys)

    def send_corrections(self, source: str, data: bytes, *, end: bool = False) -> dict[str, Any]:
        """See `CorrectionFeed.send`."""
        return self._corrections.send(source, data, end=end)

    def corrections_status(self) -> dict[str, Any]:
        """See `CorrectionFeed.status`."""
        return self._corrections.status()

    def open_links(self) -> list[str]:
        """Names of the links that are open now."""
        return self.links.open_names()

    def links_status(self) -> list[dict[str, Any]]:
        """Every link with its state, channels, counters and sources."""
        now = self.now()
        self.hub.after_fast_path()
        return self.links.status(now, lambda channel: self._channel_status(channel, now))

    def _channel_status(self, channel: Channel, now: float) -> dict[str, Any]:
        return {
            "id": channel.id,
            "peer": channel.peer,
            "last_rx_age_s": round(now - channel.last_rx_at, 2),
            **channel.counters(),
            **self.hub.router.port_counters(channel.id),
            "sources": {
                f"{key >> 8}/{key & 0xFF}" if key >= 0 else "others": stats.as_dict(now)
                for key, stats in channel.sources.items()
            },
        }

    def link_quality(self, key: int) -> dict[str, Any]:
        """Per link on which this (sysid<<8|compid) is heard: loss and rate. Of several peers of one link those of the
        one that supplies its state."""
        found = {}
        for channel_id in self.hub.router.channels_of(key):
            channel = self.hub.channels[channel_id]
            stats = channel.sources.get(key)
            if stats is not None and channel.link.name not in found:
                found[channel.link.name] = stats.as_dict(self.now())
                if channel.config.type == "replay":
                    found[channel.link.name]["replayed"] = True
        return found

    def router_stats(self) -> dict[str, Any]:
        """Counters of decisions and the route table."""
        self.hub.after_fast_path()
        router = self.hub.router
        now = self.now()
        return {
            "counters": {verdict.value: count for verdict, count in router.counters.items()},
            "refused_routes": router.refused_routes,
            "evicted_routes": router.evicted_routes,
            "unnoted_routes": router.unnoted_routes,
            "routes": [
                {
                    "sysid": sysid,
                    "compid": compid,
                    "link": self.hub.channels[cid].link.name,
                    "peer": self.hub.channels[cid].peer,
                    "age_s": round(now - at, 2),
                }
                for sysid, compid, cid, at in router.routes()
                if cid in self.hub.channels
            ],
        }

    def recorder_status(self) -> dict[str, Any]:
        if self.recorder is None:
            return {"recording": False}
        return self.recorder.status()


def _beyond(note: RouteNote, where: str, channel: Channel | None) -> str:
    """What is told of a program behind a bound link that addressed somebody else; in the ids that it knows."""
    if channel is None or channel.endpoint is None:
        return f"{where} addressed a system that its link is not bound to"
    turned = channel.endpoint.turned
    allowed = ", ".join(str(turned(sysid)) for sysid in sorted(channel.endpoint.vehicles))
    meant = f"system {turned(note.target)}" if note.target else "all systems (target 0)"
    return (
        f"{where}: {turned(note.sysid)}/{note.compid} addressed {meant}, and this link is bound to "
        f"{endpoint_text(channel.config)}: dropped, as all such frames; what may be addressed there: {allowed}"
    )


def _read_token(path: Path | None) -> str | None:
    """The RPC token; raises LinkError if the file is missing, empty or readable by others."""
    if path is None:
        return None
    try:
        with open_regular(path) as file:
            mode = os.fstat(file.fileno()).st_mode
            token = file.read(MAX_TOKEN_BYTES).decode().strip()
    except OSError as error:
        raise LinkError(f"daemon.token_file {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise LinkError(f"daemon.token_file {path}: is not text") from None
    if mode & 0o077:
        raise LinkError(f"daemon.token_file {path}: others can read it; chmod 600 {path}")
    if len(token) < 16:
        raise LinkError(f"daemon.token_file {path}: the token needs at least 16 characters")
    return token
