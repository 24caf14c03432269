"""Message ids: those of the dialect, and defined in one place."""

from __future__ import annotations

import re
from pathlib import Path

import skygcs
from skygcs.core.mavlink import msgids
from support.frames import dialect
from support.table import each

IDS = {name: value for name, value in vars(msgids).items() if name.isupper()}


@each("name", IDS)
def test_an_id_is_the_dialects(name: str) -> None:
    found = dialect().messages.get(IDS[name])
    assert found is not None, f"the dialect has no message {IDS[name]}"
    assert found.name == name


def test_no_other_module_defines_one() -> None:
    defined = re.compile(rf"^({'|'.join(IDS)})\b[^=\n]*= *(\d+)(?:\.0)?$", re.M)
    again = []
    for path in Path(skygcs.__file__).parent.rglob("*.py"):
        if path == Path(msgids.__file__):
            continue
        found = defined.findall(path.read_text(encoding="utf-8"))
        again += [f"{path.name}: {name}" for name, number in found if int(number) == IDS[name]]
    assert not again
