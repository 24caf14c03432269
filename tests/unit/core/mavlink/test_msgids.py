"""Message ids: those of the dialect, and defined in one place."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import skygcs
from skygcs.core.mavlink import msgids
from support.frames import dialect

IDS = {name: value for name, value in vars(msgids).items() if name.isupper()}


@pytest.mark.parametrize("name", IDS)
def test_an_id_is_the_dialects(name: str) -> None:
    found = dialect().messages.get(IDS[name])
    assert found is not None, f"the dialect has no message {IDS[name]}"
    assert found.name == name


def test_no_other_module_defines_one() -> None:
    source = Path(skygcs.__file__).parent
    again = []
    for path in source.rglob("*.py"):
        if path == Path(msgids.__file__):
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant | ast.Tuple):
                names = {n.id for target in node.targets for n in ast.walk(target) if isinstance(n, ast.Name)}
                numbers = {n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant)}
                again += [f"{path.name}: {name}" for name in names & IDS.keys() if IDS[name] in numbers]
    assert not again
