"""Recordings that are collected: files in a folder that others may write to."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from skygcs.federation.logs import append, length_to_continue, list_files


def test_a_link_in_the_place_of_a_partial_file_leads_nowhere(tmp_path: Path) -> None:
    mine, part = tmp_path / "mine", tmp_path / "a.tlog.part"
    mine.write_bytes(b"precious")
    part.symlink_to(mine)
    with pytest.raises(OSError):
        length_to_continue(part, 3)
    with pytest.raises(OSError):
        append(part, b"theirs")
    assert mine.read_bytes() == b"precious"
    part.unlink()
    os.mkfifo(part)  # nobody reads it: opening it must not wait
    with pytest.raises(OSError):
        append(part, b"theirs")


def test_a_partial_file_is_continued_and_one_that_is_too_long_begins_anew(tmp_path: Path) -> None:
    part = tmp_path / "a.tlog.part"
    assert length_to_continue(part, 3) == 0
    append(part, b"ab")
    append(part, b"cd")
    assert length_to_continue(part, 4) == 4 and part.read_bytes() == b"abcd"
    assert length_to_continue(part, 3) == 0 and part.read_bytes() == b""


def test_a_log_that_vanishes_while_they_are_listed_hides_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a.tlog", "b.tlog", "c.tlog"):
        (tmp_path / name).write_bytes(b"x")
    real = os.scandir

    class Scan:
        """The first file is removed between its listing and its stat."""

        def __init__(self, folder: Path) -> None:
            self.entries = list(real(folder))
            Path(self.entries[0].path).unlink()

        def __enter__(self) -> object:
            return iter(self.entries)

        def __exit__(self, *_: object) -> None:
            pass

    monkeypatch.setattr(os, "scandir", Scan)
    assert len(list_files(tmp_path, 0.0)) == 2
