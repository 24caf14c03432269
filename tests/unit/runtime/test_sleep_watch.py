"""A computer that slept takes nothing of before for new."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skygcs.config.dialects import load_dialect
from skygcs.config.models import DaemonConfig, FleetConfig, SimulatedLinkConfig
from skygcs.daemon import Daemon
from skygcs.runtime.sleep_watch import SleepWatch
from support.called import call

pytestmark = pytest.mark.looptime


def test_it_notices_each_sleep_once_and_no_jitter() -> None:
    slept, woke = [100.0], list[float]()
    watch = SleepWatch(woke.append, lambda: slept[0])
    assert not watch.check()
    slept[0] += 0.001
    assert not watch.check()
    slept[0] += 3600.0
    assert watch.check() and not watch.check()
    assert woke == [pytest.approx(3600.001)]


async def test_control_ends_with_a_sleep_and_states_of_before_are_as_old_as_they_are(tmp_path: Path) -> None:
    config = FleetConfig(
        daemon=DaemonConfig(socket=tmp_path / "s", log_dir=tmp_path, record=False),
        links={"air": SimulatedLinkConfig(name="air", px4=0, ardupilot=1)},
    )
    daemon = Daemon(config, load_dialect(config.dialect))
    task = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    try:
        await until(lambda: bool(daemon.fleet.vehicles))
        await asyncio.sleep(10)
        await call(daemon, "vehicles.arm", targets="all", wait_s=90.0)
        await call(daemon, "vehicles.takeoff", targets="all", height_m=10.0, wait_s=60.0)
        await asyncio.sleep(20)
        await call(daemon, "origin.from_vehicle", target="1")
        outcomes = (await call(daemon, "control.set", targets="all", mode="velocity"))["outcomes"]
        assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
        await asyncio.sleep(3)
        before = next(iter(daemon.fleet.vehicles.values()))
        assert before.offboard.sends_setpoints
        known = daemon.fleet.sleep.slept_s()
        daemon.fleet.sleep.slept_s = lambda: known + 3600.0
        await asyncio.sleep(before.offboard.controller.period_s)
        assert not before.offboard.clock.running  # the next tick did not use a state of an hour ago
        assert before not in daemon.fleet.vehicles.values()
        await asyncio.sleep(10)
        slept = [event for event in daemon.event_log.recent if "slept for 3600 s" in event["text"]]
        assert len(slept) == 1
        (after,) = daemon.fleet.vehicles.values()
        assert after is not before and after.vehicle.connected and not after.offboard.sends_setpoints
        texts = [event["text"] for event in daemon.event_log.recent if event["vehicle"] == after.name]
        assert any("hold" in text for text in texts), texts[-20:]
    finally:
        daemon.stop()
        await task


async def until(condition: Callable[[], Any]) -> None:
    for _ in range(1000):
        if condition():
            return
        await asyncio.sleep(0.1)
    raise AssertionError("it did not come")
