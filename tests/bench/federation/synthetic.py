"""A daemon that the publisher of a bench follows: states of vehicles that move, each marked with when it was made.

The mark is the latitude: it has 7 digits on the bus, and so a resolution of 10 us over 1000 s. All processes of a bench
share CLOCK_BOOTTIME, so that a reader knows the true age of what it got, whatever the comparison of clocks says.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from typing import Any

MARK_S = 1000.0
MARKS_PER_DEG = 100.0
"""Seconds a degree."""


def mark_of(made_s: float) -> float:
    return made_s % MARK_S / MARKS_PER_DEG


def age_of(lat_deg: float, now_s: float) -> float:
    """True age of a state with this latitude."""
    return (now_s - lat_deg * MARKS_PER_DEG) % MARK_S


class SyntheticClient:
    """As `rpc.client.Client`, with rounds of states at a rate."""

    def __init__(self, vehicles: int, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._templates = [self._template(i) for i in range(vehicles)]

    def _template(self, i: int) -> tuple[str, bytes, bytes]:
        state: dict[str, Any] = {
            "name": f"uav{i:03}",
            "sysid": i % 250 + 1,
            "compid": 1,
            "autopilot": "px4" if i % 3 else "ardupilot",
            "type": "QUADROTOR",
            "groups": [f"group{i % 8}"],
            "connected": True,
            "last_heartbeat_age_s": 0.0,
            "armed": True,
            "mode": "AUTO.LOITER",
            "landed": "in_air",
            "failsafe": False,
            "control": None,
            "gps": {"fix": "rtk_fixed", "fix_type": 6, "satellites": 19, "hdop": 0.7, "age_s": 0.12},
            "battery": {"volts": 15.4 + i % 10 / 10, "amps": 12.3, "percent": 20 + i % 80, "age_s": 0.4},
            "position": {
                "lon_deg": 11.5 + i * 1e-4,
                "alt_amsl_m": 530.25 + i,
                "alt_rel_m": 30.25 + i % 20,
                "heading_deg": i % 360,
                "vel_enu_mps": [1.25, -2.5, 0.125],
                "enu_m": [1234.125, -987.375, 30.5],
                "age_s": 0.0,
                "lat_deg": "MARK",
            },
        }
        head, _, tail = json.dumps(state).encode().partition(b'"MARK"')
        return state["name"], head, tail

    def encoded_telemetry(self, targets: str, *, rate_hz: float, groups: Any) -> AsyncIterator[dict[str, Any]]:
        return self._rounds(1.0 / rate_hz)

    async def _rounds(self, period_s: float) -> AsyncIterator[dict[str, Any]]:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            due = max(due + period_s, loop.time())
            await asyncio.sleep(due - loop.time())
            mark = b"%.7f" % mark_of(self._now_s())
            states = {name: head + mark + tail for name, head, tail in self._templates}
            yield {"states": states, "complete": True}

    async def call(self, method: str, **params: Any) -> Any:
        return {}

    async def events(self) -> AsyncIterator[dict[str, Any]]:
        await asyncio.Event().wait()
        yield {}


class SyntheticLink:
    """As `federation.daemon_link.DaemonLink`, always connected."""

    def __init__(self, vehicles: int, now_s: Callable[[], float]) -> None:
        self.client = SyntheticClient(vehicles, now_s)

    def on_change(self, observer: Callable[[], None]) -> None:
        pass

    async def run(self) -> None:
        await asyncio.Event().wait()

    async def call(self, method: str, **params: Any) -> Any:
        return {"origin": {"lat_deg": 5.0, "lon_deg": 11.5, "alt_amsl_m": 500.0, "x_heading_deg": 90.0}}
