"""What the bench of moving references flies, and the tables it keeps on a docs page."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from bench.control.docs_tables import BEGIN, END, ON_THE_PAGE, differences, write_tables
from bench.control.figures import Section
from bench.control.moving import Path3, circle, figure_of_eight, rounded_square, sharp_square
from support.table import each

PAGE = Path(__file__).parents[3] / "docs" / "developers" / "control-figures.md"
STEP_S = 1e-4


@each("path", [circle, figure_of_eight, rounded_square, sharp_square])
def test_velocity_and_acceleration_are_those_of_the_positions(path: Path3) -> None:
    corners = 0
    for n in range(2000):
        t = 0.05 * n + 0.013
        (before, v0, _), (here, velocity, acceleration), (after, v1, _) = (path(t + k * STEP_S) for k in (-1, 0, 1))
        slope = [(b - a) / (2 * STEP_S) for a, b in zip(before, after, strict=True)]
        assert slope == pytest.approx(velocity, abs=1e-3), f"at {t} s, {here}"
        change = [(b - a) / (2 * STEP_S) for a, b in zip(v0, v1, strict=True)]
        corners += change != pytest.approx(acceleration, abs=1e-2)
        assert math.hypot(*velocity) <= 2.0 + 1e-9
    assert corners <= 2, "an acceleration that begins at once"
    assert path(0.0)[0] == pytest.approx((0.0, 0.0, 0.0))


def a_section(cell: str = "0.2") -> Section:
    return Section("circle", "a title", ("flown by", "0.05 s"), [("position", cell)])


def test_a_table_is_written_into_its_place_and_found_there(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN.format(key='circle')}\nold\n{END.format(key='circle')}\nafter\n")
    assert differences(page, [a_section()])
    write_tables(page, [a_section()])
    write_tables(page, [a_section()])
    assert differences(page, [a_section()]) == []
    assert differences(page, [a_section("0.3")]) == ["circle: now | position | 0.3 |"]
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert "| flown by | 0.05 s |\n| --- | --- |\n| position | 0.2 |\n" in text


def test_a_page_without_a_place_is_refused(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("nothing")
    with pytest.raises(ValueError, match="no place for circle"):
        write_tables(page, [a_section()])


@each("key", ON_THE_PAGE)
def test_the_docs_have_every_table(key: str) -> None:
    text = PAGE.read_text()
    table = text.partition(BEGIN.format(key=key))[2].partition(END.format(key=key))[0]
    assert table.strip().count("\n") >= 2, f"{key}: a head and rows"
