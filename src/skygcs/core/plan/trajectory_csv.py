"""CSV files of paths: `vehicle,t,x,y,z,yaw`, and logs by `time,lat,lon,alt`.

vehicle,t,x,y,z,yaw      t in s from the common start; x, y, z in m of the world frame; yaw in degrees,
alpha,0,0,0,5,90         counter-clockwise from x. t and yaw may be missing, in the whole file (t) or for a
alpha,10,20,0,5,90       vehicle (yaw), the vehicle in a file of one. Timed rows are joined by straight lines,
                         others are timed within limits.

time,mode,lat,lon,alt,…  a log as it was flown: one vehicle per file unless there is a column vehicle. Degrees, or
                         the integers of GLOBAL_POSITION_INT (degE7 and mm). alt is above the origin, alt_amsl
                         above sea level. time in s, or HH:MM:SS, counted from the first row of the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from skygcs.core.geo import Origin, enu_from_geodetic
from skygcs.core.plan.file_reading import (
    Trajectories,
    number_of,
    refused,
    require_pieces,
    require_vehicles,
    rows,
    text_of,
    vehicle_name,
)
from skygcs.core.trajectory import MotionLimits, Trajectory
from skygcs.core.trajectory.piecewise import MAX_DURATION_S, MAX_PIECES, Vector
from skygcs.core.trajectory.timing import TimedPoint, path_within, straight_lines
from skygcs.errors import PlanFileError, TrajectoryError

COLUMNS = ("vehicle", "t", "x", "y", "z", "yaw")
LOG_COLUMNS = ("time", "lat", "lon")

MAX_YAW_DEG = 36_000.0
"""A hundred turns."""

DEGE7_FROM = 180.0
"""A latitude or longitude above it is in units of 1e-7 degrees, and the altitude of such a log in millimetres."""

MAX_TIME_S = 1e11
"""Seconds since 1970 are 2e9."""


@dataclass(slots=True)
class _Path:
    """The rows of one vehicle."""

    lines: list[int] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    points: list[Vector] = field(default_factory=list)
    yaws_rad: list[float] = field(default_factory=list)


class _Header(NamedTuple):
    line: int
    columns: dict[str, int]


def read_trajectory_csv(source: str, data: bytes, limits: MotionLimits, vehicle: str | None = None) -> Trajectories:
    """Paths in the world frame; ``vehicle`` as `read_paths`. Raises PlanFileError."""
    paths = read_paths(source, data, vehicle)
    return {name: _trajectory(source, name, path, limits) for name, path in paths.items()}


def read_formation_csv(source: str, data: bytes) -> tuple[Vector, ...]:
    """The points of a formation: rows x,y,z in metres, about any point. Raises PlanFileError."""
    lines = rows(source, text_of(source, data))
    header = _header(source, lines)
    if header.columns.keys() != {"x", "y", "z"}:
        raise PlanFileError(source, f"line {header.line}", "the columns of a formation are x, y, z")
    points: list[Vector] = []
    for number, cells in lines:
        where = f"line {number}"
        row = _row(source, where, header, cells)
        x, y, z = (number_of(source, where, axis, row[axis]) for axis in ("x", "y", "z"))
        points.append((x, y, z))
        require_vehicles(source, len(points))
    require_vehicles(source, len(points))
    return tuple(points)


def read_paths(source: str, data: bytes, vehicle: str | None = None) -> Mapping[str, _Path]:
    """The rows by vehicle. ``vehicle``: whose they are in a file without that column; None: it must be there. Raises
    PlanFileError."""
    lines = rows(source, text_of(source, data))
    header = _header(source, lines)
    unknown = [name for name in header.columns if name not in COLUMNS]
    required = {"x", "y", "z"} if vehicle is not None else {"vehicle", "x", "y", "z"}
    if unknown or not required <= header.columns.keys():
        raise PlanFileError(source, f"line {header.line}", f"the columns are {', '.join(COLUMNS)} (t, yaw optional)")
    paths: dict[str, _Path] = {}
    for count, (number, cells) in enumerate(lines, 1):
        where = f"line {number}"
        require_pieces(source, where, count)
        row = _row(source, where, header, cells)
        path = paths.setdefault(vehicle_name(source, where, row.get("vehicle", vehicle)), _Path())
        path.lines.append(number)
        x, y, z = (number_of(source, where, axis, row[axis]) for axis in ("x", "y", "z"))
        path.points.append((x, y, z))
        if row.get("t"):
            path.times.append(number_of(source, where, "t", row["t"], MAX_DURATION_S))
        if row.get("yaw"):
            path.yaws_rad.append(math.radians(number_of(source, where, "yaw", row["yaw"], MAX_YAW_DEG)))
        _bounded(source, where, path)
    require_vehicles(source, len(paths))
    timed = sum(len(path.times) for path in paths.values())
    if 0 < timed < sum(len(path.points) for path in paths.values()):
        raise PlanFileError(source, "", "either every row has a time t or none")
    for name, path in paths.items():
        if 0 < len(path.yaws_rad) < len(path.points):
            raise PlanFileError(source, f"vehicle {name}", "either every row has a yaw or none")
    return paths


def is_log(source: str, data: bytes) -> bool:
    """True if the first line names latitude and longitude. Raises PlanFileError."""
    first = next(rows(source, text_of(source, data[: 1 << 12].rpartition(b"\n")[0] or data)), (0, []))[1]
    return set(LOG_COLUMNS) <= {cell.lower() for cell in first}


def read_log_csv(source: str, data: bytes, origin: Origin, vehicle: str) -> Trajectories:
    """A log by latitude and longitude as a timed path; ``vehicle`` where the log names none. Raises PlanFileError."""
    lines = rows(source, text_of(source, data))
    header = _header(source, lines)
    if not set(LOG_COLUMNS) <= header.columns.keys() or not {"alt", "alt_amsl"} & header.columns.keys():
        raise PlanFileError(source, f"line {header.line}", "a log has the columns time, lat, lon and alt or alt_amsl")
    paths: dict[str, _Path] = {}
    first_time = None
    for count, (number, cells) in enumerate(lines, 1):
        where = f"line {number}"
        require_pieces(source, where, count)
        row = _row(source, where, header, cells)
        path = paths.setdefault(vehicle_name(source, where, row.get("vehicle") or vehicle), _Path())
        time = _time(source, where, row["time"])
        first_time = time if first_time is None else first_time
        path.lines.append(number)
        path.times.append(time - first_time)
        path.points.append(_place(source, where, row, origin))
        _bounded(source, where, path)
    require_vehicles(source, len(paths))
    return {name: _trajectory(source, name, path, MotionLimits()) for name, path in paths.items()}


def _header(source: str, lines: Iterable[tuple[int, list[str]]]) -> _Header:
    for number, cells in lines:
        columns = {cell.lower(): index for index, cell in enumerate(cells) if cell}
        if len(columns) < sum(1 for cell in cells if cell):
            raise PlanFileError(source, f"line {number}", "a column is there twice")
        return _Header(number, columns)
    raise PlanFileError(source, "", "it is empty")


def _row(source: str, where: str, header: _Header, cells: list[str]) -> dict[str, str]:
    if any(cells[len(header.columns) :]) and max(header.columns.values(), default=0) + 1 < len(cells):
        raise PlanFileError(source, where, f"{len(cells)} cells; the header has {len(header.columns)}")
    row = {name: cells[index] for name, index in header.columns.items() if index < len(cells)}
    for name in ("vehicle", "x", "y", "z", *LOG_COLUMNS):
        if name in header.columns and not row.get(name) and not (name == "vehicle" and "lat" in header.columns):
            raise PlanFileError(source, where, f"{name} is missing")
    return row


def _bounded(source: str, where: str, path: _Path) -> None:
    if len(path.points) > MAX_PIECES:
        raise PlanFileError(source, where, f"more than {MAX_PIECES} rows of one vehicle")


def _trajectory(source: str, name: str, path: _Path, limits: MotionLimits) -> Trajectory:
    where = f"vehicle {name}, lines {path.lines[0]} to {path.lines[-1]}"
    yaws: Sequence[float | None] = path.yaws_rad or [None] * len(path.points)
    try:
        if path.times:
            return straight_lines([TimedPoint(*row) for row in zip(path.times, path.points, yaws, strict=True)])
        return path_within(path.points, limits, path.yaws_rad or None)
    except TrajectoryError as error:
        raise refused(source, where, error) from None


def _time(source: str, where: str, text: str) -> float:
    """Seconds, or HH:MM:SS with or without a date before it."""
    clock = text.replace("T", " ").rpartition(" ")[2]
    parts = clock.split(":")
    if len(parts) == 3:
        hours, minutes, seconds = (number_of(source, where, "time", part, 61.0) for part in parts)
        return hours * 3600.0 + minutes * 60.0 + seconds
    return number_of(source, where, "time", text, MAX_TIME_S)


def _place(source: str, where: str, row: Mapping[str, str], origin: Origin) -> Vector:
    lat, lon = (number_of(source, where, name, row[name], 1.8e9) for name in ("lat", "lon"))
    integers = max(abs(lat), abs(lon)) > DEGE7_FROM
    if integers:
        lat, lon = lat * 1e-7, lon * 1e-7
    if abs(lat) > 90.0 or abs(lon) > 180.0:
        raise PlanFileError(source, where, f"{lat:g}, {lon:g} is not a place on earth")
    name = "alt_amsl" if row.get("alt_amsl") else "alt"
    altitude = number_of(source, where, name, row.get(name), 1e8) * (1e-3 if integers else 1.0)
    amsl = altitude if name == "alt_amsl" else altitude + origin.alt_amsl_m
    x, y, up = enu_from_geodetic(lat, lon, amsl, origin)
    for axis, value in (("x", x), ("y", y), ("up", up)):
        number_of(source, where, f"{axis} from the origin", value)
    return x, y, up
