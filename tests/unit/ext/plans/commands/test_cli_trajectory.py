"""`skygcs-cli trajectory`: which trajectory of a file goes to which vehicle, what is asked, and how it exits."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from skygcs.cli.control import track_reasons
from skygcs.core.trajectory import Trajectory
from skygcs.rpc.client import connect
from support.controlled import FLYING, Commanded
from support.fake_daemon import FakeOutcome, FakeVehicle
from support.table import each

FAILED, USAGE = 1, 2
OK = FakeOutcome(True, "accepted", "done", attempts=0, elapsed_s=0.0)


class FakeTrajectories:
    """What was asked, and an outcome for each vehicle."""

    def __init__(self) -> None:
        self.loaded: dict[str, tuple[Trajectory, str]] = {}
        self.asked: list[tuple[Any, ...]] = []
        self.outcome = OK
        self.shown: list[dict[str, Any]] = []

    async def load(self, actor: FakeVehicle, trajectory: Trajectory, name: str) -> FakeOutcome:
        self.loaded[actor.name] = trajectory, name
        return self.outcome

    def _all(self, what: str, actors: Sequence[FakeVehicle], *more: Any) -> dict[str, FakeOutcome]:
        self.asked.append((what, [actor.name for actor in actors], *more))
        return {actor.name: self.outcome for actor in actors}

    async def prepare(self, actors: Sequence[FakeVehicle]) -> dict[str, FakeOutcome]:
        return {}  # no companion flies them

    def start(self, actors: Sequence[FakeVehicle], at_s: float, speed: float) -> dict[str, FakeOutcome]:
        return self._all("start", actors, at_s, speed)

    async def start_apart(self, actors: Sequence[FakeVehicle], at_s: float, speed: float) -> dict[str, FakeOutcome]:
        return self._all("start", actors, at_s, speed)

    def pause(self, actors: Sequence[FakeVehicle]) -> dict[str, FakeOutcome]:
        return self._all("pause", actors)

    def resume(self, actors: Sequence[FakeVehicle]) -> dict[str, FakeOutcome]:
        return self._all("resume", actors)

    def abort(self, actors: Sequence[FakeVehicle]) -> dict[str, FakeOutcome]:
        return self._all("abort", actors)

    def unload(self, actors: Sequence[FakeVehicle]) -> dict[str, FakeOutcome]:
        return self._all("unload", actors)

    def set_speed(self, actors: Sequence[FakeVehicle], speed: float) -> dict[str, FakeOutcome]:
        return self._all("speed", actors, speed)

    def status(self, actors: Sequence[FakeVehicle]) -> list[dict[str, Any]]:
        return self.shown


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Commanded]:
    with Commanded(tmp_path) as fleet:
        fleet.daemon.fleet.trajectories = FakeTrajectories()  # type: ignore[attr-defined]
        yield fleet


def fake(fleet: Commanded) -> FakeTrajectories:
    made: FakeTrajectories = fleet.daemon.fleet.trajectories  # type: ignore[attr-defined]
    return made


def written(folder: Path, name: str, text: str) -> str:
    path = folder / name
    path.write_text(text)
    return str(path)


def test_a_file_of_one_trajectory_is_for_the_vehicle_named_here(fleet: Commanded, tmp_path: Path) -> None:
    path = written(tmp_path, "line.csv", "t,x,y,z,yaw\n0,1,2,5,90\n4,3,2,5,90\n")
    fleet.run("trajectory", "load", path, "bravo")
    trajectory, name = fake(fleet).loaded["bravo"]
    assert name == "line" and trajectory.duration_s == 4.0
    assert trajectory.at(2.0).pos_enu_m == pytest.approx((2.0, 2.0, 5.0))
    assert trajectory.at(2.0).yaw_rad == pytest.approx(1.5707963)


def test_a_file_of_several_is_for_those_of_its_names(fleet: Commanded, tmp_path: Path) -> None:
    rows = [f"{name},{t},{t},0,5" for name in ("alpha", "bravo", "zulu") for t in (0, 3)]
    path = written(tmp_path, "show.csv", "vehicle,t,x,y,z\n" + "\n".join(rows) + "\n")
    fleet.run("trajectory", "load", path)
    assert set(fake(fleet).loaded) == {"alpha", "bravo"}
    text = fleet.run("trajectory", "load", path, "carol", code=FAILED)
    assert "it is for alpha, bravo, zulu" in text


@each(
    ("name", "text", "reason"),
    [
        ("none.csv", None, "cannot be read"),
        ("wrong.csv", "t,x,y,z\n0,1,2,x\n", "line 2"),
        ("wrong.txt", "t,x,y,z\n", ".json, .skyc, .csv"),
        ("wrong.json", "{", "wrong.json"),
        (
            "phased.json",
            '{"format": "skygcs-plan", "version": 1, "kind": "phased", "starts": {"alpha": [0, 0, 5]}, '
            '"phases": [{"name": "a", "goals": {"alpha": [1, 0, 5]}}], "space": {}}',
            "it has phases and no times",
        ),
    ],
)
def test_what_is_no_trajectory_is_one_line_and_nothing_is_loaded(
    fleet: Commanded, tmp_path: Path, name: str, text: str | None, reason: str
) -> None:
    path = str(tmp_path / name) if text is None else written(tmp_path, name, text)
    assert reason in fleet.run("trajectory", "load", path, "alpha", code=FAILED)
    assert not fake(fleet).loaded


def test_orders_ask_for_what_was_said(fleet: Commanded) -> None:
    fleet.run("trajectory", "start", "alpha,bravo", "--at", "77", "--speed", "0.5")
    for order in ("pause", "resume", "abort", "unload"):
        fleet.run("trajectory", order, "alpha")
    fleet.run("trajectory", "speed", "alpha", "2")
    assert fake(fleet).asked == [
        ("start", ["alpha", "bravo"], 77.0, 0.5),
        *((order, ["alpha"]) for order in ("pause", "resume", "abort", "unload")),
        ("speed", ["alpha"], 2.0),
    ]
    fake(fleet).outcome = FakeOutcome(False, "refused", "refused: too fast", attempts=0, elapsed_s=0.0)
    assert "too fast" in fleet.run("trajectory", "speed", "alpha", "2", code=FAILED)


@each(
    "args",
    [
        ("start",),
        ("start", "alpha", "--in", "-1"),
        ("start", "alpha", "--in", "1", "--at", "2"),
        ("start", "alpha", "--speed", "9"),
        ("start", "alpha", "--speed", "nan"),
        ("speed", "alpha", "0"),
        ("speed", "alpha"),
        ("load",),
    ],
)
def test_wrong_options_are_usage_errors(fleet: Commanded, args: tuple[str, ...]) -> None:
    fleet.run("trajectory", *args, code=USAGE)
    assert not fake(fleet).asked


def test_status_says_what_is_loaded_and_flown(fleet: Commanded) -> None:
    assert "no trajectory is loaded" in fleet.run("trajectory", "status")
    one = {"vehicle": "alpha", "name": "leg", "pieces": 3, "duration_s": 12.0, "start_enu_m": [1.0, 2.0, 5.0]}
    flight = {"state": "running", "trajectory_s": 3.25, "speed_factor": 1.5, "finishes_in_s": 5.8}
    fake(fleet).shown = [{**one, "left": ["bravo"], "flight": flight}, {**one, "left": [], "flight": None}]
    flown, loaded, clock = fleet.run("trajectory", "status").splitlines()
    assert flown == "alpha  leg  3 pieces  12.0 s  running at 3.2 s, 1.5 times the speed, ends in 5.8 s; left: bravo"
    assert loaded == "alpha  leg  3 pieces  12.0 s  loaded, begins at 1.0 2.0 5.0"
    assert clock.startswith("clock of the daemon: ")


def test_track_shows_the_trajectory() -> None:
    trajectory = {"name": "leg", "state": "paused", "trajectory_s": 3.25, "duration_s": 12.0}
    assert track_reasons({"control": {**FLYING, "trajectory": trajectory}}) == "trajectory leg paused, 3.2 of 12.0 s"


def test_the_python_client_asks_the_same(fleet: Commanded) -> None:
    async def ask() -> None:
        async with connect(str(fleet.socket)) as gcs:
            piece = {"duration_s": 2.0, "x": [0.0, 1.0], "y": [0.0], "up": [5.0]}
            assert (await gcs.load_trajectory("alpha", [piece], name="line"))["alpha"]["ok"]
            assert (await gcs.trajectory("start", "alpha", at_s=9.0, speed=2.0))["alpha"]["ok"]
            assert (await gcs.trajectory("speed", ["alpha", "bravo"], speed=0.5))["bravo"]["ok"]
            assert (await gcs.setpoint("alpha", acc_enu_mps2=[0.0, 0.0, 0.1]))["alpha"]["ok"]

    asyncio.run(ask())
    assert fake(fleet).loaded["alpha"][1] == "line"
    assert fake(fleet).asked == [("start", ["alpha"], 9.0, 2.0), ("speed", ["alpha", "bravo"], 0.5)]
    assert fleet.vehicles["alpha"].setpoints[0]["acc_enu_mps2"] == [0.0, 0.0, 0.1]
