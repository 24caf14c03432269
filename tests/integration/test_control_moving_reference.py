"""Moving references in `position`, flown by simulated autopilots behind slow and lossy links."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from support.flown import KINDS, aloft


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("across", [True, False], ids=["velocity across", "velocity up"])
async def test_a_mixed_climb_does_not_swing_at_two_seconds_of_delay(
    tmp_path: Path, kind: dict[str, int], across: bool
) -> None:
    """A loop closed on the ground swung by 7.5 m."""
    control = {"position_stale_s": 6.0}
    async with aloft(tmp_path, **kind, delay_s=1.0, control=control) as gcs:
        await gcs.fly("position")
        (x, y, z), began = gcs.place(), gcs.now
        goal_m = z + 3.0
        led_to, given_at, up = z, began, 0.0
        while gcs.now < began + 14.0:
            if across:
                given: dict[str, Any] = {"pos_enu_m": [None, None, goal_m], "vel_enu_mps": [0.5, 0.0, 0.0]}
            else:
                led_to, given_at = led_to + up * (gcs.now - given_at), gcs.now
                up = 0.5 if gcs.now < began + 6.0 else 0.0
                given = {"pos_enu_m": [x, y, None], "vel_enu_mps": [0.0, 0.0, up]}
            await gcs.done("control.setpoint", **given, valid_s=1.0)
            await asyncio.sleep(0.2)
        if not across:
            goal_m = led_to  # by the velocities and the times of the setpoints
        heights = [look.pos_m[2] for look in gcs.truth[1] if look.at >= began]
        # a climb that ends at once from 0.5 m/s needs a braking distance: 0.13 m with 1 m/s², and as much for the jerk
        assert max(heights) < goal_m + (0.1 if across else 0.3)
        assert heights[-1] == pytest.approx(goal_m, abs=0.3)
        if across:
            assert gcs.place()[0] - x == pytest.approx(0.5 * 12.5, abs=1.0)
