"""The journal of what is to be undone: whole entries before the change, private, bounded, and gone after the undo."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from skygcs.errors import RefusedError
from skygcs.runtime.undo_journal import MAX_ENTRIES, UndoableChange, UndoJournal

BEFORE = {"FENCE_ENABLE": 0.0, "FENCE_RADIUS": 300.5}
CHANGED = {"FENCE_ENABLE": 1.0, "FENCE_RADIUS": 5.0}


def begin(journal: UndoJournal, sysid: int = 7) -> UndoableChange:
    return journal.begin("alpha", sysid, "ardupilot", "fence test", BEFORE, CHANGED)


def test_an_entry_outlives_its_journal_in_its_order_and_is_private(tmp_path: Path) -> None:
    change = begin(UndoJournal(tmp_path / "undo"))
    (found,) = UndoJournal(tmp_path / "undo").left()
    assert found == change and list(found.before) == list(BEFORE)
    (file,) = (tmp_path / "undo").iterdir()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600 and stat.S_IMODE(file.parent.stat().st_mode) == 0o700


def test_what_is_under_way_is_not_left_until_it_could_not_be_undone(tmp_path: Path) -> None:
    journal = UndoJournal(tmp_path)
    first, second = begin(journal), begin(journal)
    assert journal.left() == []
    journal.undone(first)
    journal.left_over(second)
    assert journal.left() == [second]
    assert journal.find(second.id) == second
    journal.drop(second)
    assert journal.left() == [] and list(tmp_path.iterdir()) == []
    with pytest.raises(RefusedError):
        journal.find(second.id)


@pytest.mark.parametrize("step", ["replace", "fsync"])
def test_a_disk_that_fails_refuses_the_change_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device")

    journal = UndoJournal(tmp_path)
    monkeypatch.setattr(os, step, fails)
    with pytest.raises(RefusedError, match=r"cannot be written in .*: No space left on device"):
        begin(journal)
    assert list(tmp_path.iterdir()) == [] and journal.left() == []


def test_a_folder_that_cannot_be_read_is_a_problem_and_not_empty(tmp_path: Path) -> None:
    (tmp_path / "undo").write_text("of another user, or of a disk that fails")
    journal = UndoJournal(tmp_path / "undo")
    assert journal.left() == [] and "the folder cannot be read (Not a directory)" in journal.problems[0]
    with pytest.raises(RefusedError, match="cannot be written"):
        begin(journal)


def test_a_file_with_a_number_beyond_every_float_is_a_problem(tmp_path: Path) -> None:
    journal = UndoJournal(tmp_path)
    change = begin(journal)
    kept = tmp_path / f"{change.id}.json"
    (tmp_path / "huge.json").write_text(kept.read_text().replace('"before": {', '"before": {"X": ' + "9" * 400 + ", "))
    assert journal.left() == [] and journal.problems[0].startswith("huge.json cannot be read: int too large")


def test_beyond_its_bound_nothing_is_begun(tmp_path: Path) -> None:
    journal = UndoJournal(tmp_path)
    for number in range(MAX_ENTRIES):
        (tmp_path / f"{number}.json").write_text("{}")
    with pytest.raises(RefusedError, match="wait to be undone already"):
        begin(journal)
    assert journal.left() == [] and len(journal.problems) == MAX_ENTRIES
