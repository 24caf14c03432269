"""What [companion] and [companions] add to a daemon: connections, mDNS, and the door for orders over TLS.

on the companion                            on the ground
----------------------------------------    ----------------------------------------
TlsListener      takes the ground's orders  CompanionLinks      one connection to each
GroundFinder     with ground = "mdns"       GroundAnnouncement  with advertise = true
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from functools import partial
from typing import Any

from skygcs.config.companion import GROUND_LINK, MDNS
from skygcs.config.companions import host_and_port
from skygcs.config.models import FleetConfig, TcpServerLinkConfig, UdpServerLinkConfig
from skygcs.events import Event
from skygcs.rpc.tls import Identity
from skygcs.rpc.tls_listener import TlsListener
from skygcs.runtime.companion_link import CompanionClient, Dial
from skygcs.runtime.companion_links import CompanionLinks
from skygcs.runtime.ground_finder import GroundAnnouncement, GroundFinder
from skygcs.runtime.linktable import LinkTable

AGAIN_S = 5.0
"""A part that failed by a fault of ours is begun again after this time."""


class CompanionParts:
    """The parts that the fleet file asks for; none of them without its tables. `run` is their task."""

    def __init__(
        self,
        config: FleetConfig,
        links: LinkTable,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        on_fault: Callable[[Exception], None],
    ) -> None:
        self.listener: TlsListener | None = None
        """To be run by the RPC server, whose sessions it opens."""
        self._config = config
        self._open_links = links
        self._loop = loop
        self._on_fault = on_fault
        self._finder: GroundFinder | None = None
        self._announcement: GroundAnnouncement | None = None
        self.links = CompanionLinks(config.companions, self._dial_to, loop, on_event)
        companion, companions = config.companion, config.companions
        if companion is not None:
            if companion.rpc_listen is not None:
                address = host_and_port(companion.rpc_listen)
                self.listener = TlsListener(*address, Identity.of_companion(companion.key_dir), on_event)
            if companion.ground == MDNS:
                self._finder = GroundFinder(companion, links, loop, on_event)
        if companions is not None and companions.advertise:
            announced = companions.link or _only_server(config)
            self._announcement = GroundAnnouncement(
                announced, companions.interfaces, links, on_event, name=companions.name
            )

    async def run(self) -> None:
        """Until cancelled; returns at once if there is nothing to do."""
        parts: list[tuple[str, Callable[[], Coroutine[Any, Any, None]]]] = [("companions", self.links.run)]
        if self._finder is not None:
            parts.append(("ground finder", self._finder.run))
        if self._announcement is not None:
            parts.append(("ground announcement", self._announcement.run))
        async with asyncio.TaskGroup() as group:
            for name, run in parts:
                group.create_task(self._contained(run), name=name)

    async def _contained(self, run: Callable[[], Awaitable[None]]) -> None:
        """A fault of ours in a part must not end what forwards frames."""
        while True:
            try:
                await run()
                return
            except Exception as error:
                self._on_fault(error)
            await asyncio.sleep(AGAIN_S)

    def _dial_to(self, companion: str, host: str, port: int) -> Dial:
        assert self._config.companions is not None
        return partial(_dial, host, port, Identity.of_ground(self._config.companions.key_dir, companion))

    def status(self) -> dict[str, Any]:
        """JSON-able, for companions.status."""
        announcement = self._announcement
        return {
            "companions": self.links.status(),
            "announced": None if announcement is None else announcement.announced,
            "problem": None if announcement is None else announcement.problem,
            "companion": self._own_status(),
        }

    def _own_status(self) -> dict[str, Any] | None:
        companion = self._config.companion
        if companion is None:
            return None
        channels = self._open_links.link_channels(GROUND_LINK)
        heard = [channel.last_rx_at for channel in channels if channel.rx_frames]
        return {
            "vehicle": companion.vehicle,
            "sysid": self._config.daemon.sysid,
            "compid": self._config.daemon.compid,
            "ground": companion.ground,
            "ground_peer": next((channel.peer for channel in channels), None),
            "ground_age_s": round(self._loop.time() - max(heard), 2) if heard else None,
            "mdns": None if self._finder is None else self._finder.status(),
            "rpc": None if self.listener is None else self.listener.status(),
        }


async def _dial(host: str, port: int, identity: Identity) -> CompanionClient:
    """Connect as `CompanionLink` wants it; the files are read each time, so that a new pin counts at once."""
    from skygcs.rpc.client import connect_pinned

    return await connect_pinned(host, port, identity)


def _only_server(config: FleetConfig) -> str:
    """The link that is announced where [companions] names none: the check has found that there is one."""
    servers = (UdpServerLinkConfig, TcpServerLinkConfig)
    return next(name for name, link in config.links.items() if link.enabled and isinstance(link, servers))
