"""Vehicles with a network link and a radio each: the choice, the plan of the radio, orders; in virtual time."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from support.two_links import two_links

pytestmark = pytest.mark.looptime


def p95(ages_s: list[float]) -> float:
    return ages_s[int(0.95 * len(ages_s))]


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
