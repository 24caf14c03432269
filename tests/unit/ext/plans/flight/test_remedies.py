"""Every refusal of a flight has a remedy whose command is one: all remedies, read by the command line's own parser."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import pytest
import typer.main

from skygcs.cli.main import app, hoisted, json_last
from skygcs.ext.plans.flight import remedies
from skygcs.ext.plans.flight.flight_findings import Finding, Level, refused
from skygcs.ext.plans.flight.remedies import Remedy
from support.shell_examples import calls

ROOT_COMMAND = typer.main.get_command(app)

EXAMPLES: dict[str, list[Any]] = {
    "before": ["charge it"],
    "name": ["alpha"],
    "names": [["alpha"], ["alpha", "bravo", "charlie"]],
    "factor": [0.35],
    "param": ["RTL_ALT"],
    "value": [1500.0],
    "radius_m": [None, 20.2],
    "height_m": [None, 12.0],
}
MADE = [
    make
    for name, make in inspect.getmembers(remedies, inspect.isfunction)
    if make.__module__ == remedies.__name__ and not name.startswith("_")
]


def every(make: Callable[..., Remedy]) -> list[Remedy]:
    """The remedies that it makes of all examples."""
    made: list[dict[str, Any]] = [{}]
    for parameter in inspect.signature(make).parameters:
        made = [{**one, parameter: value} for one in made for value in EXAMPLES[parameter]]
    return [make(**one) for one in made]


def parse(line: str) -> None:
    ((_, *args),) = calls(line)
    command, rest, parent = ROOT_COMMAND, hoisted(json_last(args)), None
    while True:
        context = command.make_context(command.name, rest, parent=parent)
        words = [*getattr(context, "_protected_args", ()), *context.args]
        if not hasattr(command, "resolve_command") or not words:
            return
        _, command, rest = command.resolve_command(context, words)
        parent = context


def test_the_command_of_every_remedy_is_one() -> None:
    found = [remedy for make in MADE for remedy in every(make)]
    assert len(MADE) > 15
    for remedy in found:
        parse(remedy.command)
        assert f"`{remedy.command}`" in remedy.text(insist=False), remedy
        assert "--force" in remedy.text(insist=True), remedy
        assert remedy.text(insist=False).startswith(remedy.before)


def test_a_refusal_without_a_remedy_cannot_be_made() -> None:
    with pytest.raises(ValueError, match="remedy"):
        Finding("alpha", "link", Level.REFUSED, "too slow")
    with pytest.raises(ValueError, match="remedy"):
        Finding("alpha", "link", Level.OK, "fine", remedy=remedies.by_goto())
    assert refused("alpha", "link", "too slow", remedies.by_goto()).as_dict()["command"] == f"{remedies.RUN} --by goto"
