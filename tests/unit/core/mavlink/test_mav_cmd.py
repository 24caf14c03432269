"""Commands: those of pymavlink's dialects, and defined in one place."""

from __future__ import annotations

import re
from pathlib import Path

from pymavlink.dialects.v20 import all as every

import skygcs
from skygcs.core.mavlink import mav_cmd
from support.table import each

COMMANDS = {name: value for name, value in vars(mav_cmd).items() if name.isupper()}
SIMULATOR = "protocol.py"
"""The simulated firmwares have a table of their own, so that a mistake in one of the two shows."""


@each("name", COMMANDS)
def test_a_command_is_the_dialects(name: str) -> None:
    assert every.enums["MAV_CMD"][COMMANDS[name]].name == f"MAV_CMD_{name}"


def test_no_other_module_defines_one() -> None:
    defined = re.compile(rf"^({'|'.join(COMMANDS)})\b[^=\n]*= *(\d+)(?:\.0)?$", re.M)
    again = []
    for path in Path(skygcs.__file__).parent.rglob("*.py"):
        if path == Path(mav_cmd.__file__) or path.name == SIMULATOR:
            continue
        found = defined.findall(path.read_text(encoding="utf-8"))
        again += [f"{path.name}: {name}" for name, number in found if int(number) == COMMANDS[name]]
    assert not again
