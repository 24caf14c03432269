"""Attitude at the rate that the link leaves: the law integrates all of the time there is."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path

import pytest

from skygcs.runtime.link_view import LinkView
from skygcs.sim.quad import Quad
from skygcs.sim.wind import Wind
from support.flown import flown


@pytest.mark.deep
async def test_at_20_hz_it_recovers_from_wind_as_fast_as_at_50(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the beginning of 5 m/s of wind until it stays within 0.1 m of its place."""
    recovered_s = []
    for share in (math.inf, 20.5 * 51 + 140):
        monkeypatch.setattr(LinkView, "setpoint_bytes_per_s", lambda view, vehicle, flown, share=share: share)
        async with flown(tmp_path) as gcs:
            await gcs.fly("attitude")
            await asyncio.sleep(5.0)
            (x, y, _), motion, began = gcs.place(), gcs.sim().motion, gcs.now
            assert isinstance(motion, Quad)
            motion.wind = Wind((5.0, 0.0, 0.0))
            await asyncio.sleep(30.0)
            rate_hz = len(gcs.setpoints(gcs.now - 2.0)) / 2.0
            assert rate_hz == pytest.approx(50 if share == math.inf else 20, abs=1.0)
            assert gcs.control()["control_mode"] == "attitude"
            outside = [t.at for t in gcs.truth[1] if t.at >= began and math.dist(t.pos_m[:2], (x, y)) > 0.1]
            recovered_s.append(outside[-1] - began)
    fast_s, slow_s = recovered_s
    print("recovered", recovered_s)
    assert slow_s == pytest.approx(fast_s, rel=0.1)
