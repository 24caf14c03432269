"""Plan files as text: QGC WPL 110, and the choice among the formats (QGroundControl's JSON is `qgc`): by a file's
content when read, by its name when written.

QGC WPL 110: the text files of Mission Planner, MAVProxy and old QGroundControls (.waypoints, .txt, .mission).

A header line, then one item per line: seq, current, frame, command, param1 to param4, x, y, z, autocontinue, separated
by blanks; lines that begin with # are comments. Line 0 is home by convention (a waypoint in frame 0); some programs
begin with a real item. DO_JUMP names the seq of its target. Mission Planner writes fences and rally points in the same
form, each into its own file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.fence import fence_from_items
from skygcs.core.mission.item import FENCE_COMMANDS, GLOBAL, MAX_ITEMS, MissionItem, MissionType
from skygcs.core.mission.plan import MissionPlan, PlannedHome, shifted_jumps
from skygcs.core.mission.qgc import read_qgc, write_qgc
from skygcs.errors import PlanFileError

# --- QGC WPL ----------------------------------------------------------------------------------------------------------

HEADER = "QGC WPL"
VERSION = "110"
COLUMNS = 12
COMMENT = "#"


@dataclass(frozen=True, slots=True)
class _Line:
    number: int
    seq: int
    item: MissionItem
    seven: tuple[float | None, ...]


def read_wpl(text: str, source: str) -> tuple[MissionPlan, tuple[str, ...]]:
    """(plan, notes for the user). Raises PlanFileError with the line."""
    lines = text.splitlines()
    header = lines[0].split() if lines else []
    if header[:2] != HEADER.split():
        raise PlanFileError(source, "line 1", f'must be "{HEADER} {VERSION}"')
    if header[2:] != [VERSION]:
        found = " ".join(header[2:]) or "none"
        raise PlanFileError(source, "line 1", f"version {found} of the format is not supported, only {VERSION} is")
    rows = ((number, line.strip()) for number, line in enumerate(lines[1:], 2))
    parsed = [_line(row, number, source) for number, row in rows if row and not row.startswith(COMMENT)]
    if len(parsed) > MAX_ITEMS:
        raise PlanFileError(source, "", f"{len(parsed)} items; MAVLink can number {MAX_ITEMS}")
    _check_numbers(parsed, source)
    home = None
    first_is_home = bool(parsed) and _is_home(parsed[0])
    if first_is_home:
        home = _home(parsed[0], source)
    plan = _plan(parsed[first_is_home:], home, source, jumps=0 if first_is_home else 1)
    return plan, () if first_is_home or not plan.mission else _perhaps_home(parsed[0])


def write_wpl(plan: MissionPlan, kind: MissionType) -> str:
    """One list of the plan, after home (zeros without a home: every reader takes the first line for home)."""
    home = plan.home or PlannedHome(0.0, 0.0, 0.0)
    place = (home.lat_deg, home.lon_deg, home.alt_amsl_m)
    rows = [_row(0, 1, GLOBAL, mav_cmd.NAV_WAYPOINT, (0.0, 0.0, 0.0, 0.0, *place), True)]
    for seq, item in enumerate(plan.items(kind), 1):
        rows.append(_row(seq, 0, item.frame, item.command, item.seven, item.autocontinue))
    return "\n".join([f"{HEADER} {VERSION}", *rows]) + "\n"


def _line(text: str, number: int, source: str) -> _Line:
    where = f"line {number}"
    fields = text.split()
    if len(fields) != COLUMNS:
        raise PlanFileError(source, where, f"{len(fields)} columns, not {COLUMNS}: is the line cut?")
    try:
        seq, _, frame, command = (_whole(field) for field in fields[:4])
        seven = tuple(float(field) for field in fields[4:11])
        item = MissionItem.from_params(command, frame, seven, _whole(fields[11]) != 0)
    except ValueError as error:
        raise PlanFileError(source, where, str(error)) from None
    return _Line(number, seq, item, seven)


def _whole(field: str) -> int:
    try:
        return int(field)
    except ValueError:
        pass
    value = float(field)
    if not value.is_integer():
        raise ValueError(f"{field} is not a whole number")
    return int(value)


def _check_numbers(lines: list[_Line], source: str) -> None:
    for expected, line in enumerate(lines):
        if line.seq > expected:
            raise PlanFileError(source, f"line {line.number}", f"item {expected} is missing: this is item {line.seq}")
        if line.seq < expected:
            raise PlanFileError(source, f"line {line.number}", f"item {line.seq} is repeated or out of order")


def _is_home(line: _Line) -> bool:
    return line.item.command == mav_cmd.NAV_WAYPOINT and line.item.frame == GLOBAL


def _perhaps_home(line: _Line) -> tuple[str, ...]:
    """Note about a first line that another program would take for home: ArduPilot's own missions have such lines too,
    with home's height above the sea in a frame of heights above home."""
    if line.item.command != mav_cmd.NAV_WAYPOINT:
        return ()
    kept = f"line {line.number} is flown to: a waypoint in frame {line.item.frame} is not taken for home"
    return (f"{kept}. Mission Planner and MAVProxy keep home in this line; if it is home, give it frame {GLOBAL}",)


def _home(line: _Line, source: str) -> PlannedHome | None:
    lat, lon, alt = line.seven[4:]
    if not lat and not lon:
        return None
    if lat != lat or lon != lon or alt != alt or lat is None or lon is None or alt is None:
        raise PlanFileError(source, f"line {line.number}", "home's position is not a number")
    return PlannedHome(lat, lon, alt)


def _plan(lines: list[_Line], home: PlannedHome | None, source: str, jumps: int) -> MissionPlan:
    items = tuple(line.item for line in lines)
    special = [
        line for line in lines if line.item.command in FENCE_COMMANDS or line.item.command == mav_cmd.NAV_RALLY_POINT
    ]
    if not special:
        return MissionPlan(mission=shifted_jumps(items, jumps), home=home)
    stranger = next((line for line in lines if line not in special), None)
    if stranger is not None:
        what = "fence" if special[0].item.command in FENCE_COMMANDS else "rally"
        reason = f"command {stranger.item.command} among {what} items: one file holds one kind"
        raise PlanFileError(source, f"line {stranger.number}", reason)
    if all(line.item.command == mav_cmd.NAV_RALLY_POINT for line in lines):
        return MissionPlan(rally=items, home=home)
    try:
        return MissionPlan(fence=fence_from_items(items, first=lines[0].seq), home=home)
    except ValueError as error:
        raise PlanFileError(source, "", str(error)) from None


def _row(seq: int, current: int, frame: int, command: int, seven: tuple[float | None, ...], autocontinue: bool) -> str:
    numbers = ["nan" if value is None else _number(value) for value in seven]
    return "\t".join([str(seq), str(current), str(frame), str(command), *numbers, str(int(autocontinue))])


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)


# --- all formats ------------------------------------------------------------------------------------------------------


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
        plan, notes = read_wpl(start, source)
        return Imported(plan, "wpl", notes)
    if start.startswith("{"):
        plan, notes = read_qgc(text, source)
        return Imported(plan, "plan", notes)
    wanted = f'a QGroundControl plan (JSON) nor "{HEADER} 110": save it as one of these in the program that wrote it'
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
