"""Attitude begins without a bump, in wind and with a wrong hover thrust."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path

import pytest

from skygcs.sim.conditions import CALM, Conditions
from support.flown import KINDS, Flown, aloft

WIND = Conditions(wind_enu_mps=(3.0, 4.0, 0.0))


def moved_m(gcs: Flown, since: float) -> tuple[float, float]:
    """How far it was from where it was then, at most: in the plane, and up or down."""
    looks = [t.pos_m for t in gcs.truth[1] if t.at >= since]
    x, y, z = looks[0]
    return max(math.hypot(p[0] - x, p[1] - y) for p in looks), max(abs(p[2] - z) for p in looks)


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize(("conditions", "wrong"), [(WIND, 1.0), (CALM, 1.25), (CALM, 0.8)], ids=["wind", "high", "low"])
async def test_entry(tmp_path: Path, kind: dict[str, int], conditions: Conditions, wrong: float) -> None:
    """``wrong``: the share of the hover thrust that is configured."""
    control = {"hover_thrust": round(0.45 / 1.11 * wrong, 3)}  # a full battery gives 1.11 of the nominal thrust
    async with aloft(tmp_path, conditions=conditions, control=control, **kind) as gcs:
        await asyncio.sleep(10.0)
        began = gcs.now
        await gcs.fly("attitude")
        await asyncio.sleep(15.0)
        plane_m, height_m = moved_m(gcs, began)
        assert plane_m <= 0.25 and height_m <= 0.1
