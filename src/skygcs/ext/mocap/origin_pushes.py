"""Sends [origin] to vehicles of [mocap] whose estimators report none: without GPS they would have no position on earth,
and refuse the modes and orders that need one.

    a vehicle                                                   then
    ---------------------------------------------------------   ----------------------------------------------------
    is armed, lost, or its poses do not come                    nothing is sent
    has reported an origin                                      nothing is sent
    has not                                                     it is asked (GPS_GLOBAL_ORIGIN); if it still reports
                                                                none, it is sent once, and asked again
    still reports none                                          again after RETRY_S, TRIES times at most
    reboots                                                     as in the beginning
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from skygcs.core.geo import Origin
from skygcs.core.vehicle.origin import ORIGIN_MESSAGE
from skygcs.runtime.home_orders import push_origin
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import OnEvent

RETRY_S = 10.0
"""ArduPilot takes no origin before its estimator has begun, a few seconds after its start."""

TRIES = 6


@dataclass(slots=True)
class _Pushed:
    tries: int = 0
    next_at: float = 0.0
    running: bool = False


class OriginPushes:
    """Call `look` for each vehicle whose poses come, `forget` when it has rebooted."""

    def __init__(self, origin: Origin, loop: asyncio.AbstractEventLoop, on_event: OnEvent) -> None:
        self._origin = origin
        self._loop = loop
        self._tasks = TaskSet(loop, on_event)
        self._pushed: dict[int, _Pushed] = {}

    def look(self, actor: VehicleActor, now: float) -> None:
        """Begin to send it if it is needed; at most one task for each vehicle."""
        vehicle = actor.vehicle
        if vehicle.telemetry("ekf_origin") is not None or vehicle.armed:
            return
        pushed = self._pushed.setdefault(actor.sysid, _Pushed())
        if pushed.running or pushed.tries >= TRIES or now < pushed.next_at:
            return
        pushed.running = True
        pushed.tries += 1
        self._tasks.start(self._push(actor, pushed), f"origin of {actor.name}")

    def forget(self, sysid: int) -> None:
        """The vehicle has rebooted."""
        pushed = self._pushed.get(sysid)
        if pushed is not None:
            pushed.tries, pushed.next_at = 0, 0.0

    def close(self) -> None:
        """Cancel what runs."""
        self._tasks.close()

    async def _push(self, actor: VehicleActor, pushed: _Pushed) -> None:
        try:
            await actor.request_message(ORIGIN_MESSAGE)
            if actor.vehicle.telemetry("ekf_origin") is None and not actor.vehicle.armed:
                await push_origin(actor, self._origin)
        finally:
            pushed.running = False
            pushed.next_at = self._loop.time() + RETRY_S
