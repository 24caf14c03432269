"""Recordings of a folder: which are listed, and that no name leads out of it."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from skygcs.errors import RefusedError
from skygcs.ext.logs import recordings
from skygcs.ext.logs.recordings import Found, recording_of, recordings_in
from support.table import each


def put(folder: Path, name: str, changed: float = 1e9, content: bytes = b"x") -> Path:
    path = folder / name
    path.write_bytes(content)
    os.utime(path, (changed, changed))
    return path


def test_the_newest_come_first_and_only_recordings_are_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for n in range(5):
        put(tmp_path, f"20261128T18000{n}Z-000{n}.tlog", 1e9 + n, b"x" * n)
    put(tmp_path, "events.jsonl")
    put(tmp_path, "day.tlog.part")
    (tmp_path / "folder.tlog").mkdir()
    (tmp_path / "link.tlog").symlink_to(tmp_path / "events.jsonl")
    found, more = recordings_in(tmp_path)
    assert [f.name[-6] for f in found] == ["4", "3", "2", "1", "0"] and more == 0
    assert found[0].size_bytes == 4
    monkeypatch.setattr(recordings, "MAX_LISTED", 2)
    found, more = recordings_in(tmp_path)
    assert len(found) == 2 and more == 3
    assert recordings_in(tmp_path / "not there") == ([], 0)


def test_the_begin_is_that_of_the_name() -> None:
    begun = Found("20261128T181512Z-0001.tlog", 1, 2.0).begun_unix_s
    assert begun == datetime(2026, 11, 28, 18, 15, 12, tzinfo=UTC).timestamp()
    assert Found("00000000T000000Z-0001.tlog", 1, 2.0).begun_unix_s is None
    assert Found("flight.tlog", 1, 2.0).begun_unix_s is None


@each(
    "name",
    [
        "../secret.tlog",
        "/etc/passwd",
        "a/b.tlog",
        "..tlog",
        ".hidden.tlog",
        "a.tlog\n",
        "a.tlog/",
        "",
        "x" * 200 + ".tlog",
    ],
)
def test_a_name_that_is_none_of_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "logs").mkdir()
    put(tmp_path, "secret.tlog")
    with pytest.raises(RefusedError, match="is not the name of a recording"):
        recording_of(tmp_path / "logs", name)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings, and others outside of it that a name could lead to."""
    above = tmp_path_factory.mktemp("station")
    folder = above / "logs"
    (folder / "sub").mkdir(parents=True)
    for place in (folder, folder / "sub", above):
        put(place, "a.tlog")
        put(place, "secret.tlog" if place != folder else "b.tlog")
    (folder / "link.tlog").symlink_to(above / "secret.tlog")
    return folder


PARTS = ["..", ".", "/", "\\", "a", "b", "sub", "link", "logs", "secret", ".tlog", "\0", "\n", "%2e%2e", "~"]


@given(st.lists(st.sampled_from(PARTS), max_size=8).map("".join) | st.text(max_size=40))
@example("../secret.tlog")
@example("sub/a.tlog")
@example("./a.tlog")
@example("link.tlog")
@example("../logs/a.tlog")
@example("a.tlog")
def test_no_text_leads_out_of_the_folder(logs: Path, name: str) -> None:
    for text in (name, f"{name}.tlog", f"{logs.parent}/{name}", f"../{name}"):
        try:
            found = recording_of(logs, text)
        except RefusedError:
            assert text not in ("a.tlog", "b.tlog")
        else:
            assert found in (logs / "a.tlog", logs / "b.tlog") and text == found.name


def test_a_link_or_a_folder_is_no_recording(tmp_path: Path) -> None:
    target = put(tmp_path, "there.tlog")
    (tmp_path / "link.tlog").symlink_to(target)
    (tmp_path / "folder.tlog").mkdir()
    assert recording_of(tmp_path, "there.tlog") == target
    for name in ("link.tlog", "folder.tlog"):
        with pytest.raises(RefusedError, match="not a regular file"):
            recording_of(tmp_path, name)
    with pytest.raises(RefusedError, match="No such file"):
        recording_of(tmp_path, "gone.tlog")
