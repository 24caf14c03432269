"""A vehicle in the air that follows setpoints and that nobody flies: it is ordered to hold, whatever led there."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.conditions import conditions_of
from skygcs.sim.firmware_modes import CopterMode
from support.flown import KINDS, Flown, aloft

WINDY = conditions_of(wind_mps=6.0)
COPTER = {"px4": 0, "ardupilot": 1}


async def left_alone(gcs: Flown, by: Callable[[], object]) -> float:
    """Fly it by attitude, end that, and see that it is held within a second."""
    await gcs.fly("attitude")
    await asyncio.sleep(5)
    since = gcs.now
    by()
    await asyncio.sleep(15)
    assert gcs.is_safe() and gcs.farthest_m(since) < 3.0, gcs.truth[1][-1]
    return since


@KINDS
async def test_control_that_ends_without_a_word(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, conditions=WINDY, **kind) as gcs:
        since = await left_alone(gcs, lambda: gcs.actor().offboard.release("a fault"))
        if kind == COPTER:
            (first, *_) = [t for t in gcs.told if t.kind == "unattended"]
            assert first.text.startswith("nobody flies it in GUIDED (this station's setpoints did)")
            assert first.at - since < 1.0
            assert len(gcs.commands(since)) == 2, "BRAKE and GUIDED, once"


async def test_control_that_ends_before_the_mode_it_ordered_was_seen(tmp_path: Path) -> None:
    """The watch had seen it in GUIDED only after its control had ended, and took it for somebody else's."""
    async with aloft(tmp_path, conditions=WINDY, setpoints_end=False, **COPTER) as gcs:
        gcs.other_sets_mode(int(CopterMode.LOITER))
        await asyncio.sleep(10)
        engaging = asyncio.create_task(gcs("control.set", targets="v1", mode="attitude"))
        await gcs.until(lambda: gcs.sim().mode == CopterMode.GUIDED, 20.0)
        assert gcs.actor().vehicle.mode == "LOITER", "no heartbeat has shown it yet"
        since = gcs.now
        gcs.actor().offboard.release("a fault")
        await asyncio.gather(engaging, return_exceptions=True)
        await asyncio.sleep(15)
        assert gcs.is_safe() and gcs.farthest_m(since) < 3.0, gcs.truth[1][-1]


async def test_the_mode_that_it_is_in_is_ordered_by_a_person(tmp_path: Path) -> None:
    """ArduCopter accepts GUIDED in GUIDED and changes nothing: its last attitude would be flown."""
    async with aloft(tmp_path, conditions=WINDY, **COPTER) as gcs:
        await gcs.fly("attitude")
        await asyncio.sleep(5)
        since = gcs.now
        await gcs.done("vehicles.mode", mode="GUIDED")
        await asyncio.sleep(15)
        assert gcs.is_safe() and gcs.farthest_m(since) < 3.0


async def test_a_pilot_who_takes_it_is_not_fought(tmp_path: Path) -> None:
    async with aloft(tmp_path, **COPTER) as gcs:
        await gcs.fly("attitude")
        taken = gcs.now
        gcs.other_sets_mode(int(CopterMode.LOITER))
        await asyncio.sleep(6)
        gcs.other_sets_mode(int(CopterMode.GUIDED))
        await asyncio.sleep(20)
        assert not gcs.commands(taken) and not gcs.texts(taken, "unattended")


async def test_a_goto_and_a_hold_are_left_alone(tmp_path: Path) -> None:
    async with aloft(tmp_path, **COPTER) as gcs:
        await gcs.fly("attitude")
        await gcs.done("vehicles.hold")
        await asyncio.sleep(10)
        await gcs.step(40.0, 0.0, 0.0)
        sent = gcs.now
        await asyncio.sleep(20)
        assert not gcs.commands(sent) and not gcs.texts(0.0, "unattended")
        assert gcs.farthest_m(sent) > 35.0


async def test_the_stream_of_another_program_that_ends(tmp_path: Path) -> None:
    """It flies by attitude through us and dies."""
    links = {"program": {"type": "memory", "role": "gcs"}}
    async with aloft(tmp_path, conditions=WINDY, links=links, **COPTER) as gcs:
        port = gcs.daemon.links.link("program").peer  # type: ignore[attr-defined]  # of a memory link
        level = mav.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, 0.37)
        for _ in range(100):
            port.send(gcs.other.pack(level))
            await asyncio.sleep(0.02)
        ended = gcs.now
        assert not gcs.texts(0.0, "unattended"), "it is not fought while it sends"
        await gcs.until(lambda: gcs.texts(ended, "unattended"), 2.0)
        await asyncio.sleep(10)
        assert gcs.is_safe()
