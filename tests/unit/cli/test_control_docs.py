"""What the pages about control show is what the commands take."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

from skygcs.cli.setpoint import COLUMNS as SETPOINT_COLUMNS
from skygcs.cli.setpoint import VECTORS, LineReader
from skygcs.core.control.trace import COLUMNS, FORMAT
from skygcs.ext.plans.commands.table import read_table
from skygcs.ext.plans.position_table import spots
from support.public_data import ROOT
from support.table import each

DOCS = ROOT / "docs"


def blocks(page: str, language: str) -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(rf'```{language}(?: title="[^"]+")?\n(.*?)```', text, re.DOTALL)


def test_every_column_and_the_format_of_a_trace_are_described() -> None:
    page = (DOCS / "reference" / "control-trace.md").read_text(encoding="utf-8")
    assert [column for column in COLUMNS if f"`{column}`" not in page] == []
    assert FORMAT in page


@each("language", ["json", "csv"])
def test_the_lines_shown_are_setpoints(language: str) -> None:
    (block,) = blocks("howto/fly-setpoints.md", language)
    reader = LineReader()
    assert [reader.read(line) for line in block.splitlines()][-1] is not None


def test_every_key_and_column_of_a_setpoint_is_described() -> None:
    page = (DOCS / "howto" / "fly-setpoints.md").read_text(encoding="utf-8")
    assert [name for name in (*SETPOINT_COLUMNS, *VECTORS) if f"`{name}`" not in page] == []


def test_the_tables_shown_say_the_same_and_can_be_flown(tmp_path: Path) -> None:
    tables = []
    for language in ("csv", "toml"):
        (block,) = blocks("howto/fly-several.md", language)
        path = tmp_path / f"t.{language}"
        path.write_text(block, encoding="utf-8")
        tables.append(read_table(path))
    assert tables[0]["alpha"] == tables[1]["alpha"]


def test_the_example_table_is_for_the_example_fleet() -> None:
    table = read_table(ROOT / "configs" / "table.csv")
    fleet = (ROOT / "configs" / "sim.toml").read_text(encoding="utf-8")
    assert all(f"[vehicles.{name}]" in fleet for name in table)
    for which in ("initial", "final"):
        places = [spot.position_m for spot in spots(table, which).values()]
        assert min(math.dist(a, b) for a, b in itertools.combinations(places, 2)) >= 2.0
