"""Vehicles with a network link and a radio each: the choice, the plan of the radio, orders; in virtual time."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from pathlib import Path

import pytest

from skygcs.core.routing.router import DuplicateFilter
from support.two_links import two_links


def p95(ages_s: list[float]) -> float:
    return ages_s[int(0.95 * len(ages_s))]


@pytest.mark.deep
async def test_the_radio_keeps_in_touch_while_the_network_carries_telemetry_and_takes_over(tmp_path: Path) -> None:
    async with two_links(tmp_path) as field:
        await field.until(lambda: all(v["standby"] and v["settled"] for v in field.air()["vehicles"]))
        await asyncio.sleep(15)
        reduced = field.air()["down"]
        assert reduced["planned_bytes_per_s"] == 3 * 41 and reduced["measured_bytes_per_s"] < 300
        before = await field.watch(10)
        # cut
        for port in field.ports.values():
            port.cut = True
        cut_at = field.daemon.now()
        assert await field.carried_by("air") - cut_at <= 2.5
        cut = await field.watch(20)
        assert field.air()["down"]["planned_bytes_per_s"] > 500
        assert p95(before) <= 0.3 and p95(cut) <= 1.0 and max(cut) <= 3.5
        # restored
        for port in field.ports.values():
            port.cut = False
        await field.carried_by("wifi")
        assert all(field.links(sysid)["air"]["changes"] >= 2 for sysid in (1, 2, 3))


async def test_copies_over_a_link_that_is_late_and_loses_are_forwarded_once() -> None:
    rng = random.Random(5)
    seen = DuplicateFilter()
    arrivals = []
    for number in range(2000):
        sent_at = number * 0.05
        if rng.random() >= 0.1:
            arrivals.append((sent_at + 0.01 * rng.random(), 1, number))
        if rng.random() >= 0.2:
            arrivals.append((sent_at + 0.8 + 0.15 * rng.random(), 2, number))
    forwarded = Counter(
        number
        for at, channel_id, number in sorted(arrivals)
        if seen.first_heard_on(number, channel_id, at) == channel_id
    )
    assert set(forwarded.values()) == {1}
    assert len(forwarded) == len({number for _, _, number in arrivals})
