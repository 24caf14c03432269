"""The orders of one ground end, or go on, when another one gets the companion."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory.trajectory_clock import ClockOrder
from skygcs.ext.companions.ground_orders import GroundOrders

IDS = 255, 25


@pytest.mark.looptime
async def test_an_order_of_another_ground_is_not_confused_with_one_that_has_its_number(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop = asyncio.get_running_loop()
    ends = {"old": loop.create_future(), "new": loop.create_future()}
    fleet = cast(Any, SimpleNamespace(vehicles={}, origin=None))
    orders = GroundOrders("v1", "hold", 5.0, fleet, loop, lambda event: None)

    async def carry_out(number: int, order: str, given: dict[str, Any]) -> Outcome:
        return Outcome(True, "accepted", await ends[given["ends"]])

    def ask(ground: str, ends: str) -> asyncio.Task[dict[str, Any]]:
        return asyncio.create_task(orders.order(ground, orders.book.session, 3, 1e9, "gains", {"ends": ends}))

    monkeypatch.setattr(orders, "_carry_out", carry_out)
    orders.contact("one", IDS)
    ask("one", "old")
    await asyncio.sleep(6)
    orders._early = 7, {8: ClockOrder("pause", 1.0)}
    orders.contact("another", IDS)
    assert orders._early == (0, {}), "its numbers name no flight of the other one"
    asked = [ask("another", "new")]
    ends["old"].set_result("of the one before")
    await asyncio.sleep(1)
    asked.append(ask("another", "new"))
    await asyncio.sleep(1)
    ends["new"].set_result("its own")
    assert [(await one)["outcome"]["message"] for one in asked] == ["its own", "its own"]
