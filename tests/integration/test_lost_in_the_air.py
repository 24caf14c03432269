"""A vehicle that was lost in the air stays in the way of orders until it is heard, or a person forgets it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from support.flown import PAIRS, aloft


@pytest.mark.deep
@PAIRS
async def test_nobody_is_sent_to_the_place_of_one_that_is_silent(tmp_path: Path, kind: dict[str, int]) -> None:
    """At 10 s of silence a goto to its place was accepted: true separation 0.00 m."""
    async with aloft(tmp_path, **kind) as gcs:
        there = list(gcs.place("v2"))
        gcs.muted.add(2)
        muted = gcs.now
        for silent_s in (2.6, 8.2, 10.5, 60.0):
            await asyncio.sleep(muted + silent_s - gcs.now)
            outcome = await gcs.outcome("vehicles.goto", enu_m=there)
            assert outcome["result"] == "refused" and "v2" in outcome["message"], (silent_s, outcome)
        assert "lost in the air" in outcome["message"] and "skygcs-cli forget v2 --force" in outcome["message"]
        far = await gcs.outcome("vehicles.goto", enu_m=[-200.0, 0.0, 10.0])
        assert far["ok"], far
        await gcs.done("vehicles.hold")
        forgotten = (await gcs("vehicles.forget", targets="v2", force=True))["outcomes"]["v2"]
        assert forgotten["ok"]
        await asyncio.sleep(1.0)
        assert (await gcs.outcome("vehicles.goto", enu_m=there))["ok"]


@PAIRS
async def test_one_that_was_lost_on_its_way_home_is_in_the_way_all_the_way(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    """It counted only where it was heard last: another one was sent to hover above its home."""
    async with aloft(tmp_path, **kind) as gcs:
        home = gcs.place_of_home("v2")
        await gcs.done("vehicles.goto", targets="v2", enu_m=[home[0], 200.0, 10.0])
        await asyncio.sleep(60.0)
        await gcs.done("vehicles.rtl", targets="v2")
        await asyncio.sleep(2.0)
        gcs.muted.add(2)
        await asyncio.sleep(15.0)
        for there in ([home[0], home[1], 6.0], [home[0], 30.0, 14.0]):
            outcome = await gcs.outcome("vehicles.goto", enu_m=there)
            assert "near v2 (lost in the air; once you know" in outcome["message"], outcome
        assert (await gcs.outcome("vehicles.goto", enu_m=[home[0] - 20.0, 30.0, 10.0]))["ok"]
