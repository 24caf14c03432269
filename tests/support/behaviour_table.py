"""docs/reference/simulated-firmware.md: `skygcs.sim.behaviours` as a page. Run this module to write it."""

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

Values that the simulated vehicles take from a firmware: PX4 1.16.1 / ArduCopter 4.6.3, or below
each other; one value if both have it; "-" for none. A value in brackets is what the simulator does instead.
`skygcs.sim.behaviours`, of which this page is made, names the place in the firmware's source, and what was measured.
`tests/unit/sim/test_behaviours.py` flies the simulator against this list, `make test-firmware` real firmware.

"""


LONGEST = 120
"""Characters of both values in one line."""

BY_THE_MODULE_ALONE = {
    *("modes", "answers", "climb_accel", "brake", "crash", "control_gains", "home_follows"),
    *("times", "circle_rms_m", "attitude_targets"),
}
"""Fields whose numbers say nothing without their docstrings, or are on another page; modes have lists of their own."""


def words(value: Any) -> str:
    if isinstance(value, Reactions):
        if not value.param:
            return "nothing"
        numbers: dict[str, list[str]] = {}
        for number, reaction in value.by_value.items():
            numbers.setdefault(reaction.value, []).append(str(number))
        parts = [f"{','.join(same)} {reaction}" for reaction, same in numbers.items()]
        if not parts:
            return f"{value.param}, any value: {value.otherwise.value}"
        return f"{value.param} = " + "; ".join([*parts, f"else {value.otherwise.value}"])
    if isinstance(value, MissionRules):
        kept = f"{value.missions} items, {value.fence} corners, {value.rally} rally points"
        return f"asks again after {value.retry_s:g} s, gives up after {value.give_up_s:g} s; {kept}"
    if is_dataclass(value) and not isinstance(value, type):
        return ", ".join(f"{name} {words(part)}" for name, part in asdict(value).items())
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {words(part)}" for name, part in value.items())
    if isinstance(value, tuple):
        return ", ".join(words(part) for part in value)
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value) if value not in (None, "") else "-"


def in_words(name: str) -> str:
    """A field of the table: ready_after_s is "ready after (s)"."""
    return re.sub(r"_(s|m)$", r" (\1)", name).replace("_", " ")


def cell(fact: Fact[Any]) -> str:
    text = words(fact.value)
    return text if fact.used is None else f"{text} ({words(fact.used)}: {fact.why})"


def modes(of: Fact[dict[int, ModeRule]], names: type[CopterMode] | type[Px4Mode]) -> list[str]:
    """Modes of one kind are one item."""
    alike: dict[str, list[str]] = {}
    for number, rule in of.value.items():
        needs = [name for name, needed in (("position", rule.position), ("sticks", rule.sticks)) if needed]
        kind = ["arms" if rule.arms else "does not arm", *(f"needs {name}" for name in needs)]
        kind += [] if rule.by_command else ["not entered by DO_SET_MODE"]
        alike.setdefault(", ".join(kind), []).append(names(number).name)
    return [f"- {', '.join(found)}: {kind}" for kind, found in alike.items()]


def items() -> str:
    """Both firmwares side by side, then the modes of each."""
    both = (PX4, COPTER)
    lines = []
    for field in fields(PX4):
        facts = [getattr(firmware, field.name) for firmware in both]
        if field.name not in BY_THE_MODULE_ALONE and all(isinstance(fact, Fact) for fact in facts):
            px4, copter = map(cell, facts)
            told = px4 if px4 == copter else f"{px4} / {copter}"
            if len(told) > LONGEST:
                told = f"\n    - {px4}\n    - {copter}"
            lines.append(f"- {in_words(field.name)}: {told}".replace(": \n", ":\n"))
    for firmware in both:
        lines += ["", f"## Modes of {firmware.name} {firmware.version}", ""]
        lines += modes(firmware.modes, Px4Mode if firmware is PX4 else CopterMode)
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    PAGE.write_text(INTRODUCTION + items(), encoding="utf-8")
