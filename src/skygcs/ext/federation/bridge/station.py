"""The services that each part of the bridge receives: the connection to the hub, the daemon, the station's names, the
reports."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import structlog

from skygcs.config.models import FleetConfig
from skygcs.events import Event
from skygcs.ext.federation.bridge.bus import Bus
from skygcs.ext.federation.bridge.daemon_link import DaemonLink
from skygcs.ext.federation.bridge.site_clock import SiteClock
from skygcs.ext.federation.config import FederationConfig

MAX_REPORTS = 200

_log = structlog.get_logger("skygcs.federation")

StationMethod = Callable[[dict[str, Any]], Awaitable[Any]]
"""A method of the station socket: params in, JSON-able result out. Raises RpcError."""


class Part(Protocol):
    """A part of the bridge, such as the publisher."""

    async def run(self) -> None:
        """Run until it is cancelled. An error that it raises is reported, and it is run again after a pause."""
        ...

    def status(self) -> dict[str, Any]:
        """JSON-able, for federation.status."""
        ...


class Reports:
    """Reports events of the bridge: logs them, and keeps the last MAX_REPORTS in ``recent``."""

    def __init__(self) -> None:
        self.recent: deque[Event] = deque(maxlen=MAX_REPORTS)
        self.count = 0

    def __call__(self, event: Event) -> None:
        self.count += 1
        self.recent.append(event)
        log = _log.error if event.kind == "fault" else _log.warning if event.kind == "warning" else _log.info
        log(event.text, kind=event.kind, **({} if event.vehicle is None else {"vehicle": event.vehicle}))


@dataclass(frozen=True)
class Station:
    """The station of this process, made by `skygcs.ext.federation.bridge.process`."""

    config: FederationConfig
    fleet: FleetConfig
    name: str
    """The site's name; for an operator or observer without one, the name of its computer."""
    run_id: str
    """Random identifier of this run of the process; sequence numbers begin anew with each run."""
    bus: Bus
    daemon_address: str | None
    """None: a station without a daemon."""
    daemon_token: str | None
    socket_path: Path
    """Path of the station socket."""
    loop: asyncio.AbstractEventLoop
    report: Reports
    clock: SiteClock = field(default_factory=SiteClock)
    """Its ``site_s`` is the site's clock, with which other sites compare theirs."""
    methods: dict[str, StationMethod] = field(default_factory=dict)
    """The methods federation.* of the station socket; each part adds its own before anything runs."""

    @property
    def site(self) -> str | None:
        """The name of the site; None if this station is an operator or observer."""
        return self.config.site if self.config.role == "site" else None

    def daemon_link(self, name: str) -> DaemonLink | None:
        """A new connection to the daemon for the part of this name, which has to run it; None without a daemon."""
        if self.daemon_address is None:
            return None
        return DaemonLink(self.daemon_address, self.daemon_token, name)

    def now(self) -> float:
        """The loop's clock: CLOCK_MONOTONIC."""
        return self.loop.time()
