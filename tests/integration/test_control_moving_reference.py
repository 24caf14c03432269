"""Moving references in `position`, flown by simulated autopilots behind slow and lossy links."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skygcs.sim.conditions import Conditions
from support.companion_pair import Point, circle
from support.examples import covered_by_other_flights
from support.flown import Flown, aloft

KINDS = pytest.mark.parametrize("kind", [{"px4": 1}, {"px4": 0, "ardupilot": 1}], ids=["px4", "ardupilot"])
WINDY = Conditions(wind_enu_mps=(5.0, 0.0, 0.0), gust_mps=1.0)
HEIGHT_M = 10.0
STREAM_HZ = 5.0
LOSS = 0.1


async def rms_m(gcs: Flown, path: Callable[[float], Point], seconds: float, *, loss: float = LOSS) -> float:
    """Stream a path, and the root mean square of the truth's distance to it after the first 10 s."""
    luck = random.Random(7)
    began = gcs.now
    while gcs.now < began + seconds:
        (x, y), (vx, vy), (ax, ay) = path(gcs.now - began)
        if luck.random() >= loss:
            await gcs.done(
                "control.setpoint",
                pos_enu_m=[x, y, HEIGHT_M],
                vel_enu_mps=[vx, vy, 0.0],
                acc_enu_mps2=[ax, ay, 0.0],
                valid_s=1.0,
            )
        await asyncio.sleep(1.0 / STREAM_HZ)
    looks = [look for look in gcs.truth[1] if look.at >= began + 10.0]
    off = [math.dist(look.pos_m[:2], path(look.at - began)[0]) for look in looks]
    return math.sqrt(sum(d * d for d in off) / len(off))


@covered_by_other_flights
@pytest.mark.parametrize(
    ("kind", "delay_s", "path", "limit_m"),
    [({"px4": 1}, 0.05, circle, 0.35), ({"px4": 0, "ardupilot": 1}, 0.8, circle, 0.35)],
    ids=["px4-circle", "ardupilot-circle"],
)
async def test_a_path_is_followed_over_a_slow_link(
    tmp_path: Path, kind: dict[str, int], delay_s: float, path: Callable[[float], Point], limit_m: float
) -> None:
    """``delay_s`` both ways together; every combination is measured by `make bench-control`."""
    control: dict[str, Any] = {"position_hz": 5.0, "position_stale_s": 4.0}
    async with aloft(tmp_path, **kind, delay_s=delay_s / 2, conditions=WINDY, control=control) as gcs:
        await gcs.fly("position")
        (x, y), _, _ = path(0.0)
        await gcs.done("vehicles.goto", enu_m=[x, y, HEIGHT_M])
        await asyncio.sleep(12)
        assert await rms_m(gcs, path, 30.0) <= limit_m


@covered_by_other_flights
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
