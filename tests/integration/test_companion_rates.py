"""Message rates when the ground and the companion ask one autopilot, on the one port that both share."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.frame import Frame
from support.companion_pair import Pair, companion_pair
from support.daemons import listening
from support.flown import KINDS

POSITION, MISSED = "GLOBAL_POSITION_INT", "ATTITUDE_QUATERNION"
"""The second is what neither firmware sends by itself: what arrives, at whatever rate, is asked for by nobody."""


def hz(pair: Pair, message: str) -> float:
    """What the autopilot streams."""
    return 1.0 / pair.pi.sim().streams.interval(message)


def watch_requests(pair: Pair) -> list[tuple[float, int]]:
    """Time and message id of each rate that is set at the autopilot from now on, by whomever."""
    found: list[tuple[float, int]] = []

    def hear(frame: Frame, _: float) -> None:
        if frame.fields()["command"] == mav_cmd.SET_MESSAGE_INTERVAL:
            found.append((pair.now, int(frame.fields()["param1"])))

    listening(pair.pi.sim(), hear, "COMMAND_LONG")
    return found


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize(("ground_hz", "companion_hz"), [(2.0, 8.0), (8.0, 2.0)])
async def test_two_that_want_other_rates_do_not_take_turns(
    tmp_path: Path, kind: dict[str, Any], ground_hz: float, companion_hz: float
) -> None:
    """Without a radio's plan any rate will do: whoever misses a message asks for it, and nobody slows it down."""
    wanted = {POSITION: ground_hz, MISSED: ground_hz}, {POSITION: companion_hz, MISSED: companion_hz}
    async with companion_pair(tmp_path, streams=wanted, **kind) as pair:
        asked = watch_requests(pair)
        await asyncio.sleep(60)
        settled, rates = pair.now, (hz(pair, POSITION), hz(pair, MISSED))
        assert min(rates) >= 1.9, "both arrive"
        await asyncio.sleep(120)
        assert not [at for at, _ in asked if at > settled]
        assert (hz(pair, POSITION), hz(pair, MISSED)) == rates


@KINDS
async def test_what_control_at_the_companion_needs_is_not_slowed_by_the_ground(
    tmp_path: Path, kind: dict[str, Any]
) -> None:
    async with companion_pair(tmp_path, streams=({POSITION: 2.0}, {}), **kind) as pair:
        asked = watch_requests(pair)
        await asyncio.sleep(15)
        before = hz(pair, POSITION)
        await pair.done("control.set", mode="attitude")
        await asyncio.sleep(5)
        assert hz(pair, POSITION) == pytest.approx(50.0, rel=0.1)
        began = pair.now
        await asyncio.sleep(25)
        assert hz(pair, POSITION) == pytest.approx(50.0, rel=0.1)
        assert not [at for at, _ in asked if at > began]
        await pair.done("control.set", mode="off")
        await asyncio.sleep(30)
        assert hz(pair, POSITION) == pytest.approx(max(before, 2.0), rel=0.3)
