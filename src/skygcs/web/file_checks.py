"""Checks of files that a person drops on the page; each runs in a process of its own with limits of size and time.

`CHECKS` maps the method of the WebSocket to its function: parameters as they came (not trusted) to a JSON-able answer.
Each raises SkygcsError, with a text for the person, and nothing else. Those of extensions are entry points of the group
`EXTENSION_CHECKS`, with the name of the method.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from skygcs.config.extension_tables import installed_points
from skygcs.core.mavlink.param_encoding import Param, ParamType
from skygcs.core.params.compare import ParamChange, plan
from skygcs.core.params.names import SORTS, Sort
from skygcs.core.params.param_file import ParamFile, parse
from skygcs.errors import RefusedError
from skygcs.web.dropped import CheckRequest, DroppedFile, parsed

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

MAX_PARAMS = 5000
"""More than any autopilot has."""

EXTENSION_CHECKS = "skygcs.page_checks"
_CHECK_NAME = re.compile(r"web\.[a-z_]+\.check")

Check = Callable[[Mapping[str, Any]], dict[str, Any]]


class HeldParam(CheckRequest):
    """A parameter as params.list returns it."""

    name: Annotated[str, Field(min_length=1, max_length=16)]
    value: float | None
    type: str


class ParamsCheck(CheckRequest):
    """A parameter file, and the parameters of the vehicle to which it is compared."""

    file: DroppedFile
    params: Annotated[list[HeldParam], Field(min_length=1, max_length=MAX_PARAMS)]
    sysid: Annotated[int, Field(ge=1, le=255)]
    compid: Annotated[int, Field(ge=0, le=255)] = 1
    autopilot: Annotated[str, Field(max_length=32)]
    include: tuple[Literal["settings", "calibration", "statistics", "identity"], ...] = Field(
        ("settings",), strict=False
    )


def check_mission(params: Mapping[str, Any]) -> dict[str, Any]:
    """web.mission.check. Each check runs in a process that has just begun: it imports what it needs, and no more."""
    from skygcs.web import mission_checks

    return mission_checks.check_mission(params)


def check_fence(params: Mapping[str, Any]) -> dict[str, Any]:
    """web.fence.check."""
    from skygcs.web import mission_checks

    return mission_checks.check_fence(params)


def check_params(params: Mapping[str, Any]) -> dict[str, Any]:
    """web.params.check: what applying the file to the vehicle would change. Nothing is set."""
    asked = parsed(ParamsCheck, params)
    try:
        text = asked.file.content().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise RefusedError(f"{asked.file.name}: is not UTF-8 text, so it is not a parameter file") from None
    file: ParamFile = parse(text, asked.file.name)
    include: tuple[Sort, ...] = tuple(sort for sort in SORTS if sort in asked.include)
    found = plan(file, _held(asked), sysid=asked.sysid, compid=asked.compid, stack=asked.autopilot, include=include)
    return {
        "name": asked.file.name,
        "entries": len(file.entries),
        "same": found.same,
        "changes": [_change(change) for change in found.changes],
        "skipped": [[name, why] for name, why in found.skipped],
        "unknown": list(found.unknown),
        "problems": list(found.problems),
        "warnings": list(found.warnings),
        "rounding": found.rounding,
    }


def _held(asked: ParamsCheck) -> dict[str, Param]:
    held = {}
    for index, entry in enumerate(asked.params):
        kind = ParamType.__members__.get(entry.type)
        if kind is None:
            raise RefusedError(f"params.{index}: {entry.type[:20]!r} is not a type of parameter")
        whole = entry.value is not None and kind.integer and entry.value.is_integer()
        value = math.nan if entry.value is None else int(entry.value) if whole else entry.value
        held[entry.name] = Param(entry.name, value, kind)
    return held


def _change(change: ParamChange) -> dict[str, Any]:
    before = change.before
    if before is not None and not math.isfinite(before):
        before = None
    return {"name": change.name, "value": change.value, "before": before, "sort": change.sort}


CHECKS: dict[str, Check] = {
    "web.mission.check": check_mission,
    "web.fence.check": check_fence,
    "web.params.check": check_params,
}
"""Those of the core."""


@functools.cache
def extension_checks() -> Mapping[str, EntryPoint]:
    """The checks of installed extensions, by the method that they answer: `web.<word>.check`, and none of the core's.
    What is called otherwise is left out: it would take the place of a method of the page."""
    points = installed_points(EXTENSION_CHECKS).points
    return {name: point for name, point in points.items() if _CHECK_NAME.fullmatch(name) and name not in CHECKS}


def find_check(name: str) -> Check:
    """The check of this method; an extension's is imported. Raises KeyError."""
    if name in CHECKS:
        return CHECKS[name]
    check: Check = extension_checks()[name].load()
    return check
