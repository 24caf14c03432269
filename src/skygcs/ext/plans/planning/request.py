"""Requests to a planning process, as JSON: a search, or a certificate for a plan. No numpy.

    {"do": "make", "starts": …, "goals": …, "exchangeable": …, "kind": …}     search
    {"do": "paths", "paths": {vehicle: {"points", "times_s", "yaws_rad"}}, "within_limits": …}   written paths
    {"do": "check", "plan": a plan of skygcs as JSON, "within_limits": …, "keep": …}     certify, in its own space, too

All with "rule" (margins), "limits" and "space", "limits_of" (each vehicle's own, in place of "limits") where they are
known, and "notes": keys that the answer has, too. The answer is one JSON
object:

    {"certificate": … or null, "plan": the certified plan or null, "attempts": […], "reasons": […], and "notes"}
    {"refused": why}
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from skygcs.core.plan.file_reading import json_of
from skygcs.core.plan.fleet_plan import FlightSpace, Plan
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.plan.plan_json import plan_content, space_content
from skygcs.core.trajectory import MotionLimits, Trajectory
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.trajectory.timing import TimedPoint, path_within, straight_lines
from skygcs.errors import TrajectoryError

Places = Mapping[str, Vector]

JsonObject = dict[str, Any]


@dataclass(frozen=True, slots=True)
class WrittenPath:
    """Points that a vehicle flies; as many times and yaws, or none. Without times it stops at corners."""

    points: Sequence[Vector]
    times_s: Sequence[float] = ()
    yaws_rad: Sequence[float] = ()


def make_request(
    starts: Places,
    goals: Places,
    rule: MarginRule,
    limits: MotionLimits,
    space: FlightSpace,
    *,
    exchangeable: bool = False,
    kind: str = "auto",
) -> JsonObject:
    """Search a plan; ``kind`` as `plan_search.Kind`."""
    return {
        "do": "make",
        "starts": dict(starts),
        "goals": dict(goals),
        "exchangeable": exchangeable,
        "kind": kind,
        **_common(rule, limits, space),
    }


def check_request(
    plan: Plan | Mapping[str, Any] | None,
    rule: MarginRule,
    limits: MotionLimits,
    space: FlightSpace,
    *,
    within_limits: bool = False,
    keep: bool = False,
) -> JsonObject:
    """Certify a plan, or the content of a file of one, or (None) the text that follows (`with_text`);
    ``within_limits``: its speeds and accelerations as well; ``keep``: the answer has the plan with its certificate."""
    return {
        "do": "check",
        "keep": keep,
        "plan": _content_of(plan),
        "within_limits": within_limits,
        **_common(rule, limits, space),
    }


def with_text(request: bytes, text: bytes) -> bytes:
    """A request in JSON, without line breaks, and the text of its plan: a large one is decoded in the process only."""
    return request + b"\n" + text


def without_text(request: bytes) -> JsonObject:
    """Return what `with_text` made, or a request without it, decoded. Raises PlanFileError for the text, ValueError."""
    head, _, text = request.partition(b"\n")
    found: JsonObject = json.loads(head)
    if text:
        found["plan"] = json_of("the plan", text)
    return found


def _content_of(plan: Plan | Mapping[str, Any] | None) -> JsonObject | None:
    if plan is None:
        return None
    return dict(plan) if isinstance(plan, Mapping) else plan_content(plan, FlightSpace())


def paths_request(
    paths: Mapping[str, WrittenPath],
    rule: MarginRule,
    limits: MotionLimits,
    space: FlightSpace,
    *,
    within_limits: bool = False,
) -> JsonObject:
    """Make trajectories of written paths, and certify them."""
    content = {name: asdict(path) for name, path in paths.items()}
    return {"do": "paths", "paths": content, "within_limits": within_limits, **_common(rule, limits, space)}


def path_of(name: str, content: Mapping[str, Any], limits: MotionLimits) -> Trajectory:
    """The trajectory of a written path. Raises TrajectoryError that names the vehicle."""
    path = WrittenPath(**content)
    points = [(x, y, z) for x, y, z in path.points]
    try:
        if path.times_s:
            yaws: Sequence[float | None] = path.yaws_rad or [None] * len(points)
            timed = [TimedPoint(*row) for row in zip(path.times_s, points, yaws, strict=True)]
            return straight_lines(timed)
        return path_within(points, limits, path.yaws_rad or None)
    except TrajectoryError as error:
        raise TrajectoryError(f"{name}: {error}") from None


def _common(rule: MarginRule, limits: MotionLimits, space: FlightSpace) -> JsonObject:
    return {"rule": asdict(rule), "limits": asdict(limits), "space": space_content(space)}


def rule_of(content: Mapping[str, Any]) -> MarginRule:
    """Read the rule that `_common` wrote."""
    return MarginRule(
        Uncertainty(**content["uncertainty"]),
        {name: Uncertainty(**given) for name, given in content["by_vehicle"].items()},
        content["downwash_ratio"],
        content["fixed_m"],
    )
