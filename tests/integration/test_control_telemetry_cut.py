"""Flown by setpoints, and the telemetry stops, or the daemon: attitude, then position, then hold, and never blind."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.flown import HOLDING, KINDS, aloft


@pytest.mark.deep
@KINDS
async def test_a_cut_of_a_second_and_a_half_falls_back_to_position_and_stays_there(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        start = await gcs.in_mid_step("attitude")
        cut = gcs.now
        gcs.sim().faults.mute = True
        await asyncio.sleep(1.5)
        gcs.sim().faults.mute = False
        blind = [s for s in gcs.setpoints(cut + 0.7) if s.at < cut + 1.4]
        assert blind and {s.name for s in blind} == {"SET_POSITION_TARGET_GLOBAL_INT"}
        await asyncio.sleep(20)
        assert (gcs.control()["state"], gcs.control()["control_mode"]) == ("flying", "position")
        assert gcs.setpoints(gcs.now - 1.0)[-1].name == "SET_POSITION_TARGET_GLOBAL_INT", "it returned unasked"
        assert gcs.place() == pytest.approx((start[0] + 3.0, start[1], start[2]), abs=0.3)
        assert gcs.farthest_m(cut, of=start) < 4.0
        told = gcs.texts(cut)
        assert len(told) <= 3 and len(set(told)) == len(told)
        assert any(t.startswith("flown by position setpoints: state is 0.") and "limit" in t for t in told)
        assert "it does not return by itself" in gcs.control()["reasons"][-1]
        await gcs.fly("attitude")


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("cut_s", [2.5, 10.0])
async def test_a_longer_cut_ends_in_one_hold_and_in_silence(tmp_path: Path, kind: dict[str, int], cut_s: float) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        start = await gcs.in_mid_step("attitude")
        cut = gcs.now
        gcs.sim().faults.mute = True
        await asyncio.sleep(cut_s)
        gcs.sim().faults.mute = False
        assert gcs.last_setpoint() < cut + 2.5
        assert gcs.control()["state"] == ("held" if cut_s < 5 else gcs.control()["state"])
        await gcs.ends_safe(within_m=4.0, since=cut, of=start)
        (told,) = [t for t in gcs.texts(cut) if t.startswith("holding, nothing more is sent")]
        assert "state is 2." in told
        assert {int(c.values["command"]) for c in gcs.commands(cut)} == gcs.hold_commands, "the hold, and nothing else"
        assert gcs.sim().mode in HOLDING
        # what was not known in the cut is said when it is heard again, and no failsafe had to act
        if cut_s > 5:
            assert not [text for text in gcs.texts(cut) if "failsafe" in text], gcs.texts(cut)
            (unknown,) = [text for text in gcs.texts(cut) if text.startswith("it was ordered to hold, but: ")]
            assert unknown.endswith("whether it does is not known")
            if not kind.get("ardupilot"):  # an ArduCopter holds in the mode that it was in
                (corrected,) = gcs.texts(cut, "unattended")
                assert corrected == "it holds in AUTO.LOITER, as it was ordered while it was not heard"


@pytest.mark.deep
async def test_a_daemon_of_which_a_part_fails_sends_nothing_more(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.fly("attitude")
        failed = gcs.now
        (inner,) = [t for t in asyncio.all_tasks() if t.get_name() == "the daemon"]
        inner.cancel()
        await asyncio.sleep(10)
        assert gcs.last_setpoint() <= failed + 0.05
        assert gcs.is_safe()


@KINDS
@pytest.mark.parametrize("mode", ["position", "velocity", "attitude"])
async def test_a_daemon_that_dies_leaves_the_autopilot_to_its_own_failsafe(
    tmp_path: Path, kind: dict[str, int], mode: str
) -> None:
    """An ArduCopter whose attitude ends is level, but not still: what ends that is its failsafe for a lost station."""
    async with aloft(tmp_path, params={"FS_GCS_ENABLE": 1}, **kind) as gcs:
        start = await gcs.in_mid_step(mode)
        died, gcs.cut = gcs.now, True
        await asyncio.sleep(4.5)
        assert gcs.farthest_m(died, of=start) < (12.0 if kind != {"px4": 1} and mode == "attitude" else 5.5)
        await asyncio.sleep(1.5)
        modes = [t.mode for t in gcs.truth[1] if t.at > died]
        first = next(mode for mode in modes if mode not in (Px4Mode.OFFBOARD, CopterMode.GUIDED))
        assert first == (CopterMode.RTL if "ardupilot" in kind else Px4Mode.LOITER)
        await asyncio.sleep(60)
        assert gcs.is_safe(), gcs.truth[1][-1]
        assert gcs.farthest_m(died, of=start) < 16.0


@pytest.mark.deep  # as a cut of both ways
async def test_a_copter_whose_answers_are_lost_holds_where_its_own_failsafe_acts(tmp_path: Path) -> None:
    """BRAKE is not left by the failsafe for a lost ground station (FS_OPTIONS, bit 4): what comes after it must be sent
    although nothing answers."""
    async with aloft(tmp_path, px4=0, ardupilot=1, params={"FS_GCS_ENABLE": 1}) as gcs:
        await gcs.fly("velocity")
        cut = gcs.now
        gcs.sim().faults.mute = True
        await asyncio.sleep(8.0)
        assert CopterMode.BRAKE in {t.mode for t in gcs.truth[1] if t.at > cut}
        assert gcs.sim().mode == CopterMode.GUIDED
        gcs.cut = True
        await asyncio.sleep(8.0)
        assert gcs.sim().mode == CopterMode.RTL
