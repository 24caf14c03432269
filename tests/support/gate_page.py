"""docs/reference/gate.md: the table of the outgoing gate as a page. Run this module to write it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from skygcs.config.dialects import load_dialect
from skygcs.core.vehicle.gate import ORDERS, Level
from skygcs.core.vehicle.gate_table import (
    ON_THE_GROUND,
    STICKS,
    Cell,
    cells,
    commands_passing,
    messages_passing,
    params_passing,
)

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "gate.md"
DIALECT = "ardupilotmega"

INTRODUCTION = """# The outgoing gate

Everything that skygcs itself sends to a vehicle passes one gate (`skygcs.core.vehicle.gate`): orders, parameters,
missions, fences, calibration, and a client's `messages.send` and `vehicles.command`. Forwarded frames of third-party
programs have roles and filters of their links instead. `skygcs-cli gate` prints the same as tables.

The gate is an allow list. A vehicle counts as disarmed only while it is heard, alone with its system id, its heartbeat
shows it disarmed and no telemetry contradicts that. *Harmless* passes always, *refused* never. *Needs force* needs
`--force`; so does *only disarmed* for a vehicle that does not count as disarmed.

An order may send only what its row names. What no row and no list names is *only disarmed*.

"""


OWN_NAME = re.compile(r"^a \w+ of \w+ ")
"""How a refusal names its vehicle, which the page has in a column."""
OWN_CLASS = re.compile(r"^it is (?:a \w+|of a class that skygcs does not know), and ")
INSIST = re.compile(r"[,;] (?:or )?insist with force \(--force\)$")


def answers(order: str, table: Iterable[Cell]) -> dict[str, list[Cell]]:
    """The cells of each answer to an order: what is sent, or why it is refused."""
    found: dict[str, list[Cell]] = {}
    for cell in table:
        if cell.order == order:
            sent = ", ".join(f"`{thing}`" for thing in cell.sends)
            told = cell.refused if order == STICKS else refused(cell.refused)
            found.setdefault(sent or told, []).append(cell)
    return found


def refused(refusal: str) -> str:
    """A refusal with its reason, without advice on other orders."""
    why, forced = INSIST.subn("", OWN_CLASS.sub("", OWN_NAME.sub("it ", refusal)))
    return f"refused{' without --force' if forced else ''}: {why.partition('; ')[0]}"


def by_firmware(where: Iterable[Cell], table: Iterable[Cell]) -> str:
    """PX4 copter, plane; ArduPilot sub. A firmware alone is all of its classes."""
    kinds: dict[str, list[str]] = {}
    for cell in where:
        kinds.setdefault(cell.firmware, []).append(named(cell))
    whole = {firmware: {named(cell) for cell in table if cell.firmware == firmware} for firmware in kinds}
    return "; ".join(
        firmware if set(names) == whole[firmware] else f"{firmware} {', '.join(names)}"
        for firmware, names in kinds.items()
    )


def named(cell: Cell) -> str:
    return cell.kind + (f" {cell.state}" if cell.state else "")


def joined(rows: Mapping[str, str]) -> list[str]:
    """Items of a list; those with the same right side are one."""
    names: dict[str, list[str]] = {}
    for name, right in rows.items():
        names.setdefault(right, []).append(name)
    return [f"- {', '.join(left)}: {right}" for right, left in names.items()]


def page() -> str:
    """The whole page."""
    dialect = load_dialect(DIALECT)
    *others, last = (f"`{order}`" for order in ON_THE_GROUND)
    ground = f"{', '.join(others)} and {last}"
    lines = ["## Orders", "", "What is sent to a vehicle that is in the air and shows no sticks;"]
    lines += [f"for {ground}, to one on the ground.", ""]
    table = list(cells(dialect))
    for order in dict.fromkeys(cell.order for cell in table):
        found = answers(order, table)
        if len(found) == 1:
            lines.append(f"- **{order}**: {next(iter(found))}")
            continue
        lines.append(f"- **{order}**:")
        lines += [f"    - {by_firmware(at, table)}: {text}" for text, at in found.items()]
    lines += ["", "## Rows", "", "What each order, stream and transfer may send beside what is harmless.", ""]
    names = {number: name.removeprefix("MAV_CMD_") for number, name in dialect.enums["MAV_CMD"].items()}
    rows = {
        order: ", ".join(f"`{thing}`" for thing in [*sorted(rule.messages), *(names[n] for n in sorted(rule.commands))])
        for order, rule in ORDERS.items()
    }
    lines += joined({order: things or "only itself, or what is harmless" for order, things in rows.items()})
    lines += ["", "## Raw messages and commands", "", f"Of the dialect {DIALECT}; others have the same lists.", ""]
    for what, passing in (("messages", messages_passing(dialect)), ("commands", commands_passing(dialect))):
        counts = ", ".join(f"{passing.levels[level]} {level.value}" for level in Level if passing.levels[level])
        lines.append(f"- Of {passing.all} {what}: {counts}.")
    for what, passing in (("messages", messages_passing(dialect)), ("commands", commands_passing(dialect))):
        lines += ["", f"Harmless {what}: " + ", ".join(f"`{name}`" for name in passing.harmless) + "."]
    lines += ["", "## Parameters", "", "By their role (`skygcs.core.params.names`).", ""]
    lines += joined(params_passing())
    return INTRODUCTION + "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
