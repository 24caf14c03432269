"""Flown by attitude, and the uplink gets slow while all telemetry comes: noticed within 0.7 s. Loss is no delay."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from support.flown import KINDS, aloft


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("phase_s", [0.0, 0.05, 0.1, 0.15, 0.19])
async def test_an_uplink_that_gets_slow_ends_attitude_within_0_7_s(
    tmp_path: Path, kind: dict[str, int], phase_s: float
) -> None:
    async with aloft(tmp_path, delay_s=0.01, **kind) as gcs:
        await gcs.fly("attitude")
        start = gcs.place()
        await asyncio.sleep(6.0)
        await gcs.step(8.0, 0.0, 0.0)
        await asyncio.sleep(2.0)
        ping = [s.at for s in gcs.sent if s.name == "TIMESYNC"][-1]
        await gcs.until(lambda: [s.at for s in gcs.sent if s.name == "TIMESYNC"][-1] > ping)
        await asyncio.sleep(phase_s)
        slow, gcs.uplink_delay_s = gcs.now, 0.575
        left = await gcs.until(lambda: gcs.control()["control_mode"] != "attitude")
        assert left - slow <= 0.7
        (text,) = gcs.texts(slow)[:1]
        assert text.startswith("flown by velocity setpoints: state age plus setpoint transport is at least 0.")
        assert "s, by pings that are not answered (limit for attitude 0.1 s)" in text
        await asyncio.sleep(12.0)
        assert gcs.farthest_m(slow, of=(start[0] + 8.0, start[1], start[2])) < 8.0, "it never leaves the step"
        assert gcs.place() == pytest.approx((start[0] + 8.0, start[1], start[2]), abs=0.5)


@pytest.mark.deep
async def test_loss_is_no_delay(tmp_path: Path) -> None:
    """Every twentieth packet is lost, each way."""
    async with aloft(tmp_path, delay_s=0.01) as gcs:
        await gcs.fly("attitude")
        for network in (gcs.link.inward, gcs.link.outward):
            network._config = network._config.model_copy(update={"loss": 0.05})
        began = gcs.now
        await asyncio.sleep(120.0)
        assert not gcs.texts(began)
