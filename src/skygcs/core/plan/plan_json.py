"""skygcs' own plan files, JSON:

    {"format": "skygcs-plan", "version": 1, "kind": "timed",
     "vehicles": {"alpha": [[duration_s, [east…], [north…], [up…], [yaw…] or null], …]},   ascending coefficients
     "space": {…}, "certificate": {…}}

    {"format": "skygcs-plan", "version": 1, "kind": "phased",
     "starts": {"alpha": [x, y, z]}, "phases": [{"name": "climb", "goals": {"alpha": [x, y, z]}}, …],
     "space": {"fence": [[x, y], …], "floor_m": 0, "ceiling_m": 40, "boxes": [[[x, y, z], [x, y, z]], …],
               "standing": {"bravo": [x, y, z]}}, "certificate": {…}}

Seconds, metres of the world frame, radians. The certificate is what was shown when the file was made; it is never
believed: the plan is certified again before it is flown.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from skygcs.core.plan.file_reading import json_of, number_of, refused, require_pieces, require_vehicles, vehicle_name
from skygcs.core.plan.fleet_plan import MAX_PHASES, FlightSpace, Phase, PhasedPlan, Plan, TimedPlan
from skygcs.core.trajectory import Piece, Trajectory
from skygcs.core.trajectory.piecewise import MAX_DEGREE, MAX_DURATION_S, MAX_PIECES, MAX_TERM, Coefficients, Vector
from skygcs.errors import PlanFileError, TrajectoryError

FORMAT = "skygcs-plan"
VERSION = 1

MAX_CORNERS = 1000
MAX_BOXES = 1000


def is_plan_json(content: Any) -> bool:
    return isinstance(content, dict) and content.get("format") == FORMAT


def read_plan_json(source: str, data: bytes) -> tuple[Plan, FlightSpace]:
    """The plan and where it may be flown. Raises PlanFileError."""
    return plan_from_json(source, json_of(source, data))


def plan_from_json(source: str, content: Any) -> tuple[Plan, FlightSpace]:
    """`read_plan_json` of what was parsed already; ``source`` names it in errors."""
    if not is_plan_json(content):
        raise PlanFileError(source, "", f'not a plan of skygcs: "format" is not "{FORMAT}"')
    if content.get("version") != VERSION:
        raise PlanFileError(source, "version", f"{str(content.get('version'))[:20]}; only {VERSION} is known")
    kind = content.get("kind")
    if kind not in ("timed", "phased"):
        raise PlanFileError(source, "kind", "has to be timed or phased")
    plan: Plan = _timed(source, content) if kind == "timed" else _phased(source, content)
    space = space_of(source, content.get("space", {}))
    names = plan.trajectories if isinstance(plan, TimedPlan) else plan.starts
    if both := names.keys() & space.standing.keys():  # before a flight those that take part are left out of what stands
        raise PlanFileError(source, "space, standing", f"{min(both)} takes part in the plan")
    return plan, space


def write_plan_json(plan: Plan, space: FlightSpace, certificate: Mapping[str, Any] | None = None) -> str:
    """The text of the file."""
    return json.dumps(plan_content(plan, space, certificate)) + "\n"


def plan_content(plan: Plan, space: FlightSpace, certificate: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return what is in the file, before it is encoded."""
    content: dict[str, Any] = {"format": FORMAT, "version": VERSION}
    if isinstance(plan, TimedPlan):
        content["kind"] = "timed"
        content["vehicles"] = {
            name: [[p.duration_s, p.east, p.north, p.up, p.yaw] for p in trajectory.pieces]
            for name, trajectory in plan.trajectories.items()
        }
    else:
        content["kind"] = "phased"
        content["starts"] = dict(plan.starts)
        content["phases"] = [{"name": phase.name, "goals": dict(phase.goals)} for phase in plan.phases]
    content["space"] = space_content(space)
    if certificate is not None:
        content["certificate"] = certificate
    return content


def space_content(space: FlightSpace) -> dict[str, Any]:
    """Return what `space_of` reads."""
    return {
        "fence": space.fence,
        "floor_m": space.floor_m,
        "ceiling_m": space.ceiling_m,
        "boxes": space.boxes,
        "standing": dict(space.standing),
    }


def _timed(source: str, content: Mapping[str, Any]) -> TimedPlan:
    vehicles = _table(source, "vehicles", content.get("vehicles"))
    require_vehicles(source, len(vehicles))
    trajectories = {}
    count = 0
    for name, rows in vehicles.items():
        where = f"vehicle {name[:40]}"
        if not isinstance(rows, list) or not 1 <= len(rows) <= MAX_PIECES:
            raise PlanFileError(source, where, f"has 1 to {MAX_PIECES} pieces")
        count += len(rows)
        require_pieces(source, where, count)
        pieces = [_piece(source, f"{where}, piece {number}", row) for number, row in enumerate(rows, 1)]
        try:
            trajectories[vehicle_name(source, where, name)] = Trajectory(pieces)
        except TrajectoryError as error:
            raise refused(source, where, error) from None
    return TimedPlan(trajectories)


def _piece(source: str, where: str, row: Any) -> Piece:
    if not isinstance(row, list) or len(row) != 5:
        raise PlanFileError(source, where, "a piece is [duration_s, east, north, up, yaw or null]")
    axes = [_coefficients(source, f"{where}, {axis}", row[i]) for i, axis in enumerate(("east", "north", "up"), 1)]
    yaw = None if row[4] is None else _coefficients(source, f"{where}, yaw", row[4])
    duration = number_of(source, where, "duration_s", row[0], MAX_DURATION_S)
    return Piece(duration, axes[0], axes[1], axes[2], yaw)


def _coefficients(source: str, where: str, values: Any) -> Coefficients:
    if not isinstance(values, list) or not 1 <= len(values) <= MAX_DEGREE + 1:
        raise PlanFileError(source, where, f"has 1 to {MAX_DEGREE + 1} coefficients")
    return tuple(number_of(source, where, f"coefficient {k}", value, MAX_TERM) for k, value in enumerate(values))


def _phased(source: str, content: Mapping[str, Any]) -> PhasedPlan:
    starts = _places(source, "starts", content.get("starts"))
    require_vehicles(source, len(starts))
    phases = content.get("phases")
    if not isinstance(phases, list) or not 1 <= len(phases) <= MAX_PHASES:
        raise PlanFileError(source, "phases", f"has 1 to {MAX_PHASES} phases")
    found = []
    for number, phase in enumerate(phases, 1):
        where = f"phase {number}"
        given = _table(source, where, phase)
        name = given.get("name")
        if not isinstance(name, str) or not 1 <= len(name) <= 80:
            raise PlanFileError(source, where, "has no name")
        goals = _places(source, f"{where}, goals", given.get("goals"))
        if unknown := goals.keys() - starts.keys():
            raise PlanFileError(source, where, f"{min(unknown)[:40]} has no start")
        found.append(Phase(name, goals))
    return PhasedPlan(starts, tuple(found))


def space_of(source: str, given: Any) -> FlightSpace:
    """Where it may be flown, from the content of "space". Raises PlanFileError."""
    # keys
    space = _table(source, "space", given)
    known = {"fence", "floor_m", "ceiling_m", "boxes", "standing"}
    if unknown := space.keys() - known:  # an obstacle under another name must not be overlooked
        raise PlanFileError(source, "space", f"{min(unknown)[:40]!r} is unknown; there are {', '.join(sorted(known))}")
    corners = _list(source, "space, fence", space.get("fence"), MAX_CORNERS)
    if 0 < len(corners) < 3:
        raise PlanFileError(source, "space, fence", "a fence has three corners at least")
    # boxes
    boxes = []
    for number, box in enumerate(_list(source, "space, boxes", space.get("boxes"), MAX_BOXES), 1):
        where = f"space, box {number}"
        if not isinstance(box, list) or len(box) != 2:
            raise PlanFileError(source, where, "a box is [least corner, greatest corner]")
        least, greatest = (_vector(source, where, corner) for corner in box)
        if any(a > b for a, b in zip(least, greatest, strict=True)):
            raise PlanFileError(source, where, "the least corner is above the greatest")
        boxes.append((least, greatest))
    # fence, floor and ceiling
    fence = []
    for number, corner in enumerate(corners, 1):
        if not isinstance(corner, list) or len(corner) != 2:
            raise PlanFileError(source, f"space, fence corner {number}", "a corner is [x, y]")
        fence.append((_number(source, number, corner[0]), _number(source, number, corner[1])))
    heights = [
        None if space.get(key) is None else number_of(source, "space", key, space[key])
        for key in ("floor_m", "ceiling_m")
    ]
    return FlightSpace(
        tuple(fence),
        heights[0],
        heights[1],
        tuple(boxes),
        _places(source, "space, standing", space.get("standing", {})),
    )


def _number(source: str, number: int, value: Any) -> float:
    return number_of(source, f"space, fence corner {number}", "a coordinate", value)


def _places(source: str, where: str, given: Any) -> dict[str, Vector]:
    return {
        vehicle_name(source, where, name): _vector(source, f"{where}, {name[:40]}", place)
        for name, place in _table(source, where, given).items()
    }


def _vector(source: str, where: str, value: Any) -> Vector:
    if not isinstance(value, list) or len(value) != 3:
        raise PlanFileError(source, where, "a place is [x, y, z]")
    x, y, z = (number_of(source, where, axis, number) for axis, number in zip("xyz", value, strict=True))
    return x, y, z


def _table(source: str, where: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise PlanFileError(source, where, "has to be an object")
    return value


def _list(source: str, where: str, value: Any, most: int) -> list[Any]:
    if value is None:
        return []
    if not isinstance(value, list) or len(value) > most:
        raise PlanFileError(source, where, f"has to be a list of at most {most}")
    return value
