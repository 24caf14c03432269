"""A few random flights: no vehicle is unattended for longer than promised, no pair of a plan inside its margin, and no
order brings two too near each other.

`make bench-invariant` flies a thousand of them, and `make test-deep` one by a companion.
"""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import pytest

from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.sim.conditions import conditions_of
from support.flown import flown
from support.random_companions import fly_by_companion
from support.random_flights import fly_randomly, watched
from support.random_orders import fly_by_orders
from support.random_plans import fly_a_plan


async def test_orders_denials_pilots_links_and_restarts(tmp_path: Path) -> None:
    judged = await fly_randomly(tmp_path, 16)
    assert not judged.breaches, (judged.breaches, judged.done)
    assert judged.looked > 100 and judged.attended_again > 0


async def test_a_plan_that_is_interfered_with(tmp_path: Path) -> None:
    judged = await fly_a_plan(tmp_path, 1)
    assert not judged.breaches and not judged.inside, (judged.breaches, judged.inside, judged.done)


@pytest.mark.deep
async def test_a_companion_and_its_ground_that_are_lost(tmp_path: Path) -> None:
    judged = await fly_by_companion(tmp_path, 3)
    assert not judged.breaches, (judged.breaches, judged.done)


@pytest.mark.deep
@pytest.mark.parametrize("checked", [True, False])
async def test_orders_that_are_accepted_bring_nobody_too_near_another(tmp_path: Path, checked: bool) -> None:
    """Without the checks of the product the judge must find some."""
    refusal = SeparationMonitor.goto_refusal if checked else lambda *_, **__: None
    with mock.patch.object(SeparationMonitor, "goto_refusal", refusal):
        judged = await fly_by_orders(tmp_path, 34)
    assert bool(judged.inside) is not checked, (judged.inside, judged.done)


async def test_the_monitor_sees_a_vehicle_that_nobody_flies(tmp_path: Path) -> None:
    """Without the watch of the product: what is tested must be able to fail."""
    windy = conditions_of(wind_mps=6.0)
    async with flown(tmp_path, px4=0, ardupilot=1, conditions=windy, in_air=True) as gcs, watched(gcs) as monitor:
        gcs.actor().unattended.tick = lambda now, site: None  # type: ignore[method-assign]
        await gcs.fly("attitude")
        gcs.actor().offboard.release("a fault")
        await gcs.until(lambda: monitor.breaches, 5.0)
        assert monitor.breaches[0].fed_by == "daemon"
