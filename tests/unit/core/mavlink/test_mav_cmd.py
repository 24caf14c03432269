"""Commands: those of pymavlink's dialects, and defined in one place."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as every

import skygcs
from skygcs.core.mavlink import mav_cmd

COMMANDS = {name: value for name, value in vars(mav_cmd).items() if name.isupper()}
SIMULATOR = "protocol.py"
"""The simulated firmwares have a table of their own, so that a mistake in one of the two shows."""


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_is_the_dialects(name: str) -> None:
    assert every.enums["MAV_CMD"][COMMANDS[name]].name == f"MAV_CMD_{name}"


def test_no_other_module_defines_one() -> None:
    again = []
    for path in Path(skygcs.__file__).parent.rglob("*.py"):
        if path in (Path(mav_cmd.__file__),) or path.name == SIMULATOR:
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant | ast.Tuple):
                names = {n.id for target in node.targets for n in ast.walk(target) if isinstance(n, ast.Name)}
                numbers = {n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant)}
                again += [f"{path.name}: {name}" for name in names & COMMANDS.keys() if COMMANDS[name] in numbers]
    assert not again
