"""The dead-man button is released before the daemon has answered: hold is ordered, or nothing."""

from __future__ import annotations

import asyncio
import os
import struct
from collections.abc import AsyncIterator
from typing import Any, cast

from skygcs.cli.connection import Exit
from skygcs.errors import RpcError
from skygcs.ext.joystick.commands import JoystickFlight
from skygcs.ext.joystick.device_events import AXIS, BUTTON, INITIAL
from skygcs.ext.joystick.stick_mapping import StickAxes, StickLimits
from skygcs.ext.joystick.stick_session import SessionState
from skygcs.rpc import error_codes
from support.hosts import until
from support.table import each


class SlowDaemon:
    """Answers control.set once the device is gone, with ``ok``; meanwhile the vehicle's control is in ``state``."""

    def __init__(self, ok: bool, state: str) -> None:
        self.ok, self.state = ok, state
        self.address = "here"
        self.orders: list[str] = []
        self.asked = asyncio.Event()
        self.looked = 0

    async def call(self, method: str, **params: Any) -> Any:
        if method == "control.status":
            self.looked += 1
            if self.state == "refused":
                raise RpcError(error_codes.LIMIT_EXCEEDED, "too many requests")
            return [{"state": self.state, "mode": None, "successor": None, "reasons": []}]
        assert method == "control.set"
        self.asked.set()
        await until(lambda: self.looked == 3, 60.0)
        return {
            "outcomes": {"alpha": {"ok": self.ok, "message": "accepted" if self.ok else "refused: a plan flies it"}}
        }

    async def hold(self, name: str) -> Any:
        self.orders.append("hold")
        return {name: {"ok": True, "message": "accepted"}}

    async def telemetry(self, name: str, **_: Any) -> AsyncIterator[Any]:
        await asyncio.Event().wait()
        yield


def event(kind: int, number: int, value: int = 0) -> bytes:
    return struct.pack("=IhBB", 0, value, kind, number)


RELEASED = [
    (False, "off", []),  # refused: another one may fly it, by a plan or back home
    (False, "flying", []),  # by the setpoints of another client
    (True, "off", ["hold"]),
    (False, "engaging", ["hold"]),  # setpoints have begun: not waited for
    (False, "refused", ["hold"]),  # its state is not known
]


@each("ok, state, ordered", RELEASED)
async def test_a_release_before_the_answer_stops_only_what_was_taken(ok: bool, state: str, ordered: list[str]) -> None:
    """A short press held every vehicle whose engagement was refused, also one on its way home."""
    daemon = SlowDaemon(ok, state)
    flight = JoystickFlight(cast(Any, daemon), "alpha", engage=True, fleet_frame=True)
    near, far = os.pipe()
    os.set_blocking(near, False)
    at_rest = [event(AXIS | INITIAL, number) for number in range(6)] + [event(BUTTON | INITIAL, 5)]
    os.write(far, b"".join(at_rest))
    flying = asyncio.create_task(flight.fly(near, StickAxes(), StickLimits(), 5))
    await asyncio.sleep(0)
    await until(lambda: flight._session.state is SessionState.READY, 60.0)
    os.write(far, event(BUTTON, 5, 1))
    await daemon.asked.wait()
    os.close(far)  # unplugged: the same as a release, and the end
    assert await flying == Exit.FAILED
    assert daemon.orders == ordered
    assert ("not taken under control" in flight.end) is not bool(ordered)
    os.close(near)
