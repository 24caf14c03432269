"""Timed trajectories in a whole daemon: start, pause, speed, abort, and each way in which a flight can end."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from support.flown import KINDS, Flown, aloft, flown

UP_M = 10.0


def leg(x_m: float, y_m: float, by_m: float, seconds: float = 10.0) -> list[dict[str, Any]]:
    """Along x, from rest to rest: 3u² - 2u³."""
    t = seconds
    return [
        {"duration_s": t, "x": [x_m, 0.0, 3 * by_m / t**2, -2 * by_m / t**3], "y": [y_m], "up": [UP_M], "yaw": [0.0]}
    ]


async def load_done(gcs: Flown, target: str = "v1", **params: Any) -> None:
    answer = await gcs("trajectory.load", target=target, **params)
    assert all(outcome["ok"] for outcome in answer["outcomes"].values()), answer


async def on_its_way(gcs: Flown, name: str = "v1", by_m: float = 8.0, seconds: float = 10.0) -> tuple[float, float]:
    """Loaded and started; half a second into it. Where it began."""
    x_m, y_m, _ = gcs.place(name)
    await load_done(gcs, name, pieces=leg(x_m, y_m, by_m, seconds), name="leg")
    await gcs.done("trajectory.start", targets=name, after_s=0.5)
    await asyncio.sleep(1.0)
    return x_m, y_m


def flight(gcs: Flown, name: str = "v1") -> dict[str, Any] | None:
    found: dict[str, Any] | None = gcs.control(name)["trajectory"]
    return found


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("mode", ["position", "velocity", "attitude"])
async def test_it_is_followed_to_its_end_and_the_vehicle_stays_there(
    tmp_path: Path, kind: dict[str, int], mode: str
) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.fly(mode)
        x_m, y_m = await on_its_way(gcs)
        began = gcs.now - 0.5
        worst = 0.0
        while (now := flight(gcs)) is not None:
            assert now["state"] in ("running", "finished") and now["name"] == "leg"
            u = min((gcs.now - began) / 10.0, 1.0)
            x, y, _ = gcs.place()
            worst = max(worst, math.hypot(x - (x_m + 8.0 * (3 * u**2 - 2 * u**3)), y - y_m))
            await asyncio.sleep(0.1)
        assert worst < 0.8, worst
        assert gcs.now - began == pytest.approx(10.0, abs=0.4)
        await asyncio.sleep(4.0)
        x, y, up = gcs.place()
        assert math.dist((x, y, up), (x_m + 8.0, y_m, UP_M)) < 0.4
        texts = gcs.texts(0.0, "trajectory")
        assert texts[0].startswith("leg begins in 0.5 s") and texts[1:] == ["leg is running", "leg is finished"]
        assert gcs.control()["state"] == "flying", "under control, at rest"


async def test_pause_resume_speed_and_abort_stay_on_the_path(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.fly("velocity")
        x_m, y_m = await on_its_way(gcs, by_m=16.0, seconds=20.0)
        await asyncio.sleep(6.0)
        await gcs.done("trajectory.pause")
        await gcs.until(lambda: (flight(gcs) or {})["state"] == "paused", 5.0)
        await asyncio.sleep(2.0)
        paused = gcs.place()
        await asyncio.sleep(3.0)
        assert math.dist(paused, gcs.place()) < 0.2 and abs(paused[1] - y_m) < 0.3
        assert x_m + 2.0 < paused[0] < x_m + 14.0
        await gcs.done("trajectory.speed", speed=1.5)
        await gcs.done("trajectory.resume")
        await asyncio.sleep(3.0)
        now = flight(gcs)
        assert now is not None and now["state"] == "running" and now["rate"] == pytest.approx(1.5, abs=0.01)
        await gcs.done("trajectory.abort")
        await gcs.until(lambda: flight(gcs) is None, 6.0)
        await asyncio.sleep(3.0)
        stopped = gcs.place()
        await asyncio.sleep(3.0)
        assert math.dist(stopped, gcs.place()) < 0.2 and paused[0] < stopped[0] < x_m + 16.0
        assert gcs.texts(0.0, "trajectory")[-1] == "leg is aborted"
        outcome = await gcs.outcome("trajectory.resume")
        assert not outcome["ok"] and "follows no trajectory" in outcome["message"]


async def test_what_must_not_be_flown_does_not_start(tmp_path: Path) -> None:
    jump = {"duration_s": 5.0, "x": [0, 1.0], "y": [0.0], "up": [UP_M], "yaw": [0.0]}
    async with aloft(tmp_path) as gcs:
        await gcs.fly("position")
        since = gcs.now
        for pieces, why in (
            (leg(3.0, 0.0, 8.0), "from the first point"),
            (leg(0.0, 0.0, 55.0, 60.0), "the fence less 2 m of margin"),
            (leg(0.0, 0.0, 40.0, 8.0), "its speed of 7.5 m/s is above 5"),
            (leg(0.0, 0.0, 6.0, 3.0), "its acceleration of 4 m/s² is above 3"),
            ([*leg(0.0, 0.0, 0.0), jump], "jump of"),
        ):
            await load_done(gcs, pieces=pieces)
            outcome = await gcs.outcome("trajectory.start")
            assert not outcome["ok"] and why in outcome["message"], outcome
            await asyncio.sleep(2.0)
            assert flight(gcs) is None and gcs.farthest_m(since) < 0.3, why


async def test_it_does_not_start_without_control_or_without_a_trajectory_or_raw(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        outcome = await gcs.outcome("trajectory.start")
        assert "no trajectory is loaded" in outcome["message"]
        x_m, y_m, _ = gcs.place()
        await load_done(gcs, pieces=leg(x_m, y_m, 8.0))
        outcome = await gcs.outcome("trajectory.start")
        assert not outcome["ok"] and "control is off" in outcome["message"]
        await gcs.outcome("control.set", mode="raw")
        outcome = await gcs.outcome("trajectory.start")
        assert not outcome["ok"] and "flown in raw" in outcome["message"]


async def test_bad_trajectories_are_refused_and_nothing_is_kept(tmp_path: Path) -> None:
    rest: dict[str, Any] = {"duration_s": 1.0, "x": [0.0], "y": [0.0], "up": [1.0]}
    async with flown(tmp_path, takeoff=False) as gcs:
        for wrong in (
            {"pieces": []},
            {"pieces": [{**rest, "duration_s": 0.0}]},
            {"pieces": [{**rest, "x": [0.0] * 17}]},
            {"pieces": [{**rest, "x": [1e300]}]},
            {"pieces": [{**rest, "x": [math.nan]}]},
            {"pieces": [{**rest, "duration_s": 7000.0}] * 2},
            {"pieces": [rest] * 2001},
            {"pieces": [{**rest, "yaw": [0.0]}, rest]},
            {"pieces": [{**rest, "x": [x]} for x in (0.0, 5.0)]},
            {"pieces": leg(0.0, 0.0, 1.0), "name": "x" * 65},
        ):
            with pytest.raises(Exception) as caught:
                answer = await gcs("trajectory.load", target="v1", **wrong)
                assert not answer["outcomes"]["v1"]["ok"], answer
                raise ValueError
            assert "Traceback" not in str(caught.value)
            assert (await gcs("trajectory.status"))["trajectories"] == [], wrong


async def test_one_start_is_all_or_none_and_shares_a_clock(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2) as gcs:
        for name in ("v1", "v2"):
            await gcs.fly("position", name)
        for name in ("v1", "v2"):
            x_m, y_m, _ = gcs.place(name)
            far = 3.0 if name == "v2" else 0.0
            await load_done(gcs, name, pieces=leg(x_m, y_m + far, 8.0))
        answer = (await gcs("trajectory.start", targets="v1,v2"))["outcomes"]
        assert not answer["v1"]["ok"] and "v2 cannot" in answer["v1"]["message"]
        assert not answer["v2"]["ok"] and "first point" in answer["v2"]["message"]
        await asyncio.sleep(2.0)
        assert flight(gcs, "v1") is None
        x_m, y_m, _ = gcs.place("v2")
        await load_done(gcs, "v2", pieces=leg(x_m, y_m, 8.0))
        status = await gcs("trajectory.status")
        await gcs.done("trajectory.start", targets="v1,v2", at_s=status["now_s"] + 2.0)
        await asyncio.sleep(5.0)
        one, other = flight(gcs, "v1"), flight(gcs, "v2")
        assert one is not None and other is not None
        assert one["trajectory_s"] == pytest.approx(other["trajectory_s"], abs=0.25)
        shown = {t["vehicle"]: t for t in (await gcs("trajectory.status"))["trajectories"]}
        assert shown["v1"]["with"] == ["v2"] and shown["v2"]["with"] == ["v1"]
        outcomes = (await gcs("trajectory.pause", targets="v1"))["outcomes"]
        assert set(outcomes) == {"v1", "v2"} and all(o["ok"] for o in outcomes.values())


@pytest.mark.deep
@KINDS
@pytest.mark.parametrize("order", ["land", "hold", "off", "goto", "mode_by_pilot"])
async def test_each_way_out_stops_the_others_on_their_paths(tmp_path: Path, kind: dict[str, int], order: str) -> None:
    both = {key: 2 * count for key, count in kind.items()}
    async with aloft(tmp_path, **both) as gcs:
        for name in ("v1", "v2"):
            await gcs.fly("position", name)
            x_m, y_m, _ = gcs.place(name)
            await load_done(gcs, name, pieces=leg(x_m, y_m, 16.0, 20.0))
        await gcs.done("trajectory.start", targets="v1,v2")
        await asyncio.sleep(6.0)
        since = gcs.now
        match order:
            case "off":
                await gcs.done("control.set", mode="off")
            case "goto":
                await gcs.step(0.0, 2.0, 0.0)
            case "mode_by_pilot":
                if kind["px4"]:
                    gcs.other_sets_mode(4, 3)
                else:
                    gcs.other_sets_mode(CopterMode.LOITER)
                await gcs.until(lambda: gcs.control()["state"] == "off", 5.0)
            case _:
                await gcs.done(f"vehicles.{order}")
        await gcs.until(lambda: flight(gcs, "v2") is not None and flight(gcs, "v2")["state"] == "paused", 6.0)  # type: ignore[index]
        assert flight(gcs, "v1") is None
        why = "it left its trajectory: " + ("it was ordered otherwise" if order == "goto" else "")
        assert any(why in t for t in gcs.texts(since, "trajectory"))
        assert any("because v1 left" in t for t in gcs.texts(since, "trajectory", "v2"))
        await asyncio.sleep(10.0)
        state = flight(gcs, "v2")
        assert state is not None and state["state"] == "paused", "never by itself"
        await gcs.done("trajectory.resume", targets="v2")
        await gcs.until(lambda: flight(gcs, "v2") is None, 30.0)
        await gcs.until(lambda: gcs.texts(since, "trajectory", "v2")[-1] == "trajectory is finished", 1.0)


async def test_a_stream_and_a_second_trajectory_are_refused_meanwhile(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.fly("position")
        x_m, y_m = await on_its_way(gcs)
        outcome = await gcs.outcome("control.setpoint", pos_enu_m=[x_m, y_m, UP_M])
        assert not outcome["ok"] and "trajectory" in outcome["message"]
        assert not (await gcs.outcome("trajectory.start"))["ok"]
        assert not (await gcs.outcome("trajectory.unload"))["ok"]
        answer = await gcs("trajectory.load", target="v1", pieces=leg(x_m, y_m, 1.0))
        assert not answer["outcomes"]["v1"]["ok"]
        too_fast = await gcs.outcome("trajectory.speed", speed=4.0)
        assert not too_fast["ok"] and "is above" in too_fast["message"]


@KINDS
async def test_sigterm_on_the_way_holds(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.fly("position")
        await on_its_way(gcs, by_m=16.0, seconds=20.0)
        await asyncio.sleep(5.0)
        ended = gcs.now
        await gcs.stopped(4.0)
        assert gcs.hold_commands & {c.values["command"] for c in gcs.commands(ended - 0.01)}
        await gcs.ends_safe(within_m=5.0, since=ended)


async def test_a_vehicle_lands_in_the_middle_and_nothing_of_it_remains(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.fly("position")
        await on_its_way(gcs)
        await gcs.done("vehicles.land")
        await gcs.until(lambda: gcs.sim().mode == Px4Mode.LAND)
        await asyncio.sleep(1.0)
        assert not gcs.daemon.fleet.trajectories._groups
        assert (await gcs("trajectory.status"))["trajectories"][0]["flight"] is None
        await gcs.done("trajectory.unload")
        assert (await gcs("trajectory.status"))["trajectories"] == []
