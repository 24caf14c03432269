"""The fleet as markers of RViz in the frame "map": vehicles, trails, fences, plans (visualization_msgs). Pure.

    namespace    type            a marker for each
    ---------    ------------    --------------------------------------------------------------------
    vehicle      arrow           vehicle, along its yaw; green, grey if it is not heard, red in a failsafe
    name         text            vehicle: its name, height and mode
    trail        line strip      vehicle: where it was
    fence        line list       box of flight control, which several vehicles may share
    plan         line strip      path of a vehicle that is loaded or flown
    goal         sphere          vehicle in a plan: the place of its step

Every marker lives for LIFETIME_S: what is not published any more is gone from the display then.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from skygcs.core.ros.fleet_messages import FRAME, text
from skygcs.core.ros.rotations import xyz
from skygcs.core.ros.stamps import header

ARROW, SPHERE, LINE_STRIP, LINE_LIST, TEXT = 0, 2, 4, 5, 9
"""visualization_msgs' Marker types."""

LIFETIME_S = 3

TRAIL_POINTS = 300
TRAIL_STEP_M = 0.5
"""A trail has a point for each of so many metres, the newest TRAIL_POINTS: 150 m at least."""

MOST_TRAILS = 250

JUMP_M = 100.0
"""A trail begins anew beyond: another origin of the fleet, or an estimator that was reset."""

MOST_PATHS = 250
MOST_PATH_POINTS = 500

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


def place_of(state: Fields) -> list[float] | None:
    """A vehicle's place in the frame map; None: not known."""
    place = (state.get("position") or {}).get("enu_m")
    return place if isinstance(place, list) and len(place) == 3 and None not in place else None


def vehicle_markers(states: Iterable[Fields], trails: Trails, now_ns: int) -> list[dict[str, Any]]:
    """Arrow, name and trail of each vehicle whose place is known."""
    made = []
    for state in states:
        place = place_of(state)
        if place is None:
            continue
        connected, sysid = bool(state.get("connected")), state["sysid"]
        color = GREY if not connected else RED if state.get("failsafe") else GREEN
        yaw = math.radians((state.get("position") or {}).get("yaw_world_deg") or 0.0) / 2
        arrow = _marker("vehicle", sysid, ARROW, color, now_ns, (1.0, 0.3, 0.3))
        arrow["pose"] = {"position": xyz(place), "orientation": {"z": math.sin(yaw), "w": math.cos(yaw)}}
        name = _marker("name", sysid, TEXT, WHITE, now_ns, (0.0, 0.0, 0.6))
        name["pose"]["position"] = xyz((place[0], place[1], place[2] + 1.0))
        name["text"] = text(f"{state['name']}  {place[2]:.1f} m  {state.get('mode') or ''}".rstrip())
        made += [arrow, name]
        trail = list(trails.points.get(state["name"], ()))
        if len(trail) > 1:
            line = _marker("trail", sysid, LINE_STRIP, (*color[:3], 0.5), now_ns, (0.08, 0.0, 0.0))
            made.append(line | {"points": [xyz(point) for point in trail]})
    return made


def fence_markers(fences: Iterable[Fields], now_ns: int) -> list[dict[str, Any]]:
    """The box of each fence: x_m, y_m, up_m, each a span of metres. Equal ones are drawn once."""
    boxes = dict.fromkeys(tuple(tuple(fence[axis]) for axis in ("x_m", "y_m", "up_m")) for fence in fences)
    made = []
    for number, (x, y, up) in enumerate(list(boxes)[:MOST_TRAILS]):
        box = _marker("fence", number, LINE_LIST, AMBER, now_ns, (0.1, 0.0, 0.0))
        made.append(box | {"points": [xyz(corner) for corner in _edges(x, y, up)]})
    return made


def plan_markers(paths: Iterable[Fields], status: Fields, now_ns: int) -> list[dict[str, Any]]:
    """Paths of trajectory.paths, and the goals of plan.status."""
    made = []
    for number, path in enumerate(list(paths)[:MOST_PATHS]):
        points = [point for point in path.get("points_enu_m") or () if len(point) == 3 and None not in point]
        points = points[:: max(math.ceil(len(points) / MOST_PATH_POINTS), 1)]
        if len(points) > 1:
            line = _marker("plan", number, LINE_STRIP, BLUE, now_ns, (0.1, 0.0, 0.0))
            made.append(line | {"points": [xyz(point) for point in points]})
    for number, row in enumerate((status.get("vehicles") or ())[:MOST_PATHS]):
        goal = row.get("goal_enu_m")
        if goal is not None and len(goal) == 3 and None not in goal:
            ball = _marker("goal", number, SPHERE, BLUE, now_ns, (0.5, 0.5, 0.5))
            ball["pose"]["position"] = xyz(goal)
            made.append(ball)
    return made


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
