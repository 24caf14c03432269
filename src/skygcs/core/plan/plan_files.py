"""Which format a plan file has, by its name and its content; and how each is read and written.

.json          skygcs' own (`plan_json`)
.skyc          a Skybrush show
.csv           Crazyswarm polynomials (33 numbers a line), a log by lat and lon, or vehicle,t,x,y,z,yaw
"""

from __future__ import annotations

from typing import NamedTuple

from skygcs.core.geo import Origin
from skygcs.core.plan.crazyswarm import NUMBERS, read_crazyswarm
from skygcs.core.plan.file_reading import rows, text_of
from skygcs.core.plan.fleet_plan import FlightSpace, Plan, TimedPlan
from skygcs.core.plan.plan_json import read_plan_json
from skygcs.core.plan.skyc import read_skyc
from skygcs.core.plan.trajectory_csv import is_log, read_log_csv, read_trajectory_csv
from skygcs.core.trajectory import MotionLimits
from skygcs.errors import PlanFileError


class ReadPlan(NamedTuple):
    """What a file holds; ``format`` for people."""

    plan: Plan
    space: FlightSpace
    format: str


def read_plan(source: str, data: bytes, limits: MotionLimits, origin: Origin | None = None) -> ReadPlan:
    """Read any of the formats; ``source`` is the file's name. Raises PlanFileError and nothing else."""
    stem, _, suffix = source.replace("\\", "/").rpartition("/")[2].rpartition(".")
    match suffix.lower():
        case "json":
            return ReadPlan(*read_plan_json(source, data), "skygcs plan")
        case "skyc":
            return ReadPlan(TimedPlan(read_skyc(source, data)), FlightSpace(), "Skybrush show")
        case "csv":
            return _csv(source, data, stem[:64] or "vehicle", limits, origin)
    raise PlanFileError(source, "", "the name ends in none of .json, .skyc, .csv")


def _csv(source: str, data: bytes, vehicle: str, limits: MotionLimits, origin: Origin | None) -> ReadPlan:
    if is_log(source, data):
        if origin is None:
            raise PlanFileError(source, "", "a log by latitude and longitude needs an origin (--origin LAT,LON,ALT)")
        return ReadPlan(TimedPlan(read_log_csv(source, data, origin, vehicle)), FlightSpace(), "log by lat, lon, alt")
    if _is_crazyswarm(source, data):
        return ReadPlan(TimedPlan({vehicle: read_crazyswarm(source, data)}), FlightSpace(), "Crazyswarm polynomials")
    paths = read_trajectory_csv(source, data, limits, vehicle)
    return ReadPlan(TimedPlan(paths), FlightSpace(), "paths by vehicle,t,x,y,z,yaw")


def _is_crazyswarm(source: str, data: bytes) -> bool:
    first = next(rows(source, text_of(source, data)), (0, [""]))[1]
    return first[0].lower() == "duration" or len(first) >= NUMBERS
