"""Links and vehicles as the ground's daemon shows them while a fleet is brought up: asked once for all."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from typing import Any, Protocol

from skygcs.errors import CompanionError, RpcError
from skygcs.ext.companions.bring_up.service_control import is_active

EVERY_S = 0.5
"""A question of some milliseconds; a person sees no delay."""


class Daemon(Protocol):
    """The RPC client, or a stand-in."""

    async def call(self, method: str, /, **params: Any) -> Any: ...


class GroundView:
    """The vehicles of the daemon, as of half a second ago. ``daemon`` None: it cannot be reached, for ``reason``."""

    def __init__(self, daemon: Daemon | None, reason: str = "") -> None:
        self._daemon = daemon
        self._reason = reason
        self._states: dict[str, Mapping[str, Any]] = {}
        self._news = asyncio.Event()

    @contextlib.asynccontextmanager
    async def watching(self) -> AsyncIterator[None]:
        """Keep the view up to date while the body runs."""
        task = asyncio.create_task(self._watch(), name="ground view") if self._daemon is not None else None
        try:
            yield
        finally:
            if task is not None:
                task.cancel()
                await asyncio.wait([task])

    async def heard(self, vehicle: str, wait_s: float) -> bool:
        """True as soon as the daemon hears this vehicle, False if it does not within this time. Raises CompanionError
        if there is no daemon."""
        self._require()
        try:
            async with asyncio.timeout(wait_s):
                while not self._states.get(vehicle, {}).get("connected"):
                    await self._news.wait()
        except TimeoutError:
            return False
        return True

    async def preflight(self, vehicle: str) -> Mapping[str, Any]:
        """The report on one vehicle. Raises CompanionError."""
        try:
            answer = await self._require().call("preflight.run", targets=vehicle)
            report: Mapping[str, Any] = answer["vehicles"][vehicle]
        except RpcError as error:
            raise CompanionError("preflight", str(error)) from None
        except KeyError:
            reason = f"the ground's daemon does not know {vehicle}"
            raise CompanionError("preflight", reason, "does it run this fleet file?") from None
        return report

    async def closed_links(self) -> list[Mapping[str, Any]]:
        """Enabled links of the daemon that are not up; none without a daemon. Raises RpcError."""
        links = [] if self._daemon is None else await self._daemon.call("links.list")
        return [link for link in links if link["state"] not in ("up", "disabled")]

    async def active(self) -> list[str]:
        """Vehicles that are armed or in the air, as far as the daemon knows; none without a daemon. Raises RpcError."""
        states = [] if self._daemon is None else await self._daemon.call("vehicles.list")
        return [state["name"] for state in states if is_active(state) and not state.get("replayed")]

    def _require(self) -> Daemon:
        if self._daemon is None:
            raise CompanionError("ground", self._reason)
        return self._daemon

    async def _watch(self) -> None:
        while self._daemon is not None:
            with contextlib.suppress(RpcError):  # it is asked again
                self._states = {state["name"]: state for state in await self._daemon.call("vehicles.list")}
            news, self._news = self._news, asyncio.Event()
            news.set()
            await asyncio.sleep(EVERY_S)
