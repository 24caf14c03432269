"""A dear test file states its reason, a cheap one does not, and the table shows both."""

from __future__ import annotations

from pathlib import Path

from support.file_costs import LIMIT_CPU_S, STALE_CPU_S, Cost, faults, stated_reason, table


def test_a_dear_file_needs_a_reason_and_a_cheap_one_needs_none(tmp_path: Path) -> None:
    (tmp_path / "silent.py").write_text("import os\n")
    (tmp_path / "stated.py").write_text('"""Tests."""\n\nCOSTS = "it flies an hour"\n')
    dear, cheap = LIMIT_CPU_S + 0.1, STALE_CPU_S - 0.1
    assert faults({"silent.py": cheap, "stated.py": dear}, tmp_path) == []
    silent, stated = faults({"silent.py": dear, "stated.py": cheap}, tmp_path)
    assert "silent.py costs 5.1 s" in silent
    assert "stated.py costs 1.4 s" in stated


def test_the_table_begins_with_the_dearest_and_ends_with_the_sum(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("")
    (tmp_path / "b.py").write_text('COSTS = "it flies an hour"\n')
    (tmp_path / "tests/unit/core").mkdir(parents=True)
    (tmp_path / "tests/unit/core/c.py").write_text("")
    files = {"a.py": Cost(1.0, 2.0, 3), "b.py": Cost(6.0, 7.0, 8), "tests/unit/core/c.py": Cost(0.5, 0.5, 1)}
    _, first, second, _, here, core, total = table(files, tmp_path)
    assert first.split()[:4] == ["6.00", "7.00", "8", "b.py:"]
    assert first.endswith("it flies an hour")
    assert second.split() == ["1.00", "2.00", "3", "a.py"]
    assert here.split() == ["7.00", "9.00", "11", "/"] and core.split() == ["0.50", "0.50", "1", "tests/unit/core/"]
    assert total.split()[:3] == ["7.50", "9.50", "12"]


def test_a_reason_is_a_line_of_the_files_top_level(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    path.write_text('def f():\n    COSTS = "no"\n')
    assert stated_reason(path) is None
