"""The fleet as markers of RViz in the frame "map": vehicles, trails, fences, plans (visualization_msgs). Pure.

    namespace    type            a marker for each
    ---------    ------------    --------------------------------------------------------------------
    vehicle      arrow           vehicle, along its yaw; green, grey if it is not heard, red in a failsafe
    name         text            vehicle: its name, height and mode
    trail        line strip      vehicle: where it was
    fence        line list       box of flight control, which several vehicles may share
    plan         line strip      path of a vehicle that is loaded or flown
    goal         sphere list     plan: the places of its step

What is not published any more is gone from the display after a lifetime. A marker takes 0.2 ms to encode, a point 20
us: vehicles are sent in turn, VEHICLES_AT_ONCE in a message, trails and paths LINE_POINTS at once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from skygcs.core.ros.fleet_messages import FRAME, text
from skygcs.core.ros.rotations import xyz
from skygcs.core.ros.stamps import header

ARROW, LINE_STRIP, LINE_LIST, SPHERE_LIST, TEXT = 0, 4, 5, 7, 9
"""visualization_msgs' Marker types."""

DELETE = 2
"""visualization_msgs' Marker action; 0 adds."""

LIFETIME_S = 5
LINE_LIFETIME_S = 60

VEHICLES_AT_ONCE = 50
"""250 vehicles have their turn within 2.5 s, twice a second."""

MOST_BOXES = 20

LINE_POINTS = 400
"""Points of trails and paths in one message: 8 ms of encoding. The most that there may be have their turn within 40 s,
twice a second."""

TRAIL_POINTS = 60
TRAIL_STEP_M = 1.0
"""A trail has a point for each of so many metres, the newest TRAIL_POINTS: 60 m at least."""

MOST_TRAILS = 250

JUMP_M = 100.0
"""A trail begins anew beyond: another origin of the fleet, or an estimator that was reset."""

MOST_PATHS = 250
MOST_PATH_POINTS = 60

Color = tuple[float, float, float, float]
GREEN, GREY, RED = (0.1, 0.8, 0.2, 1.0), (0.5, 0.5, 0.5, 0.8), (0.9, 0.1, 0.1, 1.0)
BLUE, AMBER, WHITE = (0.2, 0.5, 1.0, 0.8), (1.0, 0.7, 0.1, 0.8), (1.0, 1.0, 1.0, 1.0)

Vector = Sequence[float]
Fields = Mapping[str, Any]


class Trails:
    """Where vehicles were, by name; bounded in vehicles and points."""

    def __init__(self) -> None:
        self.points: dict[str, deque[Vector]] = {}
        self.left_out = 0
        """Positions of vehicles beyond MOST_TRAILS."""

    def add(self, name: str, place_m: Vector) -> None:
        """A position of a vehicle."""
        trail = self.points.get(name)
        if trail is None:
            if len(self.points) >= MOST_TRAILS:
                self.left_out += 1
                return
            trail = self.points[name] = deque(maxlen=TRAIL_POINTS)
        away_m = math.dist(trail[-1], place_m) if trail else math.inf
        if away_m > JUMP_M:
            trail.clear()
        if away_m >= TRAIL_STEP_M:
            trail.append(tuple(place_m))


class Line(NamedTuple):
    """A trail or a path, which is sent in its turn."""

    namespace: str
    number: int
    color: Color
    width_m: float
    points: Sequence[Vector]


class Turns:
    """Which vehicles and lines are sent with which message: each in its turn, so that a message stays small."""

    def __init__(self) -> None:
        self._next = 0
        self._next_vehicle = 0

    def vehicles(self, states: Sequence[Fields]) -> Sequence[Fields]:
        """The next vehicles."""
        if len(states) <= VEHICLES_AT_ONCE:
            return states
        begin = self._next_vehicle % len(states)
        self._next_vehicle = begin + VEHICLES_AT_ONCE
        return [*states[begin:], *states[:begin]][:VEHICLES_AT_ONCE]

    def lines(self, lines: Sequence[Line], now_ns: int) -> list[dict[str, Any]]:
        """The next lines, of LINE_POINTS in all or one that has more."""
        made: list[dict[str, Any]] = []
        left = LINE_POINTS
        for turn in range(len(lines)):
            line = lines[(self._next + turn) % len(lines)]
            if made and len(line.points) > left:
                break
            left -= len(line.points)
            marker = _marker(line.namespace, line.number, LINE_STRIP, line.color, now_ns, (line.width_m, 0.0, 0.0))
            points = [xyz(point) for point in line.points]
            made.append(marker | {"points": points, "lifetime": {"sec": LINE_LIFETIME_S}})
        self._next = (self._next + len(made)) % max(len(lines), 1)
        return made


def place_of(state: Fields) -> list[float] | None:
    """A vehicle's place in the frame map; None: not known."""
    place = (state.get("position") or {}).get("enu_m")
    return place if isinstance(place, list) and len(place) == 3 and None not in place else None


def vehicle_markers(states: Iterable[Fields], now_ns: int) -> list[dict[str, Any]]:
    """Arrow and name of each vehicle whose place is known."""
    made = []
    for state in states:
        place = place_of(state)
        if place is None:
            continue
        color, sysid = _color(state), state["sysid"]
        yaw = math.radians((state.get("position") or {}).get("yaw_world_deg") or 0.0) / 2
        arrow = _marker("vehicle", sysid, ARROW, color, now_ns, (1.0, 0.3, 0.3))
        arrow["pose"] = {"position": xyz(place), "orientation": {"z": math.sin(yaw), "w": math.cos(yaw)}}
        name = _marker("name", sysid, TEXT, WHITE, now_ns, (0.0, 0.0, 0.6))
        name["pose"]["position"] = xyz((place[0], place[1], place[2] + 1.0))
        name["text"] = text(f"{state['name']}  {place[2]:.1f} m  {state.get('mode') or ''}".rstrip())
        made += [arrow, name]
    return made


def trail_lines(states: Iterable[Fields], trails: Trails) -> list[Line]:
    """The trail of each vehicle that has one."""
    known = [(state, trails.points.get(state["name"], ())) for state in states]
    return [
        Line("trail", state["sysid"], (*_color(state)[:3], 0.5), 0.08, list(points))
        for state, points in known
        if len(points) > 1
    ]


def fence_markers(fences: Iterable[Fields], now_ns: int) -> list[dict[str, Any]]:
    """The box of each fence: x_m, y_m, up_m, each a span of metres. Equal ones are drawn once."""
    boxes = dict.fromkeys(tuple(tuple(fence[axis]) for axis in ("x_m", "y_m", "up_m")) for fence in fences)
    made = []
    for number, (x, y, up) in enumerate(list(boxes)[:MOST_BOXES]):
        box = _marker("fence", number, LINE_LIST, AMBER, now_ns, (0.1, 0.0, 0.0))
        made.append(box | {"points": [xyz(corner) for corner in _edges(x, y, up)]})
    return made


def path_lines(paths: Iterable[Fields]) -> list[Line]:
    """The paths of trajectory.paths, each with MOST_PATH_POINTS at most."""
    made = []
    for number, path in enumerate(list(paths)[:MOST_PATHS]):
        points = [point for point in path.get("points_enu_m") or () if len(point) == 3 and None not in point]
        points = points[:: max(math.ceil(len(points) / MOST_PATH_POINTS), 1)]
        if len(points) > 1:
            made.append(Line("plan", number, BLUE, 0.1, points))
    return made


def deleted(lines: Iterable[Line], now_ns: int) -> list[dict[str, Any]]:
    """Markers that take lines from the display."""
    made = (_marker(line.namespace, line.number, LINE_STRIP, line.color, now_ns, (0.1, 0.0, 0.0)) for line in lines)
    return [marker | {"action": DELETE} for marker in made]


def goal_markers(status: Fields, now_ns: int) -> list[dict[str, Any]]:
    """The goals of plan.status."""
    goals = [row.get("goal_enu_m") or () for row in (status.get("vehicles") or ())[:MOST_PATHS]]
    points = [xyz(goal) for goal in goals if len(goal) == 3 and None not in goal]
    return [_marker("goal", 0, SPHERE_LIST, BLUE, now_ns, (0.5, 0.5, 0.5)) | {"points": points}] if points else []


def _color(state: Fields) -> Color:
    return GREY if not state.get("connected") else RED if state.get("failsafe") else GREEN


def _marker(
    namespace: str, number: int, kind: int, color: Color, now_ns: int, scale: tuple[float, float, float]
) -> dict[str, Any]:
    return {
        "header": header(now_ns, FRAME),
        "ns": namespace,
        "id": number,
        "type": kind,
        "pose": {"orientation": {"w": 1.0}},
        "scale": xyz(scale),
        "color": dict(zip("rgba", color, strict=True)),
        "lifetime": {"sec": LIFETIME_S},
    }


def _edges(x: Vector, y: Vector, up: Vector) -> Iterable[Vector]:
    """The twelve edges of a box, two corners each."""
    for a in (0, 1):
        for b in (0, 1):
            yield from ((x[0], y[a], up[b]), (x[1], y[a], up[b]))
            yield from ((x[a], y[0], up[b]), (x[a], y[1], up[b]))
            yield from ((x[a], y[b], up[0]), (x[a], y[b], up[1]))
