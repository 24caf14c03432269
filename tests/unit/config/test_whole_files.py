"""Files are written whole or not at all, and on request reach the disk."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from skygcs.config.files import write_whole
from support.table import each


def test_a_file_is_replaced_with_its_mode_and_nothing_stays_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    path.write_bytes(b"a longer text than the new one")
    path.chmod(0o644)
    write_whole(path, b"new", 0o600)
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"new", 0o600)
    assert os.listdir(tmp_path) == ["keys.json"]


@each("failing", ["fsync", "replace"])
def test_what_fails_half_way_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str) -> None:
    path = tmp_path / "keys.json"
    path.write_bytes(b"old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, failing, full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"new", 0o600)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["keys.json"]


def test_a_durable_file_is_synced_before_its_name_and_its_folder_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "entry.json"
    steps: list[str] = []
    replace = os.replace

    def renamed(source: str, target: Path) -> None:
        replace(source, target)
        steps.append("rename")

    monkeypatch.setattr(os, "replace", renamed)
    monkeypatch.setattr(os, "fsync", lambda handle: steps.append(os.readlink(f"/proc/self/fd/{handle}")))
    write_whole(path, b"before the first change", 0o600)
    draft, middle, folder = steps
    assert Path(draft).parent == tmp_path and Path(draft) != path
    assert (middle, folder) == ("rename", str(tmp_path))


def test_a_cache_waits_for_no_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda handle: pytest.fail("it waits for the disk"))
    path = tmp_path / "cache.json"
    write_whole(path, b"{}", 0o600, durable=False)
    assert path.read_bytes() == b"{}"
