"""Recordings that are collected: files in a folder that others may write to."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import pytest

from skygcs.ext.federation.bridge.logs import LogCollector, append, length_to_continue, list_files


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


async def test_what_a_site_lists_and_says_can_be_shown_and_no_entry_of_it_hides_another(tmp_path: Path) -> None:
    there = {"name": "a.tlog", "bytes": 0, "modified_unix_s": 5}
    wrong = [
        *({**there, "name": name} for name in ("../a.tlog", "a\x1b.tlog", "a/b.tlog", "a.txt", "", None, 7)),
        *({**there, "bytes": size} for size in (-1, 1.5, "1", None, 1 << 41, 10**400)),
        *({**there, "modified_unix_s": at} for at in (-1, "now", None, [], 1e12, 10**400)),
        *({}, [], "a.tlog", None),
    ]

    class AnsweringBus:
        async def request(self, subject: str, data: bytes, within_s: float) -> bytes:
            if subject != "log.south":
                return json.dumps({"error": "\x1b[2J\n" + 1000 * "x"}).encode()
            files = [*wrong, there, {**there, "name": "b.tlog", "modified_unix_s": "FAR"}]
            sums = {"sha256": hashlib.sha256(b"").hexdigest()}
            return json.dumps({"files": files, **sums}).replace('"FAR"', "1e999").encode()

    bus: Any = AnsweringBus()
    lines: list[str] = []
    done = await LogCollector(bus, tmp_path, lines.append).collect(["north", "south"])
    assert done.files == [tmp_path / "south" / "a.tlog"]
    (problem,) = done.problems
    assert problem == "north: ?[2J?" + 295 * "x" and lines[0] == "south: 1 log"
