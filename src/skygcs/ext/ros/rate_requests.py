"""Requests for messages: those that setpoints need, and those that topics are made of while somebody reads them.

wanted by                                              rate                          asked
----------------------------------------------------   ---------------------------   -------------------------
demands in the body's frame (`SetpointStream`)         theirs                        before anything else
a topic that is read, of a message in [ros.rates]      the fleet file's              one after the other
nothing any more                                       the autopilot's own           once
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from skygcs.errors import RpcError

if TYPE_CHECKING:
    from skygcs.rpc.client import Client

AGAIN_S = 15.0
"""A request that was refused, or lost, is made again after so long; so is one whose stream a reboot has ended."""

Rates = Mapping[str, Mapping[str, float]]
"""Hz by vehicle and message."""


class RateRequests:
    """`update` once a second with what is wanted; it asks for one message of one vehicle after the other. Before each
    of them it asks for what ``urgent()`` returns then: a vehicle that answers slowly must not keep a setpoint's."""

    def __init__(self, gcs: Client, clock: Callable[[], float], urgent: Callable[[], Rates]) -> None:
        self._gcs = gcs
        self._clock = clock
        self._urgent = urgent
        self._asked: dict[tuple[str, str], tuple[float, float]] = {}
        """By vehicle and message: when it was asked, and for which rate."""

    async def update(self, wanted: Rates) -> None:
        """``wanted``: of the vehicles that are connected. A vehicle's refusal is left to the next request. Raises
        DaemonUnreachable."""
        due = _by_key(wanted)
        for key, rate_hz in _by_key(self._urgent()).items():
            due[key] = max(rate_hz, due.get(key, 0.0))
        await self._ask_urgent()
        for key in sorted(due, key=lambda key: (key in self._asked, key)):
            if self._is_due(key, due[key]):
                await self._ask(*key, due[key])
                await self._ask_urgent()
        for key in sorted(self._asked.keys() - due.keys() - _by_key(self._urgent()).keys()):
            del self._asked[key]
            if key[0] in wanted:
                await self._ask(*key, None)
                await self._ask_urgent()

    async def _ask_urgent(self) -> None:
        for key, rate_hz in _by_key(self._urgent()).items():
            if self._is_due(key, rate_hz):
                await self._ask(*key, rate_hz)

    def _is_due(self, key: tuple[str, str], rate_hz: float) -> bool:
        asked = self._asked.get(key)
        return asked is None or asked[1] < rate_hz or self._clock() - asked[0] >= AGAIN_S

    async def _ask(self, vehicle: str, message: str, rate_hz: float | None) -> None:
        if rate_hz is not None:
            self._asked[vehicle, message] = (self._clock(), rate_hz)
        with contextlib.suppress(RpcError):  # no such vehicle any more, or no such message: again after AGAIN_S
            await self._gcs.call("vehicles.interval", targets=vehicle, message=message, rate_hz=rate_hz)


def _by_key(rates: Rates) -> dict[tuple[str, str], float]:
    return {(vehicle, name): hz for vehicle, of_vehicle in rates.items() for name, hz in of_vehicle.items()}
