"""Composition root: config -> objects -> task groups; ordered shutdown.

Two nested groups: the inner one runs links and clocks, the outer one the recorder and the RPC server. A stop ends the
inner group first, so that what links did last is still recorded and told.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import structlog

from skygcs import __version__
from skygcs.config.loader import parse_link
from skygcs.config.models import FleetConfig, LinkConfig
from skygcs.core.airtime import Priority
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.core.routing import RouteNote
from skygcs.core.vehicle.events import Event
from skygcs.errors import ConfigError, LinkError, RefusedError
from skygcs.links.base import Channel
from skygcs.links.factory import make_link
from skygcs.links.supervisor import LinkSupervisor
from skygcs.rpc.address import default_socket_path
from skygcs.rpc.server import RpcServer
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.recorder import Recorder

MAX_EVENTS = 1000
"""Events kept for `events.recent`: an hour of a chatty fleet; each is some 300 bytes."""

HEARTBEAT_PERIOD_S = 1.0
"""MAVLink heartbeat protocol: 1 Hz; a SiK radio sends no RADIO_STATUS without it."""

FLEET_TICK_S = 0.2
"""How late a lost vehicle may be noticed; its timeout is seconds."""

log = structlog.get_logger("skygcs")

_QUIET_KINDS = frozenset({"statustext", "command", "route"})
"""Events that are told to subscribers and logged at debug or info, not as changes of the daemon's own state."""


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
        self._links: dict[str, tuple[LinkSupervisor, asyncio.Task[None]]] = {}
        self._link_group: asyncio.TaskGroup | None = None
        own = config.daemon
        self.recorder: Recorder | None = None
        if own.record:
            self.recorder = Recorder(
                own.log_dir,
                max_bytes=int(own.record_max_mb * 1e6),
                max_age_s=own.record_max_minutes * 60.0,
                on_event=self.on_event,
            )
        self.fleet = Fleet(config, dialect, self._send, self.loop, self.on_event)
        self.hub = Hub(
            config,
            dialect,
            self.loop,
            on_vehicle_frame=self.fleet.on_frame,
            record=self.recorder.offer if self.recorder is not None else None,
            on_note=self._on_note,
            on_fault=self._on_fault,
        )
        self.socket_path = own.socket or default_socket_path()
        self.rpc = RpcServer(self, self.socket_path, tcp_port=own.tcp_port, token=_read_token(own.token_file))

    # -- life

    async def run(self) -> None:
        """Run until `stop`. Raises LinkError/ConfigError-like SkygcsErrors only before `ready` is set."""
        await self.rpc.start()
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
            await self.rpc.close()

    async def _run_inner(self) -> None:
        async with asyncio.TaskGroup() as group:
            self._link_group = group
            clocks = [
                group.create_task(self._heartbeat(), name="heartbeat"),
                group.create_task(self._tick_fleet(), name="fleet tick"),
                group.create_task(self._tick_hub(), name="hub tick"),
            ]
            for name, link in self.config.links.items():
                if link.enabled:
                    self._start_link(name, link)
            self.ready.set()
            await self._stopping.wait()
            for clock in clocks:
                clock.cancel()
            for name in list(self._links):
                await self._stop_link(name)
            self._link_group = None

    def stop(self) -> None:
        """End `run` in order. Idempotent; safe as a signal handler of the loop."""
        self._stopping.set()

    @property
    def stopping(self) -> bool:
        return self._stopping.is_set()

    async def stopped(self) -> None:
        """Wait until somebody asked the daemon to stop."""
        await self._stopping.wait()

    async def _heartbeat(self) -> None:
        if not self.config.daemon.heartbeat:
            return
        info = self.dialect.find("HEARTBEAT")
        values = {"type": 6, "autopilot": 8, "base_mode": 0, "system_status": 4, "mavlink_version": 3}
        while True:
            self.hub.send_heartbeat(info, values)
            await asyncio.sleep(HEARTBEAT_PERIOD_S)

    async def _tick_fleet(self) -> None:
        while True:
            await asyncio.sleep(FLEET_TICK_S)
            self.fleet.tick(self.loop.time())

    async def _tick_hub(self) -> None:
        while True:
            await asyncio.sleep(1.0)
            self.hub.tick(self.loop.time())

    # -- sending

    def _send(self, info: MessageInfo, values: Mapping[str, Any], sysid: int, compid: int, priority: Priority) -> bool:
        return self.hub.send(info, values, sysid, compid, priority)

    def send_message(
        self, name: str, fields: Mapping[str, Any], target: str | None = None, link: str | None = None
    ) -> dict[str, Any]:
        """Any message of the dialect by name. A target fills target_system and target_component where it has them.

        Raises KeyError (no such message), ValueError (bad field), TargetError, LinkError (no such link) or
        RefusedError (nobody to send it to).
        """
        info = self.dialect.find(name)
        values = dict(fields)
        if link is not None:
            if link not in self._links:
                raise LinkError(f"no link {link!r}; there are: {', '.join(self._links) or 'none'}")
            return {"sent": int(self.hub.send_on_link(link, info, values)), "message": info.name}
        if target is None:
            sysid = int(values.get("target_system", 0) or 0)
            compid = int(values.get("target_component", 0) or 0)
            receivers = [(sysid, compid)]
        else:
            receivers = [(actor.sysid, actor.compid) for actor in self.fleet.resolve(target)]
        names = {f.name for f in info.fields}
        sent = 0
        for sysid, compid in receivers:
            addressed = dict(values)
            if sysid and "target_system" in names:
                addressed["target_system"] = sysid
            if compid and "target_component" in names:
                addressed.setdefault("target_component", compid)
            sent += self.hub.send(info, addressed, sysid, compid, Priority.COMMAND)
        if not sent:
            raise RefusedError(f"{info.name} was not sent: no link on which its target was heard")
        return {"sent": sent, "message": info.name}

    # -- events

    def on_event(self, event: Event) -> None:
        """Log it, keep it, tell the watchers. A watcher's fault is its own."""
        record = {
            "time_unix_s": round(time.time(), 3),
            "kind": event.kind,
            "vehicle": event.vehicle,
            "sysid": event.sysid,
            "text": event.text,
            "data": event.data,
        }
        self.events.append(record)
        level = log.debug if event.kind in _QUIET_KINDS else log.info
        level(event.text, kind=event.kind, **({"vehicle": event.vehicle} if event.vehicle else {}))
        if event.kind == "reboot" and event.sysid is not None:
            for key in [k for k in self.fleet.vehicles if k >> 8 == event.sysid]:
                self.hub.restart_source(key)
        for watcher in tuple(self._event_watchers):
            try:
                watcher(record)
            except Exception as error:
                self._event_watchers.remove(watcher)
                log.error("an event watcher failed and was removed", error=repr(error))

    def _on_note(self, note: RouteNote, channel: Channel | None) -> None:
        where = f"{channel.link.name} ({channel.peer})" if channel is not None else "a closed channel"
        who = f"{note.sysid}/{note.compid}"
        text = {
            "learned": f"{who} heard on {where}",
            "expired": f"{who} not heard on {where} for {self.config.daemon.route_timeout_s:g} s, route forgotten",
            "cleared": f"{who} restarted (SYSTEM_TIME went back), its routes are learned anew",
            "conflict": f"{where} sends frames with our own id {who}: they are dropped; "
            "give one of the two another daemon.sysid or daemon.compid",
        }[note.kind]
        kind = "conflict" if note.kind == "conflict" else "route"
        self.on_event(Event(kind, None, note.sysid, text, {"change": note.kind, "compid": note.compid}))

    def _on_fault(self, text: str) -> None:
        self.on_event(Event("fault", None, None, f"internal fault behind a frame, please report it: {text}", {}))

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
        return self.hub.add_tap(msgids, keys, watcher)

    # -- links

    def _start_link(self, name: str, config: LinkConfig) -> None:
        assert self._link_group is not None
        link = make_link(config, self.hub, self.loop)
        supervisor = LinkSupervisor(link, self.on_event)
        task = self._link_group.create_task(supervisor.run(), name=f"link {name}")
        self._links[name] = (supervisor, task)

    async def _stop_link(self, name: str) -> None:
        _, task = self._links.pop(name)
        task.cancel()
        await asyncio.wait({task})  # which, unlike awaiting it, does not swallow a cancellation of our own

    def _checked_link(self, name: str, link: Mapping[str, Any]) -> LinkConfig:
        try:
            return parse_link(name, dict(link), self.dialect)
        except ConfigError as error:
            raise LinkError(str(error)) from None

    async def add_link(self, name: str, link: Mapping[str, Any]) -> None:
        """Open a further link. Raises LinkError if the name is taken or the description is wrong."""
        if name in self._links:
            raise LinkError(f"there is a link {name!r} already; change or remove it")
        config = self._checked_link(name, link)
        self._start_link(name, config)

    async def change_link(self, name: str, link: Mapping[str, Any]) -> None:
        """Replace a link: ``link`` holds the keys that change. On a bad description the old link stays."""
        if name not in self._links:
            raise LinkError(f"no link {name!r}; there are: {', '.join(self._links) or 'none'}")
        old = self._links[name][0].link.config
        same_type = link.get("type", old.type) == old.type
        merged = (
            {**old.model_dump(mode="json", exclude_unset=True), "type": old.type, **link} if same_type else dict(link)
        )
        config = self._checked_link(name, merged)
        await self._stop_link(name)
        self._start_link(name, config)

    async def remove_link(self, name: str) -> None:
        """Close a link for good. Raises LinkError if there is none of that name."""
        if name not in self._links:
            raise LinkError(f"no link {name!r}; there are: {', '.join(self._links) or 'none'}")
        await self._stop_link(name)

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
        }

    def links_status(self) -> list[dict[str, Any]]:
        """Every link with its state, channels, counters and sources."""
        now = self.now()
        rows = []
        for name, (supervisor, _) in self._links.items():
            link = supervisor.link
            rows.append(
                {
                    "name": name,
                    "type": link.config.type,
                    "role": link.config.role,
                    "state": supervisor.state,
                    "since_s": round(now - supervisor.since, 1),
                    "last_error": supervisor.last_error,
                    "failures": supervisor.failures,
                    "opened": supervisor.opened,
                    **link.counters(),
                    "channels": [self._channel_status(c, now) for c in link.channels],
                }
            )
        return rows

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
        """Per link on which this (sysid<<8|compid) is heard: loss and rate."""
        found = {}
        for channel_id in self.hub.router.channels_of(key):
            channel = self.hub.channels[channel_id]
            stats = channel.sources.get(key)
            if stats is not None:
                found[channel.link.name] = stats.as_dict(self.now())
        return found

    def router_stats(self) -> dict[str, Any]:
        """Counters of decisions and the route table."""
        router = self.hub.router
        now = self.now()
        return {
            "counters": {verdict.value: count for verdict, count in router.counters.items()},
            "overflowed_routes": router.overflowed_routes,
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


def _read_token(path: Path | None) -> str | None:
    """The RPC token; raises LinkError if the file is missing, empty or readable by others."""
    if path is None:
        return None
    try:
        mode = path.stat().st_mode
        token = path.read_text().strip()
    except OSError as error:
        raise LinkError(f"daemon.token_file {path}: {error.strerror}") from None
    if mode & 0o077:
        raise LinkError(f"daemon.token_file {path}: others can read it; chmod 600 {path}")
    if len(token) < 16:
        raise LinkError(f"daemon.token_file {path}: the token needs at least 16 characters")
    return token
