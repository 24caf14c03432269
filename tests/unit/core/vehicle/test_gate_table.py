"""The gate's table: what it says of a few cells, and that the page of the reference is made from it."""

from __future__ import annotations

from skygcs.config.dialects import load_dialect
from skygcs.core.vehicle.gate import Level
from skygcs.core.vehicle.gate_table import Cell, cells, commands_passing, messages_passing
from support.gate_page import PAGE, page

DIALECT = load_dialect("ardupilotmega")


def test_the_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "PYTHONPATH=tests python -m support.gate_page"


def test_each_cell_says_what_is_sent_or_why_not() -> None:
    table = {(c.firmware, c.kind, c.state, c.order): c for c in cells(DIALECT)}
    assert all(bool(cell.sends) is not bool(cell.refused) for cell in table.values())

    def at(firmware: str, kind: str, order: str, state: str = "") -> Cell:
        return table[firmware, kind, state, order]

    assert at("ArduPilot", "copter", "hold").sends == ("mode BRAKE", "mode GUIDED")
    assert at("ArduPilot", "vtol", "hold", "hovering").sends == ("mode QLOITER",)
    assert at("ArduPilot", "vtol", "land", "hovering").sends == ("mode QLAND",)
    assert "does not land" in at("ArduPilot", "rover", "land").refused
    assert at("PX4", "copter", "stop kill").sends == ("disarm forced",)
    assert "would fall" in at("PX4", "copter", "disarm").refused
    assert "STABILIZE" in at("ArduPilot", "copter", "modes by sticks").refused.partition(";")[0]
    assert "LOITER" in at("ArduPilot", "copter", "modes by sticks").refused.partition(";")[2]


def test_the_counts_are_those_of_the_lists() -> None:
    messages, commands = messages_passing(DIALECT), commands_passing(DIALECT)
    assert (messages.all, messages.levels[Level.HARMLESS], messages.levels[Level.NEVER]) == (299, 36, 9)
    assert commands.levels[Level.HARMLESS] == len(commands.harmless) == 40
    for passing in (messages, commands):
        assert sum(passing.levels.values()) == passing.all
