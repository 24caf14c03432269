"""What `skygcs-cli mission check` and `mission convert` do. Needs no daemon."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from skygcs.cli.connection import Exit
from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mission.check import CheckLimits, Finding, check_plan, errors
from skygcs.core.mission.firmware_items import Change, Family, for_firmware, grouped
from skygcs.core.mission.formats import Imported, read_plan, write_plan
from skygcs.core.mission.item import MissionItem, MissionType
from skygcs.errors import PlanFileError


def load_plan(file: Path) -> Imported:
    """Raises PlanFileError, also for a file that cannot be read."""
    try:
        content = file.read_bytes()
    except OSError as error:
        raise PlanFileError(str(file), "", f"cannot be read: {error.strerror}") from None
    return read_plan(content, str(file))


def check_file(
    file: Path,
    limits: CheckLimits,
    family: Family | None,
    vehicle: tuple[float, float] | None,
    dialect_name: str | None,
    json_output: bool,
) -> int:
    """Prints the report; FAILED if there is an error in it. Raises DialectError, and PlanFileError unless the report
    is JSON, which then has it as its one finding."""
    try:
        imported = load_plan(file)
    except PlanFileError as error:
        if not json_output:
            raise
        print(json.dumps(_unreadable(file, error), indent=2))
        return Exit.FAILED
    dialect = load_dialect(dialect_name or FleetConfig().dialect)
    findings = check_plan(imported.plan, dialect, limits, family=family, vehicle=vehicle)
    changes = for_firmware(imported.plan.mission, family, dialect.enums.get("MAV_CMD", {})).changes
    if json_output:
        print(json.dumps(_report(file, imported, findings, changes, dialect), indent=2))
    else:
        print(_text(file, imported, findings, changes))
    return Exit.FAILED if errors(findings) else Exit.DONE


def convert_file(file: Path, out: Path, only: str | None, force: bool, family: Family | None = None) -> int:
    """``family``: the mission is written as this firmware takes it. Raises PlanFileError, DialectError, OSError."""
    imported = load_plan(file)
    changes: tuple[Change, ...] = ()
    if family is not None:
        dialect = load_dialect(FleetConfig().dialect)
        converted = for_firmware(imported.plan.mission, family, dialect.enums.get("MAV_CMD", {}))
        imported, changes = replace(imported, plan=replace(imported.plan, mission=converted.items)), converted.changes
    text = write_plan(imported.plan, str(out), None if only is None else MissionType[only.upper()])
    try:
        with open(out, "w" if force else "x", encoding="utf-8") as target:
            target.write(text)
    except FileExistsError:
        raise PlanFileError(str(out), "", "exists; --force overwrites it") from None
    for note in imported.notes:
        print(f"note: {note}", file=sys.stderr)
    for line in grouped(changes):
        print(f"changed: mission {line}", file=sys.stderr)
    print(f"{out}: {_counts(read_plan(text.encode(), str(out)))}")
    return Exit.DONE


def _report(
    file: Path, imported: Imported, findings: tuple[Finding, ...], changes: tuple[Change, ...], dialect: Dialect
) -> dict[str, Any]:
    plan = imported.plan
    home = plan.home
    return {
        "file": os.fspath(file),
        "ok": not errors(findings),
        "format": imported.format,
        "home": None
        if home is None
        else {"lat_deg": home.lat_deg, "lon_deg": home.lon_deg, "alt_amsl_m": home.alt_amsl_m},
        **{kind.word: [_item(n, i, dialect) for n, i in enumerate(plan.items(kind), 1)] for kind in MissionType},
        "notes": list(imported.notes),
        "changes": [{"item": change.item, "text": change.text} for change in changes],
        "findings": [
            {"severity": "error" if f.error else "warning", "list": f.kind.word, "item": f.item, "text": f.text}
            for f in findings
        ],
    }


def _unreadable(file: Path, error: PlanFileError) -> dict[str, Any]:
    """`_report` of a file that is no plan."""
    return {
        "file": os.fspath(file),
        "ok": False,
        "format": None,
        "home": None,
        **{kind.word: [] for kind in MissionType},
        "notes": [],
        "changes": [],
        "findings": [{"severity": "error", "list": None, "item": None, "text": str(error)}],
    }


def _item(number: int, item: MissionItem, dialect: Dialect) -> dict[str, Any]:
    return {
        "number": number,
        "command": item.command,
        "name": dialect.enums.get("MAV_CMD", {}).get(item.command),
        "frame": item.frame,
        "params": list(item.seven),
        "autocontinue": item.autocontinue,
    }


def _text(file: Path, imported: Imported, findings: tuple[Finding, ...], changes: tuple[Change, ...]) -> str:
    lines = [f"{file}: {_counts(imported)}"]
    lines += [f"  note     {note}" for note in imported.notes]
    lines += [f"  changed  mission {line}" for line in grouped(changes)]
    lines += [f"  {'ERROR  ' if finding.error else 'warning'}  {finding}" for finding in findings]
    wrong = len(errors(findings))
    mild = len(findings) - wrong
    lines.append(f"{_many(wrong, 'error')}, {_many(mild, 'warning')}" if findings else "no problem found")
    return "\n".join(lines)


def _counts(imported: Imported) -> str:
    plan = imported.plan
    parts = [_many(len(plan.mission), "mission item")]
    if plan.fence:
        shapes = [_many(len(plan.fence.polygons), "polygon"), _many(len(plan.fence.circles), "circle")]
        parts.append(f"a fence of {' and '.join(shape for shape in shapes if not shape.startswith('0'))}")
    if plan.rally:
        parts.append(_many(len(plan.rally), "rally point"))
    if plan.home is not None:
        parts.append(f"home at {plan.home.lat_deg:.7g}, {plan.home.lon_deg:.7g}")
    return ", ".join(parts)


def _many(count: int, word: str) -> str:
    return f"{count} {word}" + ("" if count == 1 else "s")
