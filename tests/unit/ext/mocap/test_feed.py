"""Frames of more bodies than are listed."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skygcs.config.models import OriginConfig
from skygcs.ext.mocap.config import MocapConfig
from skygcs.ext.mocap.feed import MAX_SEEN, MocapFeed
from skygcs.ext.mocap.pose import Pose
from skygcs.ext.mocap.recording import CaptureFrameData

LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.mark.looptime
async def test_the_bodies_of_all_vehicles_count_as_others_and_the_rest_is_bounded() -> None:
    """The 65th vehicle's body was no other body: one that had taken its markers was believed."""
    names = [f"v{n}" for n in range(1, MAX_SEEN + 7)]
    vehicles = {name: SimpleNamespace(sysid=number) for number, name in enumerate(names, start=1)}
    core = cast(
        Any,
        SimpleNamespace(
            hub=SimpleNamespace(dialect=SimpleNamespace(by_name={})),
            fleet=None,
            event_log=SimpleNamespace(publish=None),
            config=SimpleNamespace(vehicles=vehicles),
        ),
    )
    config = MocapConfig.model_validate({"type": "vicon", "host": "h", "bodies": {name: name for name in names}})
    feed = MocapFeed(core, config, OriginConfig(lat_deg=43.0, lon_deg=-79.0, alt_amsl_m=100.0))
    now = asyncio.get_running_loop().time()
    for n, name in enumerate([*(f"stranger{n}" for n in range(10 * MAX_SEEN)), *names]):
        feed.on_frame(CaptureFrameData(now, {name: Pose(now, (1.0 + n, 0.0, 1.0), LEVEL)}), now)
    assert len(feed._others("v1", now)) == len(feed._last_seen) - 1 == MAX_SEEN + len(names) - 1
