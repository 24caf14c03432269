"""The lines that were typed before: a bounded file of the user's own."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from skygcs.ext.shell import history
from skygcs.ext.shell.history import MAX_FILE_BYTES, MAX_LINES, history_file, read_history, write_history


def test_the_newest_lines_come_back_and_nobody_else_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "skygcs" / "shell_history"
    assert read_history(path) == []
    write_history(path, ["", "  ", "caf\u00e9", "\x1b[A", *(f"line {n}" for n in range(MAX_LINES + 10))])
    assert read_history(path) == [f"line {n}" for n in range(10, MAX_LINES + 10)]
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_file_of_any_kind_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "history"
    path.write_bytes(b"first\n" + b"\xff\x1b\x00" * MAX_FILE_BYTES + b"\nlast\n")
    assert read_history(path) == ["last"]
    assert read_history(tmp_path) == []
    write_history(tmp_path / "history" / "below", ["line"])  # a file in place of a folder


def test_it_is_in_the_users_state_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert history_file() == tmp_path / "skygcs" / "shell_history"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(history.Path, "home", lambda: tmp_path)
    assert history_file() == tmp_path / ".local" / "state" / "skygcs" / "shell_history"
