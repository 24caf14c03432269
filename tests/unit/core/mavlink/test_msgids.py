"""Message ids and commands: those of the dialects, and each defined in one place."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

from pymavlink.dialects.v20 import all as every

import skygcs
from skygcs.core.mavlink import mav_cmd, msgids
from support.frames import dialect
from support.table import each

SIMULATOR = "protocol.py"
"""The simulated firmwares have a table of commands of their own, so that a mistake in one of the two shows."""


def numbers(module: ModuleType) -> dict[str, int]:
    return {name: value for name, value in vars(module).items() if name.isupper() and isinstance(value, int)}


@each(("name", "number"), numbers(mav_cmd).items())
def test_a_command_is_the_dialects(name: str, number: int) -> None:
    assert every.enums["MAV_CMD"][number].name == f"MAV_CMD_{name}"


@each(("name", "number"), numbers(msgids).items())
def test_an_id_is_the_dialects(name: str, number: int) -> None:
    found = dialect().messages.get(number)
    assert found is not None, f"the dialect has no message {number}"
    assert found.name == name


@each(("module", "exempt"), [(mav_cmd, {SIMULATOR}), (msgids, set())])
def test_no_other_module_defines_one(module: ModuleType, exempt: set[str]) -> None:
    defined = re.compile(r"^([A-Z]\w*)\b[^=\n]*= *(\d+)(?:\.0)?$", re.M)
    known, again = numbers(module), []
    for path in Path(skygcs.__file__).parent.rglob("*.py"):
        if path == Path(str(module.__file__)) or path.name in exempt:
            continue
        found = defined.findall(path.read_text(encoding="utf-8"))
        again += [f"{path.name}: {name}" for name, number in found if known.get(name) == int(number)]
    assert not again
