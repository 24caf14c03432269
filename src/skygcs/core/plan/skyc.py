"""Skybrush's compiled shows (.skyc): a zip with show.json and, per drone, a trajectory in Bézier segments.

    show.json                       {"version": 1, "swarm": {"drones": [{"settings": {"name": …, "home": [x, y, z],
                                    "trajectory": {…} or {"$ref": "./drones/NAME/trajectory.json#"},
                                    "yawControl": the same, see `skyc_yaw`}}]}, …}
    drones/NAME/trajectory.json     {"version": 1, "takeoffTime": s, "points": [[t, [x, y, z], [control points]], …]}

Each point ends a Bézier segment that began at the point before; the control points lie between them; t counts from
take-off. A fourth number of a point is the yaw in radians (a dialect of laboratories). Lights and pyrotechnics are not
read. Source: skybrush-server, `show/trajectory.py`.

A Bézier segment is a polynomial in Bernstein form: positions are not approximated in either direction.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any

from skygcs.core.plan.file_reading import (
    MAX_FILE_BYTES,
    Trajectories,
    json_of,
    number_of,
    refused,
    require_pieces,
    require_vehicles,
    vehicle_name,
)
from skygcs.core.plan.skyc_yaw import with_yaw, yaw_control
from skygcs.core.trajectory import Piece, Trajectory
from skygcs.core.trajectory.piecewise import MAX_DEGREE, MAX_DURATION_S, MAX_PIECES, MIN_PIECE_S, from_power, to_power
from skygcs.errors import PlanFileError, TrajectoryError

MAX_MEMBERS = 4096
"""Files in the zip: two for each of 255 drones, and pictures."""

MAX_UNPACKED_BYTES = 64 << 20
"""Most bytes of all members that are read together. A zip bomb claims, or unpacks to, more."""

UNPACKED_IN_STEPS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Members that zipfile unpacks as they are read. A block of bzip2 or lzma unpacks whole: 2,469 bytes gave 3.1 GB."""

Ask = Mapping[str, Any]


def read_skyc(source: str, data: bytes) -> Trajectories:
    """The trajectories of all drones. Raises PlanFileError."""
    archive = _Archive(source, data)
    show = archive.json("show.json")
    drones = _get(source, "show.json", _get(source, "show.json", show, "swarm", dict), "drones", list)
    require_vehicles(source, len(drones))
    trajectories: Trajectories = {}
    count = 0
    for number, drone in enumerate(drones, 1):
        where = f"drone {number}"
        settings = _get(source, where, drone, "settings", dict)
        name = vehicle_name(source, where, settings.get("name", f"drone {number}"))
        if name in trajectories:
            raise PlanFileError(source, where, f"{name} is there twice")
        found = archive.referred(where, _get(source, where, settings, "trajectory", dict))
        try:
            trajectories[name] = _trajectory(source, f"drone {name}", found)
            if settings.get("yawControl") is not None:
                control = archive.referred(where, _get(source, where, settings, "yawControl", dict))
                trajectories[name] = with_yaw(source, f"drone {name}", trajectories[name], control)
        except TrajectoryError as error:
            raise refused(source, f"drone {name}", error) from None
        count += len(trajectories[name].pieces)
        require_pieces(source, f"drone {name}", count)
    return trajectories


def write_skyc(trajectories: Mapping[str, Trajectory]) -> bytes:
    """The bytes of the file, the same for the same plan."""
    drones: list[Any] = []
    members: dict[str, Any] = {}
    for number, (name, trajectory) in enumerate(trajectories.items(), 1):
        member = f"drones/drone_{number}/trajectory.json"
        members[member] = _as_show(trajectory)
        settings: dict[str, Any] = {
            "name": name,
            "home": list(trajectory.start_enu_m),
            "landAt": list(trajectory.end_enu_m),
            "trajectory": {"$ref": f"./{member}#"},
        }
        if (control := yaw_control(trajectory)) is not None:
            settings["yawControl"] = control
        drones.append({"type": "generic", "settings": settings})
    show = {
        "version": 1,
        "environment": {"type": "outdoor"},
        "settings": {"cues": {"version": 1, "items": []}},
        "swarm": {"drones": drones},
        "meta": {"title": "skygcs"},
        "media": {},
    }
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, content in {"show.json": show, **members}.items():
            archive.writestr(zipfile.ZipInfo(member), json.dumps(content), zipfile.ZIP_DEFLATED)
    return file.getvalue()


class _Archive:
    """The JSON files in a zip; no more is unpacked than is allowed, whatever the zip claims."""

    def __init__(self, source: str, data: bytes) -> None:
        self._source = source
        self._left = MAX_UNPACKED_BYTES
        if len(data) > MAX_FILE_BYTES:
            raise PlanFileError(source, "", f"larger than {MAX_FILE_BYTES >> 20} MiB")
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(data))
            names = self._zip.namelist()
        except Exception as error:  # zipfile raises much more than BadZipFile for a broken file
            raise PlanFileError(source, "", f"not a zip file: {_short(error)}") from None
        if len(names) > MAX_MEMBERS:
            raise PlanFileError(source, "", f"{len(names)} files in the zip; the most is {MAX_MEMBERS}")
        if len(set(names)) < len(names):
            raise PlanFileError(source, "", "a file is in the zip twice")

    def referred(self, where: str, found: Ask) -> Ask:
        """Return what is there, or in the member to which it refers. Raises PlanFileError."""
        if "$ref" not in found:
            return found
        content = self.json(_get(self._source, where, found, "$ref", str))
        if not isinstance(content, dict):
            raise PlanFileError(self._source, where, "it refers to a file that has no object")
        return content

    def json(self, reference: str) -> Any:
        """The member that a path or reference ("./a/b.json#") names. Raises PlanFileError."""
        name = reference.partition("#")[0].removeprefix("./")
        packed = self._zip.NameToInfo.get(name)
        if packed is not None and packed.compress_type not in UNPACKED_IN_STEPS:
            text = "is packed in another way than deflate; zip it anew without bzip2 or lzma"
            raise PlanFileError(self._source, name[:80], text)
        try:
            with self._zip.open(name) as member:
                data = member.read(self._left + 1)
        except KeyError:
            raise PlanFileError(self._source, "", f"there is no {name[:80]!r} in the zip") from None
        except (zlib.error, Exception) as error:  # a broken or encrypted member: RuntimeError, EOFError, OSError, …
            raise PlanFileError(self._source, name[:80], f"cannot be unpacked: {_short(error)}") from None
        self._left -= len(data)
        if self._left < 0:
            raise PlanFileError(self._source, name[:80], f"unpacks to more than {MAX_UNPACKED_BYTES >> 20} MiB")
        return json_of(f"{self._source}, {name[:80]}", data)


def _short(error: Exception) -> str:
    return str(error)[:120] or type(error).__name__


def _get(source: str, where: str, value: Any, key: str, kind: type) -> Any:
    if not isinstance(value, dict) or not isinstance(value.get(key), kind):
        raise PlanFileError(source, where, f"there is no {key}")
    return value[key]


def _trajectory(source: str, where: str, show: Ask) -> Trajectory:
    """Raises PlanFileError and TrajectoryError."""
    version = show.get("version")
    if version != 1 or isinstance(version, bool):
        raise PlanFileError(source, where, f"trajectory of version {str(version)[:20]}; only 1 is known")
    points = _get(source, where, show, "points", list)
    if not points or len(points) > MAX_PIECES:
        raise PlanFileError(source, where, f"{len(points)} points; there are 1 to {MAX_PIECES}")
    takeoff_s = number_of(source, where, "takeoffTime", show.get("takeoffTime", 0.0), MAX_DURATION_S)
    # each point ends a Bézier segment from the point before
    pieces: list[Piece] = []
    before: list[float] = []
    time = 0.0
    for number, point in enumerate(points, 1):
        here = f"{where}, point {number}"
        if not isinstance(point, list) or len(point) != 3 or not isinstance(point[2], list):
            raise PlanFileError(source, here, "a point is [time, [x, y, z], [control points]]")
        t = number_of(source, here, "time", point[0], MAX_DURATION_S) + takeoff_s
        place = _vector(source, here, point[1])
        controls = [_vector(source, here, control) for control in point[2]]
        if any(len(other) != len(place) for other in (*controls, *([before] if before else []))):
            raise PlanFileError(source, here, "either all points have a yaw or none")
        if len(controls) >= MAX_DEGREE:
            raise PlanFileError(source, here, f"{len(controls)} control points; the most is {MAX_DEGREE - 1}")
        if not before:
            if controls or t < 0.0:
                raise PlanFileError(source, here, "the first point has no control points and no time before 0")
            if t >= MIN_PIECE_S or len(points) == 1:
                pieces.append(_segment(max(t, 1.0) if len(points) == 1 else t, [place]))
                time = t
        else:
            pieces.append(_segment(t - time, [before, *controls, place]))
            time = t
        before = place
    return Trajectory(pieces)


def _segment(duration_s: float, points: list[list[float]]) -> Piece:
    if not duration_s >= MIN_PIECE_S:
        raise TrajectoryError(f"a segment of {duration_s:g} s; times ascend by at least {MIN_PIECE_S:g} s")
    axes = [to_power([point[k] for point in points], duration_s) for k in range(len(points[0]))]
    return Piece(duration_s, *axes)


def _vector(source: str, where: str, value: Any) -> list[float]:
    if not isinstance(value, list) or len(value) not in (3, 4):
        raise PlanFileError(source, where, "a place has three numbers, and a yaw or none")
    return [number_of(source, where, "a coordinate", number) for number in value]


def _as_show(trajectory: Trajectory) -> dict[str, Any]:
    points: list[Any] = []
    time = 0.0
    for piece in trajectory.pieces:
        degree = max(len(coefficients) for _, coefficients in piece.axes()[:3]) - 1
        controls = []
        for _, coefficients in piece.axes()[:3]:
            padded = (*coefficients, *(0.0,) * (degree + 1 - len(coefficients)))
            controls.append(from_power(padded, piece.duration_s))
        if degree == 0:
            controls = [values * 2 for values in controls]
        segment = [list(point) for point in zip(*controls, strict=True)]
        if not points:
            points.append([0.0, segment[0], []])
        time += piece.duration_s
        points.append([time, segment[-1], segment[1:-1]])
    return {"version": 1, "takeoffTime": 0, "points": points}
