"""Flown by setpoints, and something is not as it must be: one hold, the reason with its figures, and silence."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from support.flown import KINDS, aloft

KINDS_AND_MODES = pytest.mark.parametrize(
    ("kind", "mode"),
    [
        ({"px4": 1}, "attitude"),
        ({"px4": 0, "ardupilot": 1}, "attitude"),
        ({"px4": 0, "ardupilot": 1}, "velocity"),
        ({"px4": 1}, "position"),
    ],
    ids=["px4-attitude", "ardupilot-attitude", "ardupilot-velocity", "px4-position"],
)
"""Each autopilot, and each way with one of them: that the guard holds whatever the way is tested with the guard."""


@KINDS_AND_MODES
async def test_gps_is_lost(tmp_path: Path, kind: dict[str, int], mode: str) -> None:
    """Without a position no mode holds one: the autopilot lands, by the order's refusal or by its own failsafe."""
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.in_mid_step(mode)
        lost = gcs.now
        gcs.sim().faults.gps_lost = True
        await gcs.until(lambda: gcs.control()["state"] in ("held", "off"), 4.0)
        ended = gcs.now
        await asyncio.sleep(40)
        assert gcs.last_setpoint() <= ended
        assert gcs.sim().motion.on_ground and gcs.farthest_m(lost) < 25.0
        ends = [t for t in gcs.texts(lost) if t.startswith(("holding", "control ended"))]
        assert len(ends) == 1, ends


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("mode", ["attitude", "velocity"])
async def test_a_stream_of_velocities_flies_at_the_wall(tmp_path: Path, kind: dict[str, int], mode: str) -> None:
    """Twenty metres to the wall at 3 m/s: setpoints that would carry it out are refused, and it stops before it."""
    async with aloft(tmp_path, control={"fence": {"x_m": [-20.0, 20.0], "y_m": [-20.0, 20.0]}}, **kind) as gcs:
        await gcs.fly(mode)
        began, refused = gcs.now, ""
        while gcs.now < began + 12.0:
            outcome = await gcs.outcome("control.setpoint", vel_enu_mps=[3.0, 0.0, None], pos_enu_m=[None, None, 10.0])
            refused = refused or ("" if outcome["ok"] else outcome["message"])
            await asyncio.sleep(0.05)
        assert "with this velocity" in refused and "the vehicle is at x " in refused, refused
        assert 5.0 < max(t.pos_m[0] for t in gcs.truth[1]) < 20.0
        assert gcs.control()["state"] == "flying"


@KINDS
async def test_places_outside_are_refused_and_nothing_moves(tmp_path: Path, kind: dict[str, int]) -> None:
    control = {"fence": {"x_m": [-20.0, 20.0], "y_m": [-20.0, 20.0]}}
    async with aloft(tmp_path, control=control, **kind) as gcs:
        await gcs.fly("attitude")
        began = gcs.now
        outside = {"beyond the wall": [30.0, 0.0, 10.0], "in the margin": [19.0, 0.0, 10.0], "high": [0.0, 0.0, 19.0]}
        for enu_m in (*outside.values(), [0.0, 0.0, -1.0]):
            by_goto = await gcs.outcome("vehicles.goto", enu_m=enu_m)
            by_stream = await gcs.outcome("control.setpoint", pos_enu_m=enu_m, valid_s=2.0)
            for outcome in (by_goto, by_stream):
                assert outcome["result"] == "refused", outcome
                assert "fence" in outcome["message"] or "on the ground" in outcome["message"], outcome
            await asyncio.sleep(2.0)
        high = await gcs.outcome("control.setpoint", pos_enu_m=[None, None, 60.0], vel_enu_mps=[0.0, 0.0, None])
        assert high["result"] == "refused" and "up 60" in high["message"]
        low = await gcs.outcome("control.setpoint", pos_enu_m=[0.0, 0.0, None], vel_enu_mps=[None, None, 0.0])
        assert low["ok"], "what follows a velocity has no height to be refused"
        await asyncio.sleep(5)
        assert gcs.control()["state"] == "flying"
        assert gcs.farthest_m(began) < 0.6
