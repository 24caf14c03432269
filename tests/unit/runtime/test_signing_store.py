"""The time of a key on disk: whole or not at all, never back, and a fault of the disk is told."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from skygcs.core.mavlink.signing import MAX_TIMESTAMP, TICKS_PER_S
from skygcs.runtime.signing_store import AFTER_CRASH_S, SigningStore, default_state_dir

NOW = 37_000_000_000_000


def test_an_exact_time_comes_back_as_it_was(tmp_path: Path) -> None:
    SigningStore(tmp_path / "new").save("ab", NOW, exact=True)
    store = SigningStore(tmp_path / "new")
    assert store.load("ab") == NOW
    assert store.load("cd") == 0
    assert (tmp_path / "new").stat().st_mode & 0o077 == 0
    assert store.problem == ""


def test_after_a_crash_the_time_is_beyond_what_may_have_been_used(tmp_path: Path) -> None:
    store = SigningStore(tmp_path)
    store.save("ab", NOW, exact=False)
    assert store.load("ab") == NOW + AFTER_CRASH_S * TICKS_PER_S
    store.save("ab", MAX_TIMESTAMP, exact=False)
    assert store.load("ab") == MAX_TIMESTAMP


@pytest.mark.parametrize("content", ["", "{}", "[]", "7", '{"format": 2, "timestamp": 1, "exact": true}', "\0" * 50])
def test_a_broken_file_is_told_and_is_no_time(tmp_path: Path, content: str) -> None:
    (tmp_path / "ab.json").write_text(content)
    store = SigningStore(tmp_path)
    assert store.load("ab") == 0
    assert "ab.json cannot be read" in store.problem
    store.save("ab", NOW, exact=True)
    assert (store.load("ab"), store.problem) == (NOW, "")


def test_a_save_that_fails_leaves_the_old_time_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = SigningStore(tmp_path)
    store.save("ab", NOW, exact=True)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    store.save("ab", NOW + 5, exact=True)
    assert "ab.json cannot be written (No space left on device)" in store.problem
    assert [p.name for p in tmp_path.iterdir()] == ["ab.json"]
    assert store.load("ab") == NOW


def test_without_a_folder_nothing_is_kept_and_that_is_told() -> None:
    store = SigningStore(None)
    store.save("ab", NOW, exact=True)
    assert store.load("ab") == 0
    assert "no folder" in store.problem


def test_the_folder_is_that_of_the_desktop_standard(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert default_state_dir() == tmp_path / "skygcs" / "signing"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_state_dir() == tmp_path / ".local" / "state" / "skygcs" / "signing"
