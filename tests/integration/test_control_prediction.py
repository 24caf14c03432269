"""Velocity control with prediction in a whole daemon: followed over 0.8 s, refused where it must be, replayed."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.control.trace import decode, rerun
from skygcs.sim.conditions import Conditions
from support.flown import KINDS, Flown, aloft

WIDE = {"x_m": [-50, 50], "y_m": [-50, 50], "up_m": [0, 40]}
PREDICTED: dict[str, Any] = {"velocity_predictor": True, "fence": WIDE}
WIND = Conditions(wind_enu_mps=(4.0, 3.0, 0.0), gust_mps=1.0)


def air(delay_s: float) -> dict[str, Any]:
    """A link with half of the delay each way."""
    return {"air": {"type": "memory", "role": "radio", "delay_s": delay_s / 2}}


def lines_of(trace: Path) -> list[str]:
    return trace.read_text(encoding="ascii").splitlines(keepends=True)


async def circle(gcs: Flown, seconds: float) -> float:
    """Stream a circle of 5 m at 2 m/s; the RMS error after the first 15 s."""
    (x, y, z), began, off = gcs.place(), gcs.now, []
    while (t := gcs.now - began) < seconds:
        c, s = math.cos(0.4 * t), math.sin(0.4 * t)
        there = (x + 5 * c - 5, y + 5 * s, z)
        await gcs(
            "control.setpoint",
            targets="v1",
            pos_enu_m=list(there),
            vel_enu_mps=[-2 * s, 2 * c, 0.0],
            acc_enu_mps2=[-0.8 * c, -0.8 * s, 0.0],
        )
        if t > 15.0:
            off.append(math.dist(there, gcs.place()))
        await asyncio.sleep(0.05)
    return math.sqrt(sum(d * d for d in off) / len(off))


@KINDS
async def test_a_circle_over_0_8_s_is_followed_and_runs_again_bit_for_bit(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, control=PREDICTED, conditions=WIND, links=air(0.8), **kind) as gcs:
        await gcs("control.record", targets="v1", on=True)
        began = gcs.now
        await gcs.fly("velocity")
        await asyncio.sleep(4.0)
        state = gcs.control()["prediction"]
        assert state["active"] and state["refused"] is None
        assert state["round_trip_s"] == pytest.approx(0.8, abs=0.03)
        assert await circle(gcs, 30.0) < 0.35
        assert gcs.control()["control_mode"] == "velocity"
        assert [t for t in gcs.texts(began) if "predicted over" in t]
        path = Path(gcs.control()["recording"])
        await gcs("control.record", targets="v1", on=False)
    entries = list(decode(lines_of(path)))
    predicted = [entry for entry in entries if entry.row.round_trip_s is not None]
    assert len(predicted) > 300
    assert all(entry.row.predicted_enu_m and entry.row.disturbance_enu_mps2 for entry in predicted)
    assert list(rerun(entries)) == []


async def test_without_the_setting_the_same_delay_is_flown_by_position(tmp_path: Path) -> None:
    async with aloft(tmp_path, control={"fence": WIDE}, links=air(0.8)) as gcs:
        outcome = await gcs.outcome("control.set", mode="velocity")
        assert "flown by position setpoints and not by velocity" in outcome["message"]
        assert gcs.control()["prediction"] is None


async def test_with_a_delay_beyond_the_margin_position_is_flown(tmp_path: Path) -> None:
    async with aloft(tmp_path, control=PREDICTED, links=air(1.6)) as gcs:
        outcome = await gcs.outcome("control.set", mode="velocity")
        assert "flown by position setpoints" in outcome["message"]
        assert "may be wrong by" in gcs.control()["prediction"]["refused"]


async def test_one_position_a_second_is_too_few(tmp_path: Path) -> None:
    """What a busy radio may leave: velocity is flown without prediction, and says why."""
    control = {**PREDICTED, "stale_s": 1.9, "velocity_delay_s": 1.8}
    async with aloft(tmp_path, control=control, links=air(0.1)) as gcs:
        await gcs.fly("velocity")
        await asyncio.sleep(4.0)
        assert gcs.control()["prediction"]["active"]
        began = gcs.now
        gcs.sim().streams.set_interval("GLOBAL_POSITION_INT", 1.0, gcs.now)  # by another station
        await asyncio.sleep(8.0)
        state = gcs.control()
        assert state["control_mode"] == "velocity"
        assert not state["prediction"]["active"] and "s old in 95 of 100 ticks" in state["prediction"]["refused"]
        assert [t for t in gcs.texts(began) if "not predicted any more" in t]


@pytest.mark.deep  # a further delay of the same flight
async def test_a_jump_of_the_delay_neither_jolts_it_nor_ends_control(tmp_path: Path) -> None:
    async with aloft(tmp_path, control=PREDICTED, links=air(0.2)) as gcs:
        await gcs.fly("velocity")
        await asyncio.sleep(5.0)
        for network in (gcs.link.inward, gcs.link.outward):
            network._config = network._config.model_copy(update={"delay_s": 0.35})
        began = gcs.now
        await asyncio.sleep(20.0)
        assert gcs.control()["control_mode"] == "velocity"
        assert gcs.farthest_m(began) < 0.1
        assert gcs.control()["prediction"]["round_trip_s"] == pytest.approx(0.7, abs=0.05)


@pytest.mark.deep  # a further loss of the same flight
async def test_states_that_are_lost_do_not_end_prediction(tmp_path: Path) -> None:
    """A tenth of all packets, both ways, at the 5 Hz that a radio may leave."""
    async with aloft(tmp_path, control={**PREDICTED, "stale_s": 1.5}, conditions=WIND, links=air(0.4)) as gcs:
        await gcs.fly("velocity")
        gcs.sim().streams.set_interval("GLOBAL_POSITION_INT", 0.2, gcs.now)  # by another station
        for network in (gcs.link.inward, gcs.link.outward):
            network._config = network._config.model_copy(update={"loss": 0.1})
        assert await circle(gcs, 45.0) < 0.35
        assert gcs.control()["prediction"]["active"]
