"""Requests for rates, to a daemon whose vehicles answer slowly."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from skygcs.errors import RpcError
from skygcs.ext.ros.rate_requests import AGAIN_S, RateRequests

pytestmark = pytest.mark.looptime


class Daemon:
    """Each request takes 2 s."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str, float | None]] = []
        self.refuses = False

    async def call(self, method: str, targets: str, message: str, rate_hz: float | None) -> Any:
        assert method == "vehicles.interval"
        self.asked.append((targets, message, rate_hz))
        await asyncio.sleep(2.0)
        if self.refuses:
            raise RpcError(-32000, "no such vehicle")


class Rig:
    def __init__(self) -> None:
        self.daemon = Daemon()
        self.urgent: dict[str, dict[str, float]] = {}
        clock = asyncio.get_running_loop().time
        self.requests = RateRequests(self.daemon, clock, lambda: self.urgent)  # type: ignore[arg-type]


async def test_what_a_setpoint_needs_is_asked_before_the_rest_of_the_topics() -> None:
    rig = Rig()
    wanted = {f"v{n}": {"ALTITUDE": 2.0} for n in range(5)}
    update = asyncio.create_task(rig.requests.update(wanted))
    await asyncio.sleep(1.0)
    rig.urgent = {"v4": {"ATTITUDE": 5.0}}
    await asyncio.sleep(2.0)
    assert rig.daemon.asked == [("v0", "ALTITUDE", 2.0), ("v4", "ATTITUDE", 5.0)]
    await update
    assert len(rig.daemon.asked) == 6
    rig.urgent = {}
    rig.daemon.asked.clear()
    await rig.requests.update({"v4": {"ALTITUDE": 2.0}})
    assert ("v4", "ATTITUDE", None) in rig.daemon.asked


async def test_a_topics_rate_is_not_lowered_by_a_setpoints() -> None:
    rig = Rig()
    rig.urgent = {"v1": {"ATTITUDE": 5.0}}
    await rig.requests.update({"v1": {"ATTITUDE": 20.0}})
    await rig.requests.update({"v1": {"ATTITUDE": 20.0}})
    assert rig.daemon.asked[-1] == ("v1", "ATTITUDE", 20.0) and len(rig.daemon.asked) <= 2
    rig.daemon.asked.clear()
    await rig.requests.update({"v1": {}})
    assert rig.daemon.asked == []  # 20 Hz are enough
    await asyncio.sleep(AGAIN_S)
    await rig.requests.update({"v1": {}})
    assert rig.daemon.asked == [("v1", "ATTITUDE", 5.0)]


async def test_a_request_that_fails_is_made_again_later_and_not_at_once() -> None:
    rig = Rig()
    rig.daemon.refuses = True
    rig.urgent = {"v1": {"ATTITUDE": 5.0}}
    await rig.requests.update({"v1": {"ALTITUDE": 2.0}, "v2": {"ALTITUDE": 2.0}})
    assert [key[:2] for key in rig.daemon.asked] == [("v1", "ATTITUDE"), ("v1", "ALTITUDE"), ("v2", "ALTITUDE")]
