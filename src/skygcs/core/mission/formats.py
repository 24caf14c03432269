"""Selects the format of a plan file: by its content when read, by its name when written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from skygcs.core.mission.item import MissionType
from skygcs.core.mission.plan import MissionPlan
from skygcs.core.mission.qgc import read_qgc, write_qgc
from skygcs.core.mission.wpl import HEADER, read_wpl, write_wpl
from skygcs.errors import PlanFileError

MAX_FILE_BYTES = 32 * 2**20
"""A .plan with 65535 items has 25 MB with QGroundControl's indentation."""

Format = Literal["plan", "wpl"]

SUFFIXES: dict[str, Format] = {".plan": "plan", ".waypoints": "wpl", ".txt": "wpl", ".mission": "wpl"}


@dataclass(frozen=True, slots=True)
class Imported:
    """A plan as read; ``notes``: what was converted."""

    plan: MissionPlan
    format: Format
    notes: tuple[str, ...] = ()


def read_plan(content: bytes, source: str) -> Imported:
    """Raises PlanFileError naming ``source`` and the line or item."""
    if len(content) > MAX_FILE_BYTES:
        raise PlanFileError(source, "", f"is larger than {MAX_FILE_BYTES >> 20} MiB, the most a plan can be")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise PlanFileError(source, f"line {line}", "is not UTF-8 text") from None
    start = text.lstrip()
    if start.startswith(HEADER):
        return Imported(read_wpl(start, source), "wpl")
    if start.startswith("{"):
        plan, notes = read_qgc(text, source)
        return Imported(plan, "plan", notes)
    wanted = f'a QGroundControl plan (JSON) nor "{HEADER} 110"'
    raise PlanFileError(source, "line 1", f"is neither {wanted}" if start else "the file is empty")


def format_of(name: str) -> Format:
    """The format of a file with that name. Raises PlanFileError."""
    for suffix, kind in SUFFIXES.items():
        if name.lower().endswith(suffix):
            return kind
    raise PlanFileError(name, "", f"must end in {', '.join(SUFFIXES)}, which selects its format")


def write_plan(plan: MissionPlan, name: str, only: MissionType | None = None) -> str:
    """The text of a plan file with that name; with ``only`` of that list.

    Raises PlanFileError for a plan that the format cannot hold, with what to do.
    """
    if only is not None:
        plan = MissionPlan(home=plan.home, settings=plan.settings).with_items(only, plan.items(only))
    if format_of(name) == "plan":
        try:
            return write_qgc(plan)
        except ValueError as error:
            raise PlanFileError(name, "", str(error)) from None
    kinds = plan.holds() or (only or MissionType.MISSION,)
    if len(kinds) > 1:
        words = " and ".join(kind.word for kind in kinds)
        raise PlanFileError(name, "", f"the plan holds {words}, and a WPL file one of them: choose with --only")
    return write_wpl(plan, kinds[0])
