"""Files are written whole or not at all, and on request reach the disk."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from skygcs.config.files import write_named, write_whole
from support.process import ROOT
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


def test_what_a_person_names_is_whole_or_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a list of waypoints is a valid, shorter mission."""
    real, named = tmp_path / "m.waypoints", tmp_path / "link"
    named.symlink_to(real)
    write_named(named, "a mission")
    real.chmod(0o664)
    with pytest.raises(FileExistsError, match=r"link"):
        write_named(named, "another", force=False)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: os.write(9_999, b""))
        with pytest.raises(OSError, match="link"):
            write_named(named, "another")
    assert (real.read_text(), len(os.listdir(tmp_path))) == ("a mission", 2)
    write_named(named, b"another")
    assert (real.read_text(), real.stat().st_mode & 0o777, named.is_symlink()) == ("another", 0o664, True)


def test_a_file_of_two_names_keeps_both(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    write_named(one, "a mission")
    os.link(one, other)
    write_named(one, "another")
    assert other.read_text() == "another"
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    with pytest.raises(OSError, match="loop"):
        write_named(loop, "another")


def test_a_device_and_a_pipe_are_written_to(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    for path in (Path(f"/dev/fd/{writer}"), Path(os.devnull)):
        write_named(path, "a mission", force=False)
    assert os.read(reader, 100) == b"a mission" and not Path(os.devnull).is_file()
    os.close(reader)
    os.close(writer)


OF_NO_PERSON = {
    "cli/fleet_files.py": 1,  # a temporary folder's
    "cli/sitl.py": 2,  # working folders of firmware
    "ext/companions/bring_up/bundle.py": 1,  # a draft
    "ext/companions/bring_up/companion_file.py": 1,  # a temporary folder's
    "ext/ros/commands.py": 1,  # a new folder's
}
"""Files that commands write otherwise, and how many times."""


def test_commands_write_what_a_person_names_in_one_way() -> None:
    source, found = ROOT / "src/skygcs", {}
    for path in sorted([*source.glob("cli/*.py"), *source.glob("ext/**/*.py")]):
        ways = re.findall(r"\.write_text\(|\bopen\([^)\n]*\"[wx]\"", path.read_text())
        if ways:
            found[str(path.relative_to(source))] = len(ways)
    assert found == OF_NO_PERSON
