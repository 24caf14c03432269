"""The guard falls as the uplink gets slow: how far a step goes beyond its goal; orders, pilots and ends in that moment.

Beyond the goal are allowed 0.7 s until it is noticed, braking with 2.5 m/s², and half a metre, at the speed that the
vehicle had when the uplink got slow.
"""

from __future__ import annotations

import asyncio
import math
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


EAST, UP = 0, 2

STEPS = [(8.0, 0.5, EAST), (8.0, 1.0, EAST), (8.0, 1.8, EAST), (8.0, 2.5, EAST), (8.0, 3.3, EAST)]
STEPS += [(3.0, 0.5, EAST), (3.0, 1.0, EAST), (3.0, 1.8, EAST), (8.0, 1.5, UP), (-6.0, 1.5, UP)]


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("step", STEPS, ids=lambda s: f"{s[0]:g} m {'up' if s[2] else 'east'} at {s[1]:g}")
async def test_attitude_builds_up_no_more_than_can_be_stopped(
    tmp_path: Path, kind: dict[str, int], step: tuple[float, float, int]
) -> None:
    """The fault comes at that speed of the step. It used to go 14 m beyond 8 m, and 10 m beyond a climb of 8 m."""
    far_m, at_mps, axis = step
    sign = math.copysign(1.0, far_m)
    async with aloft(tmp_path, delay_s=0.01, control={"fence": FENCE}, **kind) as gcs:
        await gcs.fly("attitude")
        await asyncio.sleep(6.0)
        by_m = [far_m if n == axis else 0.0 for n in range(3)]
        goal = tuple(start + by for start, by in zip(gcs.place(), by_m, strict=True))
        await gcs.step(*by_m)

        def speed() -> float:
            motion = gcs.sim().motion
            return sign * (motion.vel_e_mps, motion.vel_n_mps, motion.vel_u_mps)[axis]

        await gcs.until(lambda: speed() >= at_mps, 8.0)
        gcs.uplink_delay_s = 0.5
        fault, fast = gcs.now, speed()
        await asyncio.sleep(15.0)
        assert gcs.control()["control_mode"] == "position"
        assert gcs.place() == pytest.approx(goal, abs=1.0), "in the end it is there"
        beyond_m = max(sign * (look.pos_m[axis] - goal[axis]) for look in gcs.truth[1] if look.at >= fault)
        assert beyond_m <= 0.7 * fast + fast**2 / 5.0 + 0.5


@KINDS
async def test_it_is_handed_over_braking(tmp_path: Path, kind: dict[str, int]) -> None:
    """A lean against its motion for 0.3 s, to a PX4 once or twice, and then the setpoints of the next control mode."""
    async with aloft(tmp_path, delay_s=0.01, control={"fence": FENCE}, **kind) as gcs:
        await gcs.fly("attitude")
        await asyncio.sleep(3.0)
        await gcs.step(8.0, 0.0, 0.0)
        await gcs.until(lambda: gcs.sim().motion.vel_e_mps >= 2.0)
        changed = gcs.now
        await gcs.fly("velocity")
        await asyncio.sleep(1.0)
        first = next(s.at for s in gcs.setpoints(changed) if s.name == "SET_POSITION_TARGET_LOCAL_NED")
        braking = [s for s in gcs.setpoints(first - 0.35) if s.name == "SET_ATTITUDE_TARGET" and s.at < first]
        w, x, y, z = braking[-1].values["q"]
        assert -2.0 * (y * z - w * x) < -0.1, "its thrust points west"
        if "ardupilot" in kind:
            assert len({tuple(s.values["q"]) for s in braking[-2:]}) == 1, "worked out once"
        assert "SET_ATTITUDE_TARGET" not in {s.name for s in gcs.setpoints(first)}
