"""The ground's connections to all companions of the fleet file."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from skygcs.config.addresses import host_and_port
from skygcs.events import Event
from skygcs.ext.companions.companion_link import CompanionLink, Dial
from skygcs.ext.companions.companions_table import CompanionsConfig

DialTo = Callable[[str, str, int], Dial]
"""(companion, host, port) to what connects there."""


class CompanionLinks:
    """One `CompanionLink` for each [companions.NAME] that has an `rpc`. `run` is their task."""

    def __init__(
        self,
        companions: CompanionsConfig,
        dial_to: DialTo,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        asleep: Callable[[], bool] = lambda: False,
    ) -> None:
        """``asleep``: `SleepWatch.check`."""
        self._links: dict[str, CompanionLink] = {}
        for name, entry in companions.entries.items():
            if entry.rpc is not None:
                dial = dial_to(name, *host_and_port(entry.rpc))
                self._links[name] = CompanionLink(name, companions.vehicle_of(name), dial, loop, on_event, asleep)

    def get(self, name: str) -> CompanionLink | None:
        """The connection to this companion; None if the fleet file gives it no `rpc`."""
        return self._links.get(name)

    def of_vehicle(self, vehicle: str) -> CompanionLink | None:
        """The connection to the companion on this vehicle; None if it has none."""
        return next((link for link in self._links.values() if link.vehicle == vehicle), None)

    def by_vehicle(self) -> dict[str, CompanionLink]:
        """All connections, by the vehicle that the companion is on."""
        return {link.vehicle: link for link in self._links.values()}

    async def run(self) -> None:
        """Keep all of them connected, until cancelled."""
        async with asyncio.TaskGroup() as group:
            for link in self._links.values():
                group.create_task(link.run(), name=f"companion {link.name}")

    def woke(self, why: str) -> None:
        """See `CompanionLink.woke`."""
        for link in self._links.values():
            link.woke(why)

    def status(self) -> list[dict[str, Any]]:
        """JSON-able, in the order of the fleet file."""
        return [link.status() for link in self._links.values()]
