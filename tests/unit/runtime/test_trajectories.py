"""Loaded trajectories: what is kept, how much, and what happens while bounds are computed in a thread."""

from __future__ import annotations

import asyncio
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skygcs.config.control import ControlSettings
from skygcs.config.vehicle_tables import MonitorConfig
from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.trajectory import Piece, Trajectory, TrajectoryClock
from skygcs.core.vehicle.flight_lock import FlightLock
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, TrajectoryFlight
from skygcs.runtime import trajectories
from skygcs.runtime.flight_locks import FlightLocks
from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.runtime.trajectories import LARGE_PIECES, MAX_PIECES, Trajectories
from skygcs.runtime.vehicle_actor import VehicleActor
from support.table import each

ORIGIN = Origin(43.7806, -79.4653, 180.0)


class Fake(SimpleNamespace):
    """A key of a dict, as an actor is."""

    __hash__ = object.__hash__  # type: ignore[assignment]


def actor(name: str) -> VehicleActor:
    ends = list[str]()
    made = Fake(
        name=name,
        sysid=1,
        vehicle=SimpleNamespace(
            replayed=False,
            origin=ORIGIN,
            name=name,
            key=257,
            family="px4",
            mode="OFFBOARD",
            telemetry=lambda group: None,
        ),
        config=SimpleNamespace(control=ControlSettings()),
        authority_refusal=lambda: None,
        runner=SimpleNamespace(
            precedence=SimpleNamespace(note_effect=lambda: None, superseded=lambda: None),
            ledger=SimpleNamespace(effective_serial=0),
        ),
        offboard=SimpleNamespace(controller=SimpleNamespace(flight=None), lead_s=0.0),
        stream=SimpleNamespace(ends=ends, ended=ends.append),
    )
    return cast(VehicleActor, made)


def line(pieces: int) -> Trajectory:
    return Trajectory([Piece(1.0, (float(i), 1.0), (0.0,), (5.0,)) for i in range(pieces)])


def unwatched() -> SeparationMonitor:
    loop = asyncio.get_running_loop()
    return SeparationMonitor(MonitorConfig(mode="off"), {}, loop, lambda event: None)


def keeping(*actors: VehicleActor) -> Trajectories:
    return Trajectories(lambda: actors, asyncio.get_running_loop(), lambda event: None, unwatched(), FlightLocks())


async def test_a_large_one_leaves_the_loop_to_the_ticks_and_is_refused_if_it_flies_by_then() -> None:
    alpha = actor("alpha")
    kept = keeping(alpha)
    loading = asyncio.create_task(kept.load(alpha, line(300), "long"))
    await asyncio.sleep(0)
    assert not loading.done() and LARGE_PIECES < 300
    cast(Any, alpha.offboard.controller).flight = object()
    outcome = await loading
    assert not outcome.ok and "it follows a trajectory" in outcome.message
    cast(Any, alpha.offboard.controller).flight = None
    assert (await kept.load(alpha, line(300), "long")).ok


async def test_what_all_keep_together_is_bounded(monkeypatch: Any) -> None:
    monkeypatch.setattr(trajectories, "MAX_ALL_PIECES", 5)
    alpha, bravo, gone = actor("alpha"), actor("bravo"), actor("gone")
    kept = keeping(alpha, bravo)
    assert (await kept.load(alpha, line(3), "a")).ok
    assert not (await kept.load(bravo, line(3), "b")).ok
    assert (await kept.load(alpha, line(2), "a")).ok, "it takes the place of its own"
    assert (await kept.load(bravo, line(3), "b")).ok
    assert not (await kept.load(gone, line(1), "c")).ok
    outcome = await kept.load(bravo, line(MAX_PIECES + 1), "b")
    assert not outcome.ok and str(MAX_PIECES) in outcome.message


async def test_a_vehicle_that_was_forgotten_keeps_nothing() -> None:
    alpha = actor("alpha")
    there = [alpha]
    kept = Trajectories(lambda: there, asyncio.get_running_loop(), lambda event: None, unwatched(), FlightLocks())
    assert (await kept.load(alpha, line(2), "a")).ok and len(kept.status([alpha])) == 1
    there.clear()
    kept.tick(0.0)
    assert kept.status([alpha]) == []
    assert not kept.unload([alpha])["alpha"].ok


async def test_a_start_in_the_past_or_never_starts_nothing() -> None:
    alpha = actor("alpha")
    kept = keeping(alpha)
    await kept.load(alpha, line(2), "a")
    cast(Any, alpha.offboard).trajectory_refusal = lambda loaded, factor, lock, tube: None
    now = asyncio.get_running_loop().time()
    for at_s in (now - 1.0, now + 1e6, float("inf"), float("nan")):
        outcome = kept.start([alpha], at_s, 1.0)["alpha"]
        assert not outcome.ok and "the start is" in outcome.message


@pytest.mark.looptime
@each("gone", ["alpha", None])
async def test_a_group_that_an_abort_is_about_to_stop_is_not_paused(gone: str | None) -> None:
    """One leaves it, or nobody watches its plan any more, while the abort waits for its lead: to pause it was refused,
    in the middle of the fleet's tick."""
    loop, told = asyncio.get_running_loop(), list[str]()
    both = actor("alpha"), actor("bravo")
    kept = Trajectories(lambda: both, loop, lambda event: told.append(event.text), unwatched(), FlightLocks())
    for one in both:
        offboard = cast(Any, one.offboard)
        offboard.lead_s, offboard.successor, offboard.trajectory_refusal = 0.8, None, lambda *given: None
        offboard.controller.reasons = ("hold was ordered",)
        offboard.follow_trajectory = partial(follow, offboard.controller)
        await kept.load(one, line(10), one.name)
    assert kept.start(both, loop.time() + 1.0, 1.0)["bravo"].ok
    assert [cast(Any, one).stream.ends for one in both] == [["a trajectory was started"]] * 2
    await asyncio.sleep(4)
    kept.abort(both)
    if gone is None:
        (group,) = kept._groups
        group.plan = "a plan"
        kept.pause_plans()
    else:
        cast(Any, both[0].offboard).controller.flight = None
        kept.tick(loop.time())
        assert any("alpha left" in text for text in told)
    await asyncio.sleep(5)
    (shown,) = kept.status(both[1:])
    assert shown["flight"]["state"] == "aborted"


def follow(controller: Any, loaded: LoadedTrajectory, clock: TrajectoryClock, lock: FlightLock) -> TrajectoryFlight:
    controller.flight = TrajectoryFlight(loaded, clock, lock.origin, EnuFrame(lock.origin))
    return cast(TrajectoryFlight, controller.flight)


async def test_paths_are_points_of_what_is_loaded_or_flown_and_come_again_only_after_a_change() -> None:
    alpha, bravo, idle = actor("alpha"), actor("bravo"), actor("idle")
    both = [alpha, bravo, idle]
    kept = keeping(*both)
    await kept.load(alpha, line(2), "a")
    key, paths = await kept.paths(both, None)
    assert paths is not None
    [path] = paths
    assert (path["vehicle"], path["name"], path["flown"]) == ("alpha", "a", False)
    points = path["points_enu_m"]
    assert points[0] == (0.0, 0.0, 5.0) and points[-1] == (2.0, 0.0, 5.0)
    assert points[len(points) // 2][0] == pytest.approx(1.0, abs=0.05)
    assert await kept.paths(both, key) == (key, None)
    await kept.load(bravo, line(1), "b")
    second, paths = await kept.paths(both, key)
    assert second != key and paths is not None and [path["vehicle"] for path in paths] == ["alpha", "bravo"]
    cast(Any, alpha.offboard.controller).flight = SimpleNamespace(loaded=kept._loaded[alpha])
    third, paths = await kept.paths(both, second)
    assert third != second and paths is not None and [path["flown"] for path in paths] == [True, False]
    cast(Any, alpha.offboard.controller).flight = None
    await kept.load(alpha, line(2), "a")  # the same again is another one
    assert (await kept.paths(both, second))[1] is not None


async def test_the_points_of_all_paths_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectories, "MOST_POINTS_OF_ALL", 40)
    alpha, bravo = actor("alpha"), actor("bravo")
    kept = keeping(alpha, bravo)
    for one in (alpha, bravo):
        await kept.load(one, line(30), "long")
    _, paths = await kept.paths([alpha, bravo], None)
    assert paths is not None and sum(len(path["points_enu_m"]) for path in paths) <= 42
    assert paths[0]["points_enu_m"][-1] == (30.0, 0.0, 5.0)
