"""Requests vehicles' messages at the rates of [ros.rates] while topics made of them are read."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from skygcs.errors import RpcError

if TYPE_CHECKING:
    from skygcs.rpc.client import Client

AGAIN_S = 15.0
"""A request that was refused, or lost, is made again after so long; so is one whose stream a reboot has ended."""


class RateRequests:
    """`update` once a second with what is wanted; it asks for one message of one vehicle after the other."""

    def __init__(self, gcs: Client, rates: Mapping[str, float]) -> None:
        self._gcs = gcs
        self._rates = rates
        self._asked_at: dict[tuple[str, str], float] = {}
        """By vehicle and message: on the loop's clock."""
        self._turn = asyncio.Lock()

    async def update(self, wanted: Mapping[str, Iterable[str]], now: float) -> None:
        """``wanted``: messages by the names of vehicles that are connected. A vehicle's refusal is left to the next
        request. Raises DaemonUnreachable."""
        if not self._rates or self._turn.locked():
            return
        async with self._turn:
            due = {(vehicle, name) for vehicle, names in wanted.items() for name in names if name in self._rates}
            for key in sorted(due):
                if now - self._asked_at.get(key, -AGAIN_S) >= AGAIN_S:
                    self._asked_at[key] = now
                    await self._ask(*key, self._rates[key[1]])
            for key in sorted(self._asked_at.keys() - due):
                del self._asked_at[key]
                if key[0] in wanted:
                    await self._ask(*key, None)

    async def _ask(self, vehicle: str, message: str, rate_hz: float | None) -> None:
        try:
            await self._gcs.call("vehicles.interval", targets=vehicle, message=message, rate_hz=rate_hz)
        except RpcError:
            self._asked_at.pop((vehicle, message), None)  # no such vehicle any more: nothing to repeat
