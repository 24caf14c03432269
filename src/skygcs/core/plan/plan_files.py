"""Which format a plan file has, by its name and its content; and how each is read and written.

.json          skygcs' own (`plan_json`)
.skyc          a Skybrush show
.csv           Crazyswarm polynomials (33 numbers a line), a log by lat and lon, or vehicle,t,x,y,z,yaw
.plan          a mission of QGroundControl
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from skygcs.core.geo import Origin
from skygcs.core.plan.crazyswarm import NUMBERS, read_crazyswarm
from skygcs.core.plan.file_reading import require_pieces, require_vehicles, rows, text_of
from skygcs.core.plan.fleet_plan import FlightSpace, Plan, TimedPlan
from skygcs.core.plan.mission_path import read_mission_path
from skygcs.core.plan.plan_json import read_plan_json
from skygcs.core.plan.skyc import read_skyc
from skygcs.core.plan.trajectory_csv import is_log, read_log_csv, read_trajectory_csv
from skygcs.core.trajectory import MotionLimits, Trajectory
from skygcs.errors import PlanFileError


class ReadPlan(NamedTuple):
    """Contents of a file; ``format`` and ``notes`` (what was assumed or left out) for people."""

    plan: Plan
    space: FlightSpace
    format: str
    notes: tuple[str, ...] = ()
    origin: Origin | None = None
    """About which positions by latitude and longitude were converted; None: there were none."""


class NamedFile(NamedTuple):
    """A file's name and content; ``vehicle`` as `read_plan`."""

    source: str
    data: bytes
    vehicle: str | None = None


def read_plan(
    source: str, data: bytes, limits: MotionLimits, origin: Origin | None = None, vehicle: str | None = None
) -> ReadPlan:
    """Read any of the formats. Raises PlanFileError and nothing else.

    ``source`` is the file's name. ``vehicle``: whose path it is, in a file of one that names none; None: the file's
    stem. A .plan without ``origin`` is read about its planned home.
    """
    stem, _, suffix = source.replace("\\", "/").rpartition("/")[2].rpartition(".")
    own = vehicle or stem[:64] or "vehicle"
    match suffix.lower():
        case "csv":
            return _csv(source, data, own, limits, origin)
        case "plan":
            path = read_mission_path(source, data, limits, origin)
            plan = TimedPlan({own: path.trajectory})
            return ReadPlan(plan, FlightSpace(), "QGroundControl plan", path.notes, path.origin)
        case "json" | "skyc" if vehicle is not None:
            raise PlanFileError(source, "", f"its vehicles have names: it cannot be read as the path of {vehicle}")
        case "json":
            return ReadPlan(*read_plan_json(source, data), "skygcs plan")
        case "skyc":
            return ReadPlan(TimedPlan(read_skyc(source, data)), FlightSpace(), "Skybrush show")
    raise PlanFileError(source, "", "the name ends in none of .json, .skyc, .csv, .plan")


def read_together(files: Sequence[NamedFile], limits: MotionLimits, origin: Origin | None = None) -> ReadPlan:
    """One plan of one file or more; several are one timed plan together, about the origin of the first that has one.
    Raises PlanFileError."""
    found: list[ReadPlan] = []
    for file in files:
        found.append(read_plan(file.source, file.data, limits, origin, file.vehicle))
        origin = origin or found[-1].origin
    if len(found) == 1:
        return found[0]
    trajectories: dict[str, Trajectory] = {}
    for file, part in zip(files, found, strict=True):
        if not isinstance(part.plan, TimedPlan) or part.space != FlightSpace():
            raise PlanFileError(file.source, "", "only files of trajectories can be put together")
        if twice := trajectories.keys() & part.plan.trajectories.keys():
            raise PlanFileError(
                file.source, "", f"vehicle {min(twice)} is in two files; NAME=FILE gives it another name"
            )
        trajectories.update(part.plan.trajectories)
    require_vehicles(files[0].source, len(trajectories))
    require_pieces(files[0].source, "", sum(len(path.pieces) for path in trajectories.values()))
    notes = tuple(f"{file.source}: {note}" for file, part in zip(files, found, strict=True) for note in part.notes)
    return ReadPlan(TimedPlan(trajectories), FlightSpace(), f"{len(found)} files", notes, origin)


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
