"""The paths of a plan as lines, and whose each is. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from skygcs.core.plan.fleet_plan import PhasedPlan, Plan
from skygcs.core.trajectory import Trajectory
from skygcs.core.trajectory.piecewise import Vector
from skygcs.ext.logs.report.day_figures import DayReport, VehicleDay

POINTS = 400
"""Points of one path, beside the ends of its pieces."""

MOST_ENDS = 400

_NUMBERED = re.compile(r"(?:v|vehicle[ _-]?)?(\d{1,3})")
"""A name that is a system id: "3", "v3", "vehicle 3"."""


def planned_paths(plan: Plan) -> dict[str, list[Vector]]:
    """Points of each vehicle's path in metres, along the plan's axes; a phased plan flies from corner to corner."""
    if isinstance(plan, PhasedPlan):
        paths = {name: [start] for name, start in plan.starts.items()}
        for _, legs in plan.legs():
            for name, (begin, end) in legs.items():
                if end != begin:
                    paths[name].append(end)
        return paths
    return {name: _sampled(trajectory) for name, trajectory in plan.trajectories.items()}


def _sampled(trajectory: Trajectory) -> list[Vector]:
    times = [n * trajectory.duration_s / POINTS for n in range(POINTS + 1)]
    if len(trajectory.begins_s) <= MOST_ENDS:
        times = sorted({*times, *trajectory.begins_s})
    return [trajectory.at(t_s).pos_enu_m for t_s in times]


def system_of(name: str, names: Mapping[str, int]) -> int | None:
    """The system id that a vehicle's name stands for, by the fleet file or as a number; None if none."""
    numbered = _NUMBERED.fullmatch(name.lower())
    return names.get(name, int(numbered[1]) if numbered is not None else None)


def add_plan(report: DayReport, paths: Mapping[str, Sequence[Vector]], names: Mapping[str, int]) -> None:
    """Give each vehicle of the report its path; what belongs to none is named as missing. ``names``: system ids."""
    by_system: dict[int | None, VehicleDay] = {}
    for known in report.vehicles:
        by_system.setdefault(known.key[0], known)
    unknown = []
    for name, points in paths.items():
        day = by_system.get(system_of(name, names))
        if day is None and len(paths) == len(report.vehicles) == 1:
            day = report.vehicles[0]
        if day is None:
            unknown.append(name)
            continue
        day.plan = [x for x, _, _ in points], [y for _, y, _ in points]
        day.plan_heights_m = min(up for _, _, up in points), max(up for _, _, up in points)
    if unknown:
        why = "no tlog has a vehicle of that name; --fleet FILE gives system ids names"
        report.missing.append(f"the plan's paths of {', '.join(sorted(unknown))}: {why}")
