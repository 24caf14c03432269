"""`skygcs-cli plan run` and the orders of a plan in flight: what is asked, what is shown, and how it exits."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from skygcs.cli.render import console
from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.plan_json import plan_from_json, write_plan_json
from skygcs.errors import RefusedError
from skygcs.ext.plans.commands.plan_run import headline, picture, report_lines
from skygcs.ext.plans.flight.flight_steps import starts_of
from skygcs.ext.plans.flight_check import FlightRequest
from support.controlled import Commanded
from support.table import each

FAILED, USAGE = 1, 2

STATUS: dict[str, Any] = {
    "now_s": 5.0,
    "plan": "1",
    "name": "plan",
    "kind": "phased",
    "state": "loaded",
    "busy": None,
    "phase": None,
    "step": 0,
    "steps": 0,
    "reason": "",
    "by": None,
    "mode": None,
    "speed": None,
    "clock": None,
    "waits_for": [],
    "pairs": [],
    "vehicles": [],
}
CLOCK = {"state": "running", "trajectory_s": 3.25, "duration_s": 12.0, "rate": 1.0, "speed_factor": 1.0}
VEHICLE = {
    "vehicle": "alpha",
    "state": "under control",
    "error_m": 0.123,
    "tube_m": 0.4,
    "pos_enu_m": [1.0, 2.0, 10.0],
    "goal_enu_m": [1.0, 12.0, 10.0],
    "position_age_s": 0.2,
    "left": None,
}
FLYING = {**STATUS, "state": "flying", "phase": "cross", "step": 2, "steps": 3, "clock": CLOCK, "vehicles": [VEHICLE]}
REPORT: dict[str, Any] = {
    "ok": True,
    "by": "setpoints",
    "why": "every link carries them",
    "findings": [],
    "certificate": None,
    "way_there": None,
    "margins": {},
    "duration_s": 12.0,
    "steps": [{"name": "cross", "duration_s": 12.0, "goals": {}}],
    "return_heights": {},
}
NO_HEIGHTS = {
    **REPORT,
    "ok": False,
    "findings": [
        {
            "vehicle": "bravo",
            "check": "return height",
            "severity": "refused",
            "text": "it returns at 15 m",
            "todo": "set RTL_ALT",
            "insist": True,
        }
    ],
    "return_heights": {"alpha": [15.0, 15.0, "RTL_ALT"], "bravo": [15.0, 22.0, "RTL_ALT"]},
}


class FakePlans:
    """Remembers what is asked; its flight goes through ``states``, one each time it is shown."""

    def __init__(self) -> None:
        self.asked: list[tuple[Any, ...]] = []
        self.report = REPORT
        self.states: list[dict[str, Any]] = [STATUS]
        self.observers: set[Callable[[], None]] = set()
        self.refuses: str | None = None
        self.answer: tuple[bool, str, list[str]] = (True, "going on", [])
        self.flight = self.kept = None  # a call counts by their vehicles
        self.moving = True
        self.loaded: Plan | None = None

    async def load(self, content: Mapping[str, Any], name: str) -> dict[str, Any]:
        plan, _ = plan_from_json(name, content)
        self.loaded = plan
        self.asked.append(("load", name))
        return {
            "plan": "1",
            "name": name,
            "kind": "phased",
            "vehicles": list(starts_of(plan)),
            "duration_s": None,
            "phases": [],
        }

    async def check(self, request: FlightRequest) -> dict[str, Any]:
        self.asked.append(("check", request))
        return self.report

    async def run(self, request: FlightRequest, *, set_return_heights: bool = False) -> tuple[bool, dict[str, Any]]:
        self.asked.append(("run", request, set_return_heights))
        return self.report["ok"], self.report

    async def resume(self, *, force: bool = False) -> tuple[bool, str, list[str]]:
        self.asked.append(("resume", force))
        return self.answer

    def _order(self, *what: Any) -> str:
        self.asked.append(what)
        if self.refuses is not None:
            raise RefusedError(self.refuses)
        return "done"

    @property
    def runner(self) -> FakePlans:
        return self

    def pause(self) -> str:
        return self._order("pause")

    def abort(self) -> str:
        return self._order("abort")

    def land(self, *, force: bool = False) -> str:
        return self._order("land", force)

    def set_speed(self, speed: float) -> str:
        return self._order("speed", speed)

    def unload(self) -> str:
        return self._order("unload")

    def status(self) -> dict[str, Any]:
        return self.states.pop(0) if len(self.states) > 1 else self.states[0]


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Commanded]:
    with Commanded(tmp_path) as found:
        found.daemon.fleet.plans = FakePlans()  # type: ignore[attr-defined]
        yield found


def fake(fleet: Commanded) -> FakePlans:
    plans: FakePlans = fleet.daemon.fleet.plans  # type: ignore[attr-defined]
    return plans


def written(tmp_path: Path, *names: str) -> str:
    starts = {name: (6.0 * i, 0.0, 10.0) for i, name in enumerate(names)}
    plan = PhasedPlan(starts, (Phase("cross", {name: (x, 9.0, z) for name, (x, _, z) in starts.items()}),))
    path = tmp_path / "swap.json"
    path.write_text(write_plan_json(plan, FlightSpace()))
    return str(path)


def ends_as(fleet: Commanded, *states: str) -> None:
    fake(fleet).states = [FLYING, FLYING, *({**FLYING, "state": s, "reason": f"it is {s}"} for s in states)]


def test_a_plan_is_loaded_flown_and_followed_to_its_goals(fleet: Commanded, tmp_path: Path) -> None:
    ends_as(fleet, "finished")
    text = fleet.run("plan", "run", written(tmp_path, "alpha", "bravo"), "--speed", "0.5", "--margin", "2.5")
    load, run = fake(fleet).asked
    assert load == ("load", "swap")
    assert run == ("run", FlightRequest("1", None, "position", 0.5, 2.5, False), False)
    assert "finished: it is finished" in text


def test_a_mission_is_flown_about_the_fleets_origin_by_the_vehicle_that_is_named(
    fleet: Commanded, tmp_path: Path
) -> None:
    path = tmp_path / "survey.plan"
    items = [
        {"command": 22, "frame": 3, "params": [0, 0, 0, None, 0, 0, 10]},
        {"command": 16, "frame": 3, "params": [0, 0, 0, None, 43.7807, -79.4653, 10]},
    ]
    mission = {"version": 2, "plannedHomePosition": [43.7806, -79.4653, 185.0], "items": items}
    path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}))
    text = fleet.run("plan", "run", str(path), "alpha", "--detach")
    assert fake(fleet).asked[-1][1].vehicles == {"survey": "alpha"}
    loaded = fake(fleet).loaded
    assert isinstance(loaded, TimedPlan)
    path_flown = loaded.trajectories["survey"]  # the origin is at 180 m
    assert path_flown.start_enu_m == pytest.approx((0.0, 0.0, 15.0), abs=0.01)
    assert path_flown.end_enu_m == pytest.approx((0.0, 11.1, 15.0), abs=0.1)
    assert "take-off and landing are no part of the path" in text
    fleet.daemon.fleet.origin = None
    text = fleet.run("plan", "run", str(path), "alpha", code=FAILED)
    assert "survey.plan: its positions are by latitude and longitude, and the fleet has no origin yet" in text


@each(("state", "hint"), [("stopped", "plan resume"), ("aborted", "aborted: it is aborted"), ("landed", "")])
def test_it_exits_1_where_it_does_not_come_to_its_goals(
    fleet: Commanded, tmp_path: Path, state: str, hint: str
) -> None:
    ends_as(fleet, state)
    code = 0 if state == "landed" else FAILED
    assert hint in fleet.run("plan", "run", written(tmp_path, "alpha", "bravo"), code=code)


def test_targets_choose_among_the_plans_vehicles_or_stand_for_them(fleet: Commanded, tmp_path: Path) -> None:
    def vehicles(*args: str) -> Any:
        fake(fleet).asked.clear()
        fleet.run("plan", "run", *args, "--detach")
        return fake(fleet).asked[-1][1].vehicles

    path = written(tmp_path, "alpha", "bravo")
    assert vehicles(path, "alpha") == {"alpha": "alpha"}
    assert vehicles(path, "all" if len(fleet.vehicles) == 2 else "alpha,bravo") == {"alpha": "alpha", "bravo": "bravo"}
    other = written(tmp_path, "cf1", "cf2")
    assert vehicles(other, "bravo,alpha") == {"cf1": "bravo", "cf2": "alpha"}, "in the order of the plan"
    text = fleet.run("plan", "run", other, "alpha", code=FAILED)
    assert "it is for cf1, cf2; alpha names alpha" in text


def test_refused_findings_come_first_and_nothing_is_followed(fleet: Commanded, tmp_path: Path) -> None:
    fake(fleet).report = NO_HEIGHTS
    text = fleet.run("plan", "run", written(tmp_path, "alpha", "bravo"), code=FAILED)
    assert text.splitlines()[0] == "by setpoints: every link carries them"
    assert text.splitlines()[1].startswith("NO   bravo return height: it returns at 15 m") and "set RTL_ALT" in text
    text = fleet.run("plan", "run", written(tmp_path, "alpha", "bravo"), "--dry-run", code=FAILED)
    assert fake(fleet).asked[-1][0] == "check"
    fake(fleet).report = REPORT
    fleet.run("plan", "run", written(tmp_path, "alpha", "bravo"), "--set-return-heights", "--force", "--detach")
    _, request, set_heights = fake(fleet).asked[-1]
    assert request.force and set_heights


def test_the_orders_of_a_flight(fleet: Commanded) -> None:
    for args, asked in (
        (("pause",), ("pause",)),
        (("speed", "0.5"), ("speed", 0.5)),
        (("abort",), ("abort",)),
        (("land", "--force"), ("land", True)),
        (("resume",), ("resume", False)),
        (("unload",), ("unload",)),
    ):
        fleet.run("plan", *args)
        assert fake(fleet).asked[-1] == asked
    fake(fleet).answer = (False, "refused: alpha and bravo come within 1 m", ["alpha and bravo come within 1 m", "b"])
    assert "alpha and bravo" in fleet.run("plan", "resume", code=FAILED)
    fake(fleet).refuses = "no plan is flown"
    for order in ("pause", "abort", "land"):
        assert "no plan is flown" in fleet.run("plan", order, code=FAILED)
    fleet.run("plan", "speed", "9", code=USAGE)


def test_status_and_watch_show_phase_clock_and_errors(fleet: Commanded) -> None:
    fake(fleet).states = [{**STATUS, "plan": None}]
    assert "no plan is loaded" in fleet.run("plan", "status")
    fake(fleet).states = [FLYING]
    text = fleet.run("plan", "status")
    assert "plan: flying, cross (2 of 3), 3.2 of 12.0 s at 1" in text
    assert "alpha  under control  0.12 m off, 0.40 m are allowed" in text
    ends_as(fleet, "finished")
    assert [status["state"] for status in map(dict, [FLYING])] == ["flying"]
    assert "finished" in fleet.run("plan", "watch")
    assert fleet.json("plan", "status")["state"] == "finished"


def test_the_picture_names_who_is_waited_for_and_who_left() -> None:
    left = {**VEHICLE, "vehicle": "bravo", "left": "its mode became POSCTL", "pos_enu_m": None, "error_m": None}
    status = {**FLYING, "waits_for": ["bravo"], "vehicles": [VEHICLE, left]}
    assert headline(status).endswith("; waits for bravo")
    screen = console()
    with screen.capture() as drawn:
        screen.print(picture(status))
    assert "POSCTL" in drawn.get() and "0.12" in drawn.get() and picture({}) == ""


def test_margins_are_shown_with_their_sources() -> None:
    report = {**REPORT, "margins": {"alpha": {"tracking_error_m": [0.31, "measured p99"], "delay_s": [0.3, "default"]}}}
    text = "\n".join(report_lines(report))
    assert "alpha margin: tracking_error_m 0.31 (measured p99), delay_s 0.3 (default)" in text and "cross 12 s" in text
