"""What the link does not bear is not flown: it is told with the figures, and the fallback settles."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.runtime.link_view import LinkView
from support.examples import covered_by_other_flights
from support.flown import aloft

pytestmark = pytest.mark.looptime

KINDS = pytest.mark.parametrize("kind", [{"px4": 1}, {"px4": 0, "ardupilot": 1}], ids=["px4", "ardupilot"])


@covered_by_other_flights
@KINDS
async def test_three_tenths_of_a_second_of_delay(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, delay_s=0.15, **kind) as gcs:
        began = gcs.now
        outcome = await gcs.outcome("control.set", mode="attitude")
        assert outcome["ok"], outcome
        assert outcome["message"].startswith("flown by velocity setpoints and not by attitude: state age plus setpoint")
        assert "(limit for attitude 0.1 s)" in outcome["message"]
        figure = float(outcome["message"].split("setpoint transport is ")[1].split(" s")[0])
        assert 0.3 <= figure < 0.5
        start = await gcs.steps_exactly(20)
        # the firmwares' velocity loops lag by half a second: with the delay a third of the step too far
        assert gcs.farthest_m(began, of=start) < 4.1
        assert "SET_ATTITUDE_TARGET" not in {s.name for s in gcs.setpoints(began)}
        assert gcs.control()["control_mode"] == "velocity"
        assert len(gcs.texts(began)) <= 1, "the order's outcome has told it already"


@covered_by_other_flights
@KINDS
async def test_six_tenths_leave_position_alone(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, delay_s=0.35, **kind) as gcs:
        began = gcs.now
        outcome = await gcs.outcome("control.set", mode="attitude")
        assert outcome["message"].startswith("flown by position setpoints and not by attitude"), outcome
        await gcs.steps_exactly(20)
        late = gcs.setpoints(began + 8.0)
        assert late and {s.name for s in late} == {"SET_POSITION_TARGET_GLOBAL_INT"}


@covered_by_other_flights
async def test_a_radio_that_leaves_too_few_setpoints_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `setpoint_bytes_per_s` tells it of a radio at 19200 baud: 480 B/s, 9.4 setpoints of 51 B."""
    monkeypatch.setattr(LinkView, "setpoint_bytes_per_s", lambda view, vehicle, flown: 480.0)
    async with aloft(tmp_path) as gcs:
        began = gcs.now
        outcome = await gcs.outcome("control.set", mode="attitude")
        assert "not by attitude: the link leaves 9.41 setpoints per second (attitude needs 20)" in outcome["message"]
        assert "on average 0.053 s of additional delay" in outcome["message"]
        await gcs.steps_exactly(20)
        assert "SET_ATTITUDE_TARGET" not in {s.name for s in gcs.setpoints(began)}


async def test_a_radio_that_gets_busy_in_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = [1440.0]
    monkeypatch.setattr(LinkView, "setpoint_bytes_per_s", lambda view, vehicle, flown: left[0])
    async with aloft(tmp_path) as gcs:
        await gcs.fly("attitude")
        await gcs.step(3.0, 0.0, 0.0)
        await asyncio.sleep(5)
        rate_hz = len(gcs.setpoints(gcs.now - 2.0)) / 2.0
        assert rate_hz == pytest.approx((1440 - 140) / 51, abs=1.0), (
            "as many as the link bears, not the 50 that are configured"
        )
        start, busy = gcs.place(), gcs.now
        left[0] = 720.0
        await asyncio.sleep(10)
        assert "SET_ATTITUDE_TARGET" not in {s.name for s in gcs.setpoints(busy + 0.3)}
        (told,) = gcs.texts(busy)
        assert told.startswith("flown by velocity setpoints: the link leaves 14.1 setpoints per second")
        assert gcs.farthest_m(busy, of=start) < 1.0
