"""Orders, pilots and ends that come in the moment in which the guard falls, and an uplink about its limit."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.flown import KINDS, Flown, aloft
from support.virtual_uvloop import VirtualUvloop

MOMENTS = pytest.mark.parametrize("after_s", [0.0, 0.1, 0.25, 0.4])
"""After the fall; an ArduCopter's handover takes 0.3 s."""

FENCE = {"x_m": [-60, 60], "y_m": [-60, 60], "up_m": [0, 40]}
Scenario = Callable[[Flown], Awaitable[None]]


def fly(folder: Path, kind: dict[str, int], scenario: Scenario, **control: float) -> None:
    """Under uvloop, in virtual time."""

    async def flight() -> None:
        async with aloft(folder, delay_s=0.01, control={"fence": FENCE, **control}, **kind) as gcs:
            await scenario(gcs)

    with asyncio.Runner(loop_factory=VirtualUvloop) as runner:
        runner.run(flight())


async def falling(gcs: Flown) -> float:
    """By attitude, 2 m/s fast in a step, the uplink gets slow: when the guard fell."""
    await gcs.fly("attitude")
    await asyncio.sleep(6.0)
    await gcs.step(8.0, 0.0, 0.0)
    await gcs.until(lambda: gcs.sim().motion.vel_e_mps >= 2.0)
    gcs.uplink_delay_s = 0.4
    return await gcs.until(lambda: gcs.control()["control_mode"] != "attitude", 5.0)


@pytest.mark.deep
@KINDS
@MOMENTS
def test_a_pilot_takes_it_while_it_falls(tmp_path: Path, kind: dict[str, int], after_s: float) -> None:
    async def scenario(gcs: Flown) -> None:
        await falling(gcs)
        await asyncio.sleep(after_s)
        px4 = "ardupilot" not in kind
        if px4:
            gcs.other_sets_mode(4, 5)  # AUTO.RTL
        else:
            gcs.other_sets_mode(int(CopterMode.RTL))
        taken = gcs.now
        await gcs.until(lambda: gcs.control()["state"] == "off", 5.0)
        await asyncio.sleep(0.1)
        ended = gcs.now
        await asyncio.sleep(8.0)
        assert not gcs.setpoints(ended) and not gcs.commands(taken), "whoever took it is not fought"
        assert gcs.truth[1][-1].mode == (Px4Mode.RTL if px4 else CopterMode.RTL)

    fly(tmp_path, kind, scenario)


@pytest.mark.deep
@KINDS
@MOMENTS
def test_sigterm_while_it_falls(tmp_path: Path, kind: dict[str, int], after_s: float) -> None:
    async def scenario(gcs: Flown) -> None:
        fell = await falling(gcs)
        start = gcs.place()
        await asyncio.sleep(after_s)
        await gcs.stopped(within_s=8.0)
        await gcs.ends_safe(within_m=14.0, since=fell, of=start)

    fly(tmp_path, kind, scenario)


@pytest.mark.deep
def test_one_that_returns_by_itself_does_not_swing_with_the_uplink(tmp_path: Path) -> None:
    async def scenario(gcs: Flown) -> None:
        await gcs.fly("attitude")
        await asyncio.sleep(6.0)
        start, began = gcs.place(), gcs.now
        while gcs.now < began + 120.0:
            gcs.uplink_delay_s = 0.12 if gcs.uplink_delay_s < 0.1 else 0.03
            await asyncio.sleep(5.0)
        changes = [text for text in gcs.texts(began) if text.startswith("flown by")]
        assert len(changes) <= 3, changes
        assert gcs.farthest_m(began, of=start) < 1.0

    fly(tmp_path, {"px4": 0, "ardupilot": 1}, scenario, return_after_s=2.0)
