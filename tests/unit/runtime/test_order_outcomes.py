from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

import pytest

from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.order_runner import OrderOutcomes
from support.vehicles import flight_dialect

pytestmark = pytest.mark.looptime


async def test_each_order_is_reported_once_whatever_ends_it() -> None:
    events: list[Event] = []
    vehicle = Vehicle(1, 1, flight_dialect())
    outcomes = OrderOutcomes(vehicle, asyncio.get_running_loop(), events.append)

    async def work(result: Any, lasts_s: float = 1.0) -> Outcome:
        await asyncio.sleep(lasts_s)
        assert isinstance(result, Outcome)
        return result

    async def tracked(order: str, its_work: Coroutine[Any, Any, Outcome]) -> Outcome:
        with outcomes.tracked(order) as ended:
            return ended(await its_work)

    assert (await tracked("arm", work(Outcome(True, "accepted", "armed")))).ok
    outcomes.report_progress("calibrate", 40)
    outcomes.report_progress("calibrate", None)
    gone = asyncio.create_task(tracked("goto", work(Outcome(True, "accepted", "there"), 60.0)))
    stops = [asyncio.create_task(tracked("stop", work(Outcome(True, "accepted", "held"), 60.0))) for _ in "ab"]
    await asyncio.sleep(2.0)
    outcomes.cut_stops("the computer slept")
    for task in (gone, *stops):
        task.cancel()
    await asyncio.gather(gone, *stops, return_exceptions=True)
    outcomes.cut_stops("again")
    assert [(e.data["order"], e.data["result"]) for e in events if e.data is not None] == [
        ("arm", "accepted"),
        ("calibrate", "in_progress"),
        ("calibrate", "in_progress"),
        *[("stop", "lost")] * 2,
        ("goto", "cancelled"),
        *[("stop", "cancelled")] * 2,
    ]
    assert [e.text for e in events[1:3]] == ["calibrate: in progress 40 %", "calibrate: in progress"]
    assert "elapsed_s" in (events[5].data or {}) and events[5].data["elapsed_s"] == pytest.approx(2.0)
