"""The paths of plans, and whose they are."""

from __future__ import annotations

import pytest

from skygcs.core.plan.fleet_plan import Phase, PhasedPlan, TimedPlan
from skygcs.core.trajectory import MotionLimits
from skygcs.core.trajectory.timing import path_within
from skygcs.ext.logs.report.day_figures import DayReport, VehicleDay
from skygcs.ext.logs.report.planned import add_plan, planned_paths, system_of


def report(*systems: int) -> DayReport:
    return DayReport("x", vehicles=[VehicleDay((n, 1), f"vehicle {n}") for n in systems])


def test_a_phased_plan_flies_from_corner_to_corner() -> None:
    phases = (Phase("up", {"a": (0.0, 0.0, 9.0)}), Phase("out", {"a": (5.0, 0.0, 9.0), "b": (1.0, 1.0, 3.0)}))
    paths = planned_paths(PhasedPlan({"a": (0.0, 0.0, 0.0), "b": (1.0, 1.0, 0.0)}, phases))
    assert paths == {"a": [(0.0, 0.0, 0.0), (0.0, 0.0, 9.0), (5.0, 0.0, 9.0)], "b": [(1.0, 1.0, 0.0), (1.0, 1.0, 3.0)]}


def test_a_timed_plan_is_sampled_from_begin_to_end() -> None:
    way = path_within([(0.0, 0.0, 5.0), (30.0, 0.0, 5.0), (30.0, 40.0, 15.0)], MotionLimits())
    (points,) = planned_paths(TimedPlan({"a": way})).values()
    assert points[0] == pytest.approx((0.0, 0.0, 5.0)) and points[-1] == pytest.approx((30.0, 40.0, 15.0))
    assert len(points) > 400
    assert all(-1.0 <= x <= 31.0 and -1.0 <= y <= 41.0 and 4.0 <= up <= 16.0 for x, y, up in points)


def test_a_path_goes_to_the_vehicle_of_its_name() -> None:
    assert [system_of(name, {"alpha": 7, "v3": 9}) for name in ("alpha", "v3", "V4", "vehicle 5", "6", "beta")] == [
        *(7, 9, 4, 5, 6),
        None,
    ]
    made = report(7, 8)
    add_plan(made, {"alpha": [(1.0, 2.0, 3.0), (4.0, 5.0, 6.0)], "beta": [(0.0, 0.0, 0.0)]}, {"alpha": 7})
    assert made.vehicles[0].plan == ([1.0, 4.0], [2.0, 5.0])
    assert made.vehicles[0].plan_heights_m == (3.0, 6.0)
    assert made.vehicles[1].plan is None
    assert made.missing == [
        "the plan's paths of beta: no tlog has a vehicle of that name; --fleet FILE gives system ids names"
    ]


def test_the_only_path_goes_to_the_only_vehicle() -> None:
    made = report(3)
    add_plan(made, {"survey": [(1.0, 2.0, 3.0)]}, {})
    assert made.vehicles[0].plan == ([1.0], [2.0]) and made.missing == []
