"""docs/reference/simulated-firmware.md: the table of `skygcs.sim.behaviours` as a page. Run this module to write it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from skygcs.sim.behaviours import COPTER, PX4, Fact, MissionRules, Reactions
from skygcs.sim.firmware_modes import CopterMode, ModeRule, Px4Mode

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "simulated-firmware.md"

INTRODUCTION = """# What the simulated firmwares do

Every value that the simulated vehicles take from a firmware, with the place in its source that it was read from
(`skygcs.sim.behaviours`; this page is made from it). "measured": flown with that firmware's own simulator. A value in
brackets is what the simulator does instead. `tests/unit/sim/test_behaviours.py` flies the simulator against this table,
`make test-firmware` flies real firmware against it.

"""


def words(value: Any) -> str:
    if isinstance(value, Reactions):
        if not value.param:
            return "nothing"
        parts = [f"{number} {reaction.value}" for number, reaction in value.by_value.items()]
        return f"{value.param}: " + ", ".join([*parts, f"else {value.otherwise.value}"])
    if isinstance(value, MissionRules):
        kept = f"{value.missions} items, {value.fence} corners, {value.rally} rally points"
        return f"asks again after {value.retry_s:g} s, gives up after {value.give_up_s:g} s; {kept}"
    if is_dataclass(value) and not isinstance(value, type):
        return ", ".join(f"{name} {words(part)}" for name, part in asdict(value).items())
    if isinstance(value, Mapping) and value and all(isinstance(rule, ModeRule) for rule in value.values()):
        return "see below"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {words(part)}" for name, part in value.items())
    if isinstance(value, tuple):
        return ", ".join(words(part) for part in value)
    if isinstance(value, Enum):
        return str(value.value)
    return f"{value:g}" if isinstance(value, float) else str(value) if value not in (None, "") else "-"


def in_words(name: str) -> str:
    """A field of the table: ready_after_s is "ready after (s)"."""
    return re.sub(r"_(s|m)$", r" (\1)", name).replace("_", " ")


def cell(fact: Fact[Any]) -> str:
    text = words(fact.value)
    return text if fact.used is None else f"{text} ({words(fact.used)}: {fact.why})"


def modes(of: Fact[dict[int, ModeRule]], names: type[CopterMode] | type[Px4Mode]) -> list[str]:
    lines = ["| mode | armed in | needs | by DO_SET_MODE |", "| --- | --- | --- | --- |"]
    for number, rule in of.value.items():
        needs = [name for name, needed in (("position", rule.position), ("sticks", rule.sticks)) if needed]
        entered = "yes" if rule.by_command else "no"
        arms = "yes" if rule.arms else "no"
        lines.append(f"| {names(number).name} | {arms} | {', '.join(needs) or '-'} | {entered} |")
    return lines


def table() -> str:
    lines: list[str] = []
    for firmware in (PX4, COPTER):
        lines += [f"## {firmware.name} {firmware.version}", "", "| behaviour | value | source |", "| --- | --- | --- |"]
        for field in fields(firmware):
            fact = getattr(firmware, field.name)
            if isinstance(fact, Fact):
                lines.append(f"| {in_words(field.name)} | {cell(fact)} | {fact.source} |")
        lines += ["", *modes(firmware.modes, Px4Mode if firmware is PX4 else CopterMode), ""]
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(INTRODUCTION + table(), encoding="utf-8")
