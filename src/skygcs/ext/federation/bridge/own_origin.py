"""The origin of the own daemon's world frame, in which other sites' vehicles are shown here."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

from skygcs.core.geo import Origin
from skygcs.errors import RpcError
from skygcs.ext.federation.bridge.daemon_link import DaemonLink

ASK_EVERY_S = 2.0
"""It changes by hand. Positions of other sites are given in the new frame so much later."""


class OwnOrigin:
    """``origin`` as the daemon last said it; None: there is none. `follow` while the daemon is there."""

    def __init__(self, link: DaemonLink) -> None:
        self.origin: Origin | None = None
        self._link = link

    async def follow(self) -> None:
        """Ask until it is cancelled. Raises RpcError if the daemon goes."""
        while True:
            self.origin = _read((await self._link.call("origin.get")).get("origin"))
            await asyncio.sleep(ASK_EVERY_S)

    async def run(self) -> None:
        """`follow` over all connections, for a link that nothing else follows. Until it is cancelled."""
        while True:
            with contextlib.suppress(RpcError):
                await self.follow()
            await asyncio.sleep(ASK_EVERY_S)


def _read(found: dict[str, Any] | None) -> Origin | None:
    if found is None:
        return None
    return Origin(found["lat_deg"], found["lon_deg"], found["alt_amsl_m"], found["x_heading_deg"])
