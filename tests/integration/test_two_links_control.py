"""Setpoints and a dead uplink over two links: the switch in flight, and a link that carries telemetry only."""

from __future__ import annotations

import asyncio
import itertools
import math
from pathlib import Path
from typing import Any

import pytest

from support.called import call
from support.flown import SETPOINTS
from support.two_links import Delivered, TwoLinks, two_links

GOAL = [20.0, 0.0, 10.0]
KINDS = pytest.mark.parametrize("kind", [{"px4": 1, "ardupilot": 0}, {"px4": 0, "ardupilot": 1}], ids=str)


async def order(field: TwoLinks, method: str, **params: Any) -> None:
    outcomes = (await call(field.daemon, method, targets="all", **params))["outcomes"]
    assert all(o["ok"] for o in outcomes.values()), outcomes


async def flying(field: TwoLinks) -> None:
    """At 10 m under control by position."""
    await order(field, "vehicles.takeoff", height_m=10.0, wait_s=90)
    await asyncio.sleep(15)
    await order(field, "control.set", mode="position")
    await asyncio.sleep(8)


def setpoints(field: TwoLinks, since: float) -> list[Delivered]:
    return [d for d in field.delivered if d.name in SETPOINTS and d.at >= since]


def place(field: TwoLinks) -> tuple[float, float, float]:
    (actor,) = field.daemon.fleet.vehicles.values()
    state = actor.state(field.daemon.now())
    x, y, up = state["position"]["enu_m"]
    return float(x), float(y), float(up)


@KINDS
async def test_setpoints_change_over_in_flight_and_come_over_one_link_at_a_time(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with two_links(tmp_path, **kind) as field:
        await flying(field)
        assert {d.over for d in setpoints(field, field.daemon.now() - 5)} == {"wifi"}
        await order(field, "vehicles.goto", enu_m=GOAL)
        await asyncio.sleep(2)
        port = field.ports[1]
        port.cut = True
        began = field.daemon.now()
        switched = await field.carried_by("air")
        assert switched - began < 2.5
        await asyncio.sleep(20)
        came = setpoints(field, began)
        assert {d.over for d in came} == {"air"}
        gaps = [b.at - a.at for a, b in itertools.pairwise(came)]
        assert came[0].at - began < 3.0 and max(gaps) < 1.0, "neither a hole nor a stop of the stream"
        assert math.dist(place(field), GOAL) < 1.0, "it went on to its goal"
        # back to the network while setpoints flow
        port.cut = False
        back = await field.carried_by("wifi")
        await asyncio.sleep(10)
        after = setpoints(field, back)
        late = [d.at - back for d in after if d.over == "air"]
        assert max(late, default=0.0) < 1.5, "what was in the air arrives at most a round later"
        assert [d for d in after if d.over == "wifi"] and math.dist(place(field), GOAL) < 1.0
        (status,) = await call(field.daemon, "control.status", targets="all")
        assert status["state"] == "flying"


@KINDS
async def test_a_link_over_which_the_vehicle_does_not_hear_us_is_left_in_flight(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with two_links(tmp_path, **kind) as field:
        await flying(field)
        port = field.ports[1]
        changes = field.links(1)["air"]["changes"]
        port.deaf = True
        began = field.daemon.now()
        switched = await field.carried_by("air")
        assert switched - began < 5.0
        assert any("does not hear us over it" in text for text in field.switches())
        await field.until(lambda: any("hears us again" in text for text in field.events("uplink_back")), 10.0)
        await order(field, "vehicles.goto", enu_m=GOAL)
        await asyncio.sleep(60)
        assert math.dist(place(field), GOAL) < 1.0
        shown = field.links(1)
        assert shown["wifi1"]["deaf"] and shown["wifi1"]["health"] == "poor" and not shown["air"]["deaf"]
        assert shown["air"]["changes"] == changes + 1, "its telemetry comes, and it is not taken again"
        port.deaf = False
        await field.carried_by("wifi")
        assert not field.links(1)["wifi1"]["deaf"]
        assert field.links(1)["air"]["changes"] == changes + 2
