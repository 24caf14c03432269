"""The daemon's links by name: opened, changed, switched off and removed while it runs, one change at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, assert_never

from skygcs.config import models
from skygcs.config.checks import added_conflicts, link_warnings
from skygcs.config.loader import parse_link
from skygcs.config.models import FleetConfig, LinkConfig
from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import LinkError, RefusedError, SkygcsError
from skygcs.events import Event
from skygcs.links.base import Channel, Link, LinkHost, LinkSupervisor
from skygcs.runtime.hub import Hub
from skygcs.runtime.signing_keys import Signing


class _Entry:
    """One link: running under a supervisor, or switched off."""

    __slots__ = ("config", "since", "supervisor", "task")

    def __init__(
        self, config: LinkConfig, since: float, supervisor: LinkSupervisor | None, task: asyncio.Task[None] | None
    ) -> None:
        self.config = config
        self.since = since
        self.supervisor = supervisor
        self.task = task


class LinkTable:
    """`start` once, then `add`, `change` and `remove`, then `close`.

    A change is completed even if its caller is cancelled meanwhile: an incomplete one would leave a link closed.
    """

    def __init__(
        self,
        config: FleetConfig,
        dialect: Dialect,
        hub: Hub,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        signing: Signing,
    ) -> None:
        """Raises KeyFileError if the signing key of a link of the fleet file cannot be used."""
        self._fleet_config = config
        self._dialect = dialect
        self._hub = hub
        self._loop = loop
        self._on_event = on_event
        self._signing = signing
        for link in config.links.values():
            signing.prepare(link)
        self._entries: dict[str, _Entry] = {}
        self._group: asyncio.TaskGroup | None = None
        self._lock = asyncio.Lock()
        self._changes: set[asyncio.Task[None]] = set()
        self.loss_refusal: Callable[[str], str | None] = lambda name: None
        """Why a link must not be closed now: a flight needs it. Set by the daemon; None: it may."""

    def now(self) -> float:
        """The loop's time, by which routes are dated."""
        return self._loop.time()

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    @property
    def configs(self) -> dict[str, LinkConfig]:
        """The present configuration of all links, including those switched off."""
        return {name: entry.config for name, entry in self._entries.items()}

    def supervisors(self) -> dict[str, LinkSupervisor]:
        """Supervisors of each link that is not switched off, by name."""
        return {n: e.supervisor for n, e in self._entries.items() if e.supervisor is not None}

    def open_names(self) -> list[str]:
        """Names of the links that are open now."""
        return [n for n, e in self._entries.items() if e.supervisor is not None and e.supervisor.state == "up"]

    def start(self, group: asyncio.TaskGroup) -> None:
        """Open the links of the fleet file; links run in this task group."""
        self._group = group
        for name, config in self._fleet_config.links.items():
            self._enter(name, config)
        self._warn(self.configs)

    async def close(self) -> None:
        """Close all links, after the change in progress; further changes are refused."""
        async with self._lock:
            self._group = None
            for name in list(self._entries):
                await self._leave(name)

    async def add(self, name: str, link: Mapping[str, Any]) -> None:
        """Open a further link. Raises LinkError if the name is taken or the link in conflict, ConfigError if the
        description is wrong."""
        await self._carried_through(lambda: self._add(name, link))

    async def change(self, name: str, link: Mapping[str, Any]) -> None:
        """Replace a link: ``link`` holds the keys that change. On a bad description the old link stays. Raises
        RefusedError where a flight needs it: it is closed meanwhile."""
        await self._carried_through(lambda: self._change(name, link))

    async def remove(self, name: str) -> None:
        """Close a link for good. Raises LinkError if no link has that name, RefusedError where a flight needs it."""
        await self._carried_through(lambda: self._remove(name))

    async def replace(self, before: Mapping[str, LinkConfig], after: Mapping[str, LinkConfig]) -> list[str]:
        """Carry out the differences between two fleet files; returns a line for each. Links that are the same in both,
        and those added at run time, stay as they are."""
        done: list[str] = []
        await self._carried_through(lambda: self._replace(before, after, done))
        return done

    async def _replace(
        self, before: Mapping[str, LinkConfig], after: Mapping[str, LinkConfig], done: list[str]
    ) -> None:
        gone = [name for name in before if name in self._entries and after.get(name) != before[name]]
        for name in list(gone):  # all first: a new link may need the port of an old one
            try:
                await self._remove(name)
            except RefusedError as error:
                gone.remove(name)
                done.append(f"link {name} stays as it is: {error}")
        for name in gone:
            if name not in after:
                done.append(f"link {name} removed")
        for name, config in after.items():
            if before.get(name) == config or (name in before and name in self._entries):
                continue
            try:
                table = config.model_dump(mode="json", exclude_unset=True, exclude={"name"})
                await self._add(name, table | {"type": config.type})
                done.append(f"link {name} {'changed' if name in before else 'added'}")
            except SkygcsError as error:
                done.append(f"link {name} is not opened: {error}")

    def require(self, name: str) -> None:
        """Raises LinkError if there is no link of that name."""
        if name not in self._entries:
            raise LinkError(f"no link {name!r}; there are: {', '.join(self._entries) or 'none'}")

    def link(self, name: str) -> Link | None:
        """The link object, None while it is switched off. Raises LinkError if no link has that name."""
        self.require(name)
        supervisor = self._entries[name].supervisor
        return None if supervisor is None else supervisor.link

    def link_channels(self, name: str) -> list[Channel]:
        """The open channels of a link; none if it is switched off, or there is no link of that name."""
        entry = self._entries.get(name)
        return [] if entry is None or entry.supervisor is None else entry.supervisor.link.channels

    # -- one change

    async def _carried_through(self, change: Callable[[], Awaitable[None]]) -> None:
        task = self._loop.create_task(self._locked(change), name="link change")
        self._changes.add(task)
        task.add_done_callback(self._changed)
        await asyncio.shield(task)

    async def _locked(self, change: Callable[[], Awaitable[None]]) -> None:
        async with self._lock:
            if self._group is None:
                raise LinkError("skygcs is shutting down")
            await change()

    def _changed(self, task: asyncio.Task[None]) -> None:
        self._changes.discard(task)
        if not task.cancelled():
            task.exception()  # retrieved here in case its caller is gone

    async def _add(self, name: str, link: Mapping[str, Any]) -> None:
        if name in self._entries:
            raise LinkError(f"there is a link {name!r} already; change or remove it")
        config = self._checked(name, link)
        self._enter(name, config)
        self._warn({name: config})

    async def _change(self, name: str, link: Mapping[str, Any]) -> None:
        self.require(name)
        old = self._entries[name].config
        same_type = link.get("type", old.type) == old.type
        kept = {**old.model_dump(mode="json", exclude_unset=True), "type": old.type} if same_type else {}
        config = self._checked(name, {**kept, **link})
        self._require_unneeded(name)
        await self._leave(name)
        self._enter(name, config)
        self._warn({name: config})

    async def _remove(self, name: str) -> None:
        self.require(name)
        self._require_unneeded(name)
        await self._leave(name)
        self._signing.forget(name)
        del self._entries[name]

    def _require_unneeded(self, name: str) -> None:
        if (why := self.loss_refusal(name)) is not None:
            raise RefusedError(why)

    def _checked(self, name: str, table: Mapping[str, Any]) -> LinkConfig:
        config = parse_link(name, dict(table), self._dialect)
        if problems := added_conflicts(self._current(), name, config):
            raise LinkError(f"link {name}: " + "; ".join(problems))
        self._signing.prepare(config)
        return config

    def _current(self) -> FleetConfig:
        return self._fleet_config.model_copy(update={"links": self.configs})

    def _enter(self, name: str, config: LinkConfig) -> None:
        assert self._group is not None
        if not config.enabled:
            self._entries[name] = _Entry(config, self._loop.time(), None, None)
            return
        link = make_link(config, self._hub, self._loop)
        supervisor = LinkSupervisor(link, self._on_event)
        task = self._group.create_task(supervisor.run(), name=f"link {name}")
        self._entries[name] = _Entry(config, self._loop.time(), supervisor, task)

    async def _leave(self, name: str) -> None:
        entry = self._entries[name]
        if entry.task is not None:
            entry.task.cancel()
            await asyncio.wait({entry.task})  # unlike an await of the task, this does not swallow our own cancellation

    def _warn(self, which: Mapping[str, LinkConfig]) -> None:
        for name, text in link_warnings(self._current()).items():
            if name in which:
                self._on_event(Event("warning", None, None, f"links.{name}: {text}", {"link": name}))

    # -- status

    def status(self) -> list[dict[str, Any]]:
        """Every link with its state, counters and channels; ``vehicles`` where it is bound to some; ``warning`` where
        it conflicts with another."""
        self._hub.flows.take()
        now = self._loop.time()
        warnings = link_warnings(self._current())
        rows = []
        for name, entry in self._entries.items():
            supervisor = entry.supervisor
            row: dict[str, Any] = {"name": name, "type": entry.config.type, "role": entry.config.role}
            if supervisor is None:
                row |= {"state": "disabled", "since_s": round(now - entry.since, 1), "last_error": None}
                row |= {"failures": 0, "opened": 0, "channels": []}
            else:
                row |= {
                    "state": supervisor.state,
                    "since_s": round(now - supervisor.since, 1),
                    "last_error": supervisor.last_error,
                    "failures": supervisor.failures,
                    "opened": supervisor.opened,
                    **supervisor.link.counters(),
                    "channels": [self._hub.statistics.channel_status(c) for c in supervisor.link.channels],
                }
            if entry.config.vehicles:
                row |= {"vehicles": list(entry.config.vehicles), "translated_sysid": entry.config.translated_sysid}
            if name in warnings:
                row["warning"] = warnings[name]
            rows.append(row)
        return rows


def make_link(config: models.LinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> Link:
    """The link of this configuration, not yet open. Kinds are imported when first used: most fleets have two or
    three."""
    match config:
        case models.SerialLinkConfig():
            from skygcs.links.serial import SerialLink

            return SerialLink(config, host, loop)
        case models.XBeeLinkConfig():
            from skygcs.links.xbee import XBeeLink

            return XBeeLink(config, host, loop)
        case models.UdpServerLinkConfig():
            from skygcs.links.udp import UdpServerLink

            return UdpServerLink(config, host, loop)
        case models.UdpClientLinkConfig():
            from skygcs.links.udp import UdpClientLink

            return UdpClientLink(config, host, loop)
        case models.UdpBroadcastLinkConfig():
            from skygcs.links.udp import UdpBroadcastLink

            return UdpBroadcastLink(config, host, loop)
        case models.TcpServerLinkConfig():
            from skygcs.links.tcp import TcpServerLink

            return TcpServerLink(config, host, loop)
        case models.TcpClientLinkConfig():
            from skygcs.links.tcp import TcpClientLink

            return TcpClientLink(config, host, loop)
        case models.ReplayLinkConfig():
            from skygcs.links.replay import ReplayLink

            return ReplayLink(config, host, loop)
        case models.MemoryLinkConfig():
            from skygcs.links.memory import MemoryLink

            return MemoryLink(config, host, loop)
        case models.SimulatedLinkConfig():
            from skygcs.links.simulated import SimulatedVehiclesLink

            return SimulatedVehiclesLink(config, host, loop)
        case _:
            assert_never(config)
