"""The steps of a flight: phases as straight ways, what is left of a trajectory, and distances from it."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import typer.main
from hypothesis import given
from hypothesis import strategies as st

from skygcs.cli.main import app, hoisted, json_last
from skygcs.core.mavlink.param_encoding import Param
from skygcs.core.mavlink.vehicle_class import TABLE, VehicleClass
from skygcs.core.plan.fleet_plan import Phase, PhasedPlan, TimedPlan
from skygcs.core.preflight.report import ReturnSetting, offered_heights
from skygcs.core.protocols.parameter import ParamOutcome
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory
from skygcs.core.vehicle.flight_note import FlightRecord
from skygcs.ext.plans import plan_checks
from skygcs.ext.plans.flight import remedies
from skygcs.ext.plans.flight.flight_findings import (
    Finding,
    FlightTime,
    Level,
    battery_finding,
    refusals,
    refused,
    return_height_findings,
)
from skygcs.ext.plans.flight.flight_steps import (
    StepKind,
    distance_to_leg,
    free_step,
    joined,
    phased_steps,
    plan_of,
    remainder,
    renamed,
    rest_of,
    starts_of,
    steps_of,
)
from skygcs.ext.plans.flight.remedies import Remedy
from skygcs.ext.plans.flight.sights import Departure, DepartureCause, Measurement
from skygcs.runtime import return_members
from support.shell_examples import calls
from support.table import each

LIMITS = MotionLimits()
CURVE = Trajectory(
    [
        Piece(3.0, (0.0, 1.0, 0.5, -0.1), (1.0, 0.0, 0.2), (5.0,), (0.1, 0.2)),
        Piece(2.0, (4.8, 1.3, -0.2), (2.8, 1.2), (5.0, 0.0, 0.3), (0.7, -0.1)),
    ]
)
AT = st.floats(0.0, 6.0, allow_nan=False)


@given(AT, AT)
def test_the_remainder_is_the_same_curve_later(from_s: float, after_s: float) -> None:
    rest = remainder(CURVE, from_s)
    if from_s >= CURVE.duration_s - 1e-3:
        assert rest.start_enu_m == pytest.approx(CURVE.end_enu_m, abs=1e-2)
        return
    after_s = min(after_s, rest.duration_s)
    one, other = rest.at(after_s), CURVE.at(min(from_s + after_s, CURVE.duration_s))
    assert one.pos_enu_m == pytest.approx(other.pos_enu_m, abs=2e-3)
    assert one.yaw_rad == pytest.approx(other.yaw_rad, abs=2e-3)


def test_phases_are_steps_in_which_those_without_a_goal_stand() -> None:
    plan = PhasedPlan(
        {"a": (0.0, 0.0, 5.0), "b": (9.0, 0.0, 5.0)},
        (Phase("wait", {}), Phase("cross", {"a": (0.0, 8.0, 5.0)}), Phase("both", {"a": (1.0, 8.0, 5.0)})),
    )
    steps = phased_steps(plan, StepKind.PLAN, LIMITS)
    assert [step.name for step in steps] == ["cross", "both"], "nobody moves in the first one"
    assert steps[0].places() == {"a": pytest.approx((0.0, 8.0, 5.0)), "b": (9.0, 0.0, 5.0)}
    assert steps[0].trajectories["b"].duration_s == pytest.approx(steps[0].trajectories["a"].duration_s)
    assert not steps[0].timed and steps[0].off_m("a", (0.5, 3.0, 5.0), 0.0, 2.0) == pytest.approx(0.5)
    certified = plan_of(steps[0])
    assert isinstance(certified, PhasedPlan) and certified.starts == steps[0].starts()


def test_a_timed_step_measures_from_the_reference_with_heights_as_in_the_certificate() -> None:
    (step,) = steps_of(TimedPlan({"a": CURVE}), LIMITS)
    x, y, z = CURVE.at(1.5).pos_enu_m
    assert step.timed and step.off_m("a", (x + 3.0, y, z + 8.0), 1.5, 2.0) == pytest.approx(5.0)


def test_the_rest_of_a_plan_is_of_those_that_stay() -> None:
    (step,) = steps_of(TimedPlan({"a": CURVE, "b": CURVE}), LIMITS)
    rest = rest_of([step, step], 2.0, frozenset({"a"}))
    assert [set(one.trajectories) for one in rest] == [{"a"}, {"a"}]
    assert rest[0].duration_s == pytest.approx(3.0) and rest[1].duration_s == 5.0
    assert rest_of([], 0.0, frozenset()) == []


def test_names_of_the_plan_become_vehicles_and_those_left_out_do_not_fly() -> None:
    timed = renamed(TimedPlan({"1": CURVE, "2": CURVE}), {"2": "bravo"})
    assert isinstance(timed, TimedPlan) and set(timed.trajectories) == {"bravo"}
    plan = PhasedPlan({"1": (0.0, 0.0, 1.0), "2": (5.0, 0.0, 1.0)}, (Phase("up", {"1": (0.0, 0.0, 5.0)}),))
    phased = renamed(plan, {"1": "alpha"})
    assert isinstance(phased, PhasedPlan) and starts_of(phased) == {"alpha": (0.0, 0.0, 1.0)}
    assert phased.phases[0].goals == {"alpha": (0.0, 0.0, 5.0)}


@given(*[st.tuples(*[st.floats(-50, 50)] * 3)] * 3)
def test_the_distance_to_a_leg_is_the_least_of_its_points(p: tuple, a: tuple, b: tuple) -> None:  # type: ignore[type-arg]
    points = [tuple(u + k / 200 * (v - u) for u, v in zip(a, b, strict=True)) for k in range(201)]
    sampled = min(math.dist(p, point) for point in points)
    assert distance_to_leg(p, a, b) == pytest.approx(sampled, abs=1e-6 + math.dist(a, b) / 200)
    assert distance_to_leg(p, a, b) <= sampled + 1e-9


def test_a_plan_without_barriers_is_one_step_along_all_its_corners() -> None:
    starts = {"a": (0.0, 0.0, 5.0), "b": (9.0, 0.0, 5.0), "c": (20.0, 0.0, 5.0)}
    there = PhasedPlan(starts, (Phase("climb", {"a": (0.0, 0.0, 10.0)}),))
    plan = PhasedPlan(
        {"a": (0.0, 0.0, 10.0), "b": (9.0, 0.0, 5.0), "c": (20.0, 0.0, 5.0)},
        (Phase("go", {"a": (0.0, 8.0, 10.0), "b": (9.0, 8.0, 5.0)}), Phase("on", {"a": (-6.0, 8.0, 10.0)})),
    )
    step = free_step(joined((there, plan)), LIMITS)
    assert step.corners == {
        "a": ((0.0, 0.0, 5.0), (0.0, 0.0, 10.0), (0.0, 8.0, 10.0), (-6.0, 8.0, 10.0)),
        "b": ((9.0, 0.0, 5.0), (9.0, 8.0, 5.0)),
    }
    assert not step.timed and step.starts() == starts
    assert step.places() == {name: pytest.approx(leg[1]) for name, leg in plan.legs()[-1][1].items()}
    for place, off_m in (
        ((0.0, 0.0, 7.0), 0.0),
        ((0.5, 4.0, 10.0), 0.5),
        ((-3.0, 8.0, 11.0), 0.5),
        ((-3.0, 4.0, 10.0), 3.0),
    ):
        assert step.off_m("a", place, 0.0, 2.0) == pytest.approx(off_m), place
    assert step.off_m("c", (20.0, 0.7, 5.0), 0.0, 2.0) == pytest.approx(0.7)


# -- What keeps a plan on the ground: batteries, return heights, what force passes; and measured consumption.


MEASURED = FlightTime(600.0, "measured in flight")


@each(
    ("percent", "plan_s", "level"),
    [(100, 240.0, Level.OK), (80, 240.0, Level.OK), (79, 240.0, Level.REFUSED), (None, 1.0, Level.REFUSED)],
)
def test_the_charge_covers_plan_landing_and_reserve(percent: float | None, plan_s: float, level: Level) -> None:
    found = battery_finding("alpha", percent, MEASURED, plan_s, 30.0)  # 240 s and 60 s of 600 s are 50 %
    assert found.level is level and found.check == "battery"
    assert level is Level.OK or found.insist
    assert percent is None or "measured in flight" in found.text


@each("said", [math.nan, math.inf])
async def test_a_return_height_that_is_no_number_is_not_known(said: float) -> None:
    """Else it is near no other, and no way home would ever cross another."""

    class Params:
        async def get(self, name: str) -> ParamOutcome:
            return ParamOutcome(True, "accepted", "", name, Param(name, said))

    actor: Any = SimpleNamespace(
        name="alpha", vehicle=SimpleNamespace(abilities=TABLE["px4", VehicleClass.COPTER]), params=Params()
    )
    assert await plan_checks.return_heights([actor]) == {"alpha": None}
    assert await return_members._param(actor, (("RTL_ALT", 100.0),)) is None


def test_return_heights_that_are_too_near_name_both_and_what_to_set() -> None:
    heights = {
        "alpha": ReturnSetting("RTL_RETURN_ALT", 1.0, 30.0),
        "bravo": ReturnSetting("RTL_ALT", 100.0, 30.0),
        "carol": ReturnSetting("RTL_ALT", 100.0, 50.0),
        "delta": None,
    }
    found = return_height_findings(heights, 6.6)
    assert [(f.vehicle, f.level) for f in found] == [("delta", Level.REFUSED), ("bravo", Level.REFUSED)]
    assert "alpha at 30 m" in found[1].text and "37 m" in found[1].text and all(f.insist for f in found)
    apart = {"alpha": heights["alpha"], "carol": heights["carol"]}
    assert [f.level for f in return_height_findings(apart, 6.6)] == [Level.OK]


@given(st.dictionaries(st.text(min_size=1, max_size=4), st.floats(5.0, 100.0), max_size=20), st.floats(0.5, 15.0))
def test_offered_heights_are_apart_and_never_lower(now: dict[str, float], apart_m: float) -> None:
    heights = {name: ReturnSetting("RTL_ALT", 100.0, height) for name, height in now.items()}
    offered = offered_heights(heights, apart_m)
    assert all(offered[name] >= height - 1e-6 for name, height in now.items())
    again = {name: ReturnSetting("RTL_ALT", 100.0, height) for name, height in offered.items()}
    assert [f.level for f in return_height_findings(again, apart_m)] == [Level.OK]


def test_force_passes_only_what_can_be_insisted_on() -> None:
    battery = refused("alpha", "battery", "low", remedies.again("charge it"), insist=True)
    position = refused("alpha", "position", "unknown", remedies.leave_out("alpha", ["alpha", "bravo"]))
    fine = Finding("alpha", "link", Level.OK, "fine")
    assert refusals([battery, position, fine], force=False) == [battery, position]
    assert refusals([battery, position, fine], force=True) == [position]


def test_consumption_is_believed_after_some_minutes_and_begins_anew_with_another_battery() -> None:
    record = FlightRecord()
    now = 0.0
    for percent in range(100, 79, -1):
        record.charge(now, float(percent), in_air=True)
        now += 6.0
    assert record.flight_time_s == pytest.approx(600.0)
    record.charge(now, 100.0, in_air=True)
    assert record.flight_time_s is None
    record = FlightRecord()
    for percent in (100.0, 90.0):
        record.charge(now, percent, in_air=False)
    record.charge(now + 900.0, None, in_air=True)
    assert record.flight_time_s is None, "on the ground nothing is consumed for flying"


# -- Sights of a flight's vehicles.


PILOT = Departure(DepartureCause.PILOT, "it was switched to POSCTL")
GUARD = Departure(DepartureCause.GUARD, "the guard holds it")
SEEN = Measurement((0.0, 0.0, 5.0))


@each(
    ("sight", "left", "taken", "piloted"),
    [
        (SEEN, None, False, False),
        (SEEN, PILOT, True, True),
        (SEEN._replace(holds=True), PILOT, False, False),
        (SEEN._replace(by_failsafe=True), PILOT, True, False),  # it was not landed with the others, and sank
        (SEEN, GUARD, False, False),
        (SEEN._replace(unexpected_mode="POSCTL"), None, False, True),
        (SEEN._replace(unexpected_mode="POSCTL", by_failsafe=True), None, False, False),
    ],
)
def test_one_that_somebody_else_flies_is_not_landed_and_one_in_a_failsafe_is(
    sight: Measurement, left: Departure | None, taken: bool, piloted: bool
) -> None:
    assert (sight.taken(left), sight.piloted(left)) == (taken, piloted)


# -- Every refusal of a flight has a remedy whose command is one: all remedies, read by the command line's own parser.


ROOT_COMMAND = typer.main.get_command(app)

EXAMPLES: dict[str, list[Any]] = {
    "before": ["charge it"],
    "name": ["alpha"],
    "names": [["alpha"], ["alpha", "bravo", "charlie"]],
    "factor": [0.35],
    "param": ["RTL_ALT"],
    "value": [1500.0],
    "radius_m": [None, 20.2],
    "height_m": [None, 12.0],
}
MADE = [
    make
    for name, make in inspect.getmembers(remedies, inspect.isfunction)
    if make.__module__ == remedies.__name__ and not name.startswith("_")
]


def every(make: Callable[..., Remedy]) -> list[Remedy]:
    """The remedies that it makes of all examples."""
    made: list[dict[str, Any]] = [{}]
    for parameter in inspect.signature(make).parameters:
        made = [{**one, parameter: value} for one in made for value in EXAMPLES[parameter]]
    return [make(**one) for one in made]


def parse(line: str) -> None:
    ((_, *args),) = calls(line)
    command, rest, parent = ROOT_COMMAND, hoisted(json_last(args)), None
    while True:
        context = command.make_context(command.name, rest, parent=parent)
        words = [*getattr(context, "_protected_args", ()), *context.args]
        if not hasattr(command, "resolve_command") or not words:
            return
        _, command, rest = command.resolve_command(context, words)
        parent = context


def test_the_command_of_every_remedy_is_one() -> None:
    found = [remedy for make in MADE for remedy in every(make)]
    assert len(MADE) > 15
    for remedy in found:
        parse(remedy.command)
        assert f"`{remedy.command}`" in remedy.text(insist=False), remedy
        assert "--force" in remedy.text(insist=True), remedy
        assert remedy.text(insist=False).startswith(remedy.before)


def test_a_refusal_without_a_remedy_cannot_be_made() -> None:
    with pytest.raises(ValueError, match="remedy"):
        Finding("alpha", "link", Level.REFUSED, "too slow")
    with pytest.raises(ValueError, match="remedy"):
        Finding("alpha", "link", Level.OK, "fine", remedy=remedies.by_goto())
    assert refused("alpha", "link", "too slow", remedies.by_goto()).as_dict()["command"] == f"{remedies.RUN} --by goto"
