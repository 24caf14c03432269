"""docs/reference/gate.md: the table of the outgoing gate as a page. Run this module to write it."""

from __future__ import annotations

from pathlib import Path

from skygcs.config.dialects import load_dialect
from skygcs.core.vehicle.gate import ORDERS, Level
from skygcs.core.vehicle.gate_table import (
    EXAMPLES,
    ON_THE_GROUND,
    STICKS,
    cells,
    commands_passing,
    messages_passing,
    params_passing,
)

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "gate.md"
DIALECT = "ardupilotmega"

INTRODUCTION = """# The outgoing gate

Everything that skygcs itself sends to a vehicle passes one gate (`skygcs.core.vehicle.gate`): orders, parameters,
missions, fences, calibration, and what a client sends with `messages.send` and `vehicles.command`. Frames of
third-party programs that are forwarded have roles and filters of their links instead. `skygcs-cli gate` prints the
tables of this page, `--json` for programs.

The gate is an allow list. A vehicle counts as disarmed only while it is heard, alone with its system id, its heartbeat
shows it disarmed and no telemetry contradicts that; of any other one:

| level | a vehicle known to be disarmed | any other |
|---|---|---|
| harmless | passes | passes |
| only disarmed | passes | needs `--force` |
| needs force | needs `--force` | needs `--force` |
| refused | refused | refused |

An order has checks of its own, and may send only what its row names. What no row and no list names needs `--force`
unless every vehicle that it reaches is known to be disarmed.

"""


def page() -> str:
    """The whole page."""
    dialect = load_dialect(DIALECT)
    ground = ", ".join(f"`{order}`" for order in ON_THE_GROUND)
    about = f"What is sent, in its order, or why it is refused: in the air without sticks, {ground} on the ground."
    lines = ["## Orders", "", about, ""]
    table = list(cells(dialect))
    for example in EXAMPLES:
        lines += [f"### {example.title}", "", "| order | sent, or refused |", "|---|---|"]
        for cell in table:
            if (cell.firmware, cell.kind, cell.state) == (example.firmware, example.kind, example.state):
                sent = ", ".join(f"`{thing}`" for thing in cell.sends)
                told = cell.refused if cell.order == STICKS else f"refused: {cell.refused}"
                lines.append(f"| {cell.order} | {sent or told} |")
        lines.append("")
    lines += ["## Rows", "", "What each order, stream and transfer may send beside what is harmless.", ""]
    lines += ["| row | messages and commands |", "|---|---|"]
    names = {number: name.removeprefix("MAV_CMD_") for number, name in dialect.enums["MAV_CMD"].items()}
    for order, rule in ORDERS.items():
        things = sorted(rule.messages) + [names[number] for number in sorted(rule.commands)]
        lines.append(
            f"| {order} | {', '.join(f'`{thing}`' for thing in things) or 'only itself, or what is harmless'} |"
        )
    lines += ["", "## Raw messages and commands", "", f"Of the dialect {DIALECT}; others have the same lists.", ""]
    lines += ["| | all | " + " | ".join(level.value for level in Level) + " |", "|---|---|" + "---|" * len(Level)]
    for what, passing in (("messages", messages_passing(dialect)), ("commands", commands_passing(dialect))):
        counts = " | ".join(str(passing.levels[level]) for level in Level)
        lines.append(f"| {what} | {passing.all} | {counts} |")
    for what, passing in (("messages", messages_passing(dialect)), ("commands", commands_passing(dialect))):
        lines += ["", f"Harmless {what}: " + ", ".join(f"`{name}`" for name in passing.harmless) + "."]
    lines += ["", "## Parameters", "", "By their role (`skygcs.core.params.param_roles`).", ""]
    lines += ["| role | level |", "|---|---|"]
    lines += [f"| {role} | {level} |" for role, level in params_passing().items()]
    return INTRODUCTION + "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
