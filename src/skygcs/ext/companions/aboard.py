"""[companion] in the daemon on a vehicle's computer: the ground's orders and its loss, and the link to the ground."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any

from skygcs.config.addresses import host_and_port
from skygcs.config.tables import Problem
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.ext.companions import methods
from skygcs.ext.companions.companion_table import MDNS, CompanionConfig
from skygcs.ext.companions.ground_contact import GROUND_LINK
from skygcs.ext.companions.ground_finder import GroundFinder
from skygcs.ext.companions.ground_orders import GroundOrders
from skygcs.ext.companions.role import as_companion, companion_problems
from skygcs.ext.companions.tls import Identity
from skygcs.ext.companions.tls_listener import TlsListener
from skygcs.extension import Clock, Extension

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig
    from skygcs.core.mavlink.frame import Frame
    from skygcs.links.base import Channel
    from skygcs.rpc.context import NewSession, Services

CONTACT_TICK_S = 0.2
"""How late the loss of the ground may be noticed; `ground_lost_s` is seconds."""


class Companion(Extension[CompanionConfig]):
    """The vehicle's side of companions."""

    Config = CompanionConfig
    names = ("companions",)
    own_methods = methods.METHODS

    def __init__(self, core: Services, config: CompanionConfig) -> None:
        super().__init__(core, config)
        self._loop = loop = asyncio.get_running_loop()
        publish = core.event_log.publish
        self.orders = GroundOrders(config.vehicle, config.ground_lost, config.ground_lost_s, core.fleet, loop, publish)
        self._listener: TlsListener | None = None
        if config.rpc_listen is not None:
            address = host_and_port(config.rpc_listen)
            self._listener = TlsListener(*address, Identity.of_companion(config.key_dir), publish)
        self._finder = GroundFinder(config, core.links, loop, publish) if config.ground == MDNS else None

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        return companion_problems(config, fleet)

    @classmethod
    def applied(cls, config: Any, fleet: FleetConfig) -> FleetConfig:
        return as_companion(config, fleet)

    def clocks(self) -> Iterable[Clock]:
        yield Clock("watch over the ground", CONTACT_TICK_S, lambda: self.orders.tick(self.core.now()))

    async def run(self) -> None:
        """Look for the ground, if it is to be found."""
        if self._finder is not None:
            await self._finder.run()

    async def serve(self, new_session: NewSession) -> None:
        """Take the ground's orders over TLS."""
        if self._listener is not None:
            await self._listener.run(new_session)

    def observed_msgids(self) -> Collection[int]:
        return {HEARTBEAT}

    def on_frame(self, frame: Frame, channel: Channel, now: float) -> None:
        self.orders.on_heartbeat(frame, channel, now)

    def close(self) -> None:
        self.orders.close()

    def status(self) -> dict[str, Any]:
        """JSON-able, for companions.status."""
        config, own = self.config, self.core.config.daemon
        channels = self.core.links.link_channels(GROUND_LINK)
        heard = [channel.last_rx_at for channel in channels if channel.rx_frames]
        shown = {
            "vehicle": config.vehicle,
            "sysid": own.sysid,
            "compid": own.compid,
            "ground": config.ground,
            "ground_peer": next((channel.peer for channel in channels), None),
            "ground_age_s": round(self._loop.time() - max(heard), 2) if heard else None,
            "mdns": None if self._finder is None else self._finder.status(),
            "rpc": None if self._listener is None else self._listener.status(),
        }
        return {"companions": [], "announced": None, "problem": None, "companion": shown}
