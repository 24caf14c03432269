"""The connection by which nodes order: whatever goes over it to vehicles has a deadline of the daemon's clock.

    an order      is carried out if the daemon reads it within ORDER_WITHIN_S of being given
    a setpoint    the same, from when it came from its node, within the time that it is good for

So nothing is carried out late that waited in this process, in the socket or in a daemon that stood still. What ends a
flight (`ending_orders`) is carried out at any time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from skygcs.errors import RpcError
from skygcs.ext.ros.ending_orders import ends_flight
from skygcs.ext.ros.late_gate import WAITED
from skygcs.rpc.client import Client
from skygcs.rpc.daemon_clock import DaemonClock
from skygcs.rpc.error_codes import REFUSED

ORDER_WITHIN_S = 2.0
"""A person at the node expects the vehicle to begin within this time; a loaded daemon's worst turn takes a quarter."""

VALID_S = 0.5
"""The default of control.setpoint; MAVROS' users stream above 2 Hz, which PX4 asks for. It counts from when the
setpoint came; a daemon that reads it late, which it does within the same time, follows it so much longer."""

LEAST_VALID_S = 0.1
"""The least that control.setpoint takes; for a setpoint that waited here."""

ENDED_WITHIN_S = 2.0
"""A connection that is retired is kept so long at most for orders under way that end a flight."""


class OrderConnection:
    """``gcs``, for orders alone. ``clock``: the loop's of this process. While it is not ``is_awake()`` what was begun
    before is not ordered."""

    def __init__(self, gcs: Client, clock: Callable[[], float], is_awake: Callable[[], bool] = lambda: True) -> None:
        self.retired = False
        """It is not used any more but for what ends a flight: the process stood still."""
        self._gcs = gcs
        self._clock = clock
        self._is_awake = is_awake
        self._endings: set[asyncio.Future[Any]] = set()
        self._daemon_clock = DaemonClock()

    async def compare_clocks(self) -> None:
        """Before the first order, and some times a minute. Raises RpcError, DaemonUnreachable."""
        sent_at = self._clock()
        info = await self._gcs.call("daemon.info")
        self._daemon_clock.sample(sent_at, info.get("now_s"), self._clock())

    async def call(self, method: str, /, *, in_time: bool = False, **params: Any) -> Any:
        """The result of an order that is given now. ``in_time``: it begins something, though it is one that may also
        end a flight. Raises RpcError, DaemonUnreachable."""
        if ends_flight(method, params) and not in_time:
            ending = asyncio.ensure_future(self._gcs.call(method, **params))
            self._endings.add(ending)
            ending.add_done_callback(self._endings.discard)
            return await ending
        self._require_awake()
        return await self._gcs.call_by(self._deadline_s(self._clock() + ORDER_WITHIN_S), method, **params)

    async def setpoint(self, vehicle: str, came_at: float, **setpoint: Any) -> dict[str, Any]:
        """The vehicle's outcome of a setpoint that came from its node at this time. Raises as `call`."""
        self._require_awake()
        valid_s = max(LEAST_VALID_S, VALID_S - (self._clock() - came_at))
        deadline_s = self._deadline_s(came_at + VALID_S)
        answer = await self._gcs.call_by(deadline_s, "control.setpoint", targets=vehicle, valid_s=valid_s, **setpoint)
        outcome: dict[str, Any] = answer["outcomes"][vehicle]
        return outcome

    async def endings_ended(self) -> None:
        """Wait for orders under way that end a flight, at most ENDED_WITHIN_S."""
        if self._endings:
            await asyncio.wait(self._endings, timeout=ENDED_WITHIN_S)

    def _require_awake(self) -> None:
        if self.retired or not self._is_awake():
            raise RpcError(REFUSED, f"not carried out: {WAITED}")

    def _deadline_s(self, due: float) -> float | None:
        """In the daemon's clock; None: it is of a version that shows none."""
        ahead_s = self._daemon_clock.ahead_s
        return None if ahead_s is None else due + ahead_s
