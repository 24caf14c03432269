"""The files of a bridge: its record of orders, collected recordings, keys."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from pathlib import Path
from typing import Any

import nkeys
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.errors import KeyFileError
from skygcs.ext.federation.bridge import audit_file
from skygcs.ext.federation.bridge.audit_file import AuditFile
from skygcs.ext.federation.bridge.logs import LogCollector, append, length_to_continue, list_files
from skygcs.ext.federation.bridge.nkeys_files import new_key, read_seed, write_new_seed
from skygcs.ext.federation.protocol.audit import AuditRecord, record
from skygcs.ext.federation.protocol.order_messages import OrderReply, OrderRequest, Status

# -- The file of orders: appended, bounded, and read again after whatever ended the process.


def made(number: int, status: Status = "running") -> AuditRecord:
    request = OrderRequest(f"{number:032x}", "alpha", "vehicles.land", {}, 10.0, "mia@south", "operator", "r", number)
    return record(request, OrderReply(request.key, status, ""), 9.0)


def test_what_is_written_is_remembered_by_the_next_process(tmp_path: Path) -> None:
    file = AuditFile(tmp_path / "logs" / "orders.jsonl")
    assert file.remembered() == ([], True)
    assert [file.append(made(1)), file.append(made(1, "done")), file.append(made(2))] == [None] * 3
    file.close()
    found, complete = AuditFile(file.path).remembered()
    wanted = [("1", "running", 1), ("1", "done", 1), ("2", "running", 2)]
    assert [(r.reply.key[-1], r.reply.status, r.seq) for r in found] == wanted
    assert complete and stat.S_IMODE(file.path.stat().st_mode) == 0o600


def test_a_line_that_was_torn_spoils_no_other(tmp_path: Path) -> None:
    path = tmp_path / "orders.jsonl"
    file = AuditFile(path)
    file.append(made(1))
    file.append(made(2))
    file.close()
    path.write_bytes(path.read_bytes()[:-40])
    again = AuditFile(path)
    assert again.append(made(3)) is None
    found, _ = again.remembered()
    assert [r.reply.key[-1] for r in found] == ["1", "3"] and again.counters["unreadable"] == 1


def test_two_files_of_bounded_size_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(audit_file, "MAX_FILE_BYTES", 3000)
    file = AuditFile(tmp_path / "orders.jsonl")
    for number in range(50):
        assert file.append(made(number)) is None
    assert sorted(os.listdir(tmp_path)) == ["orders.jsonl", "orders.jsonl.1"]
    assert all((tmp_path / name).stat().st_size <= 3000 for name in os.listdir(tmp_path))
    found, complete = AuditFile(file.path).remembered()
    numbers = [r.seq for r in found]
    assert numbers == list(range(numbers[0], 50)) and len(numbers) > 10 and not complete


def test_what_cannot_be_written_or_read_is_said(tmp_path: Path) -> None:
    (tmp_path / "orders.jsonl").mkdir()
    file = AuditFile(tmp_path / "orders.jsonl")
    assert "orders.jsonl" in str(file.append(made(1))) and file.counters["failed"] == 1
    with pytest.raises(OSError):
        file.remembered()


# -- Recordings that are collected: files in a folder that others may write to.


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


# -- Files with a station's key.


def test_a_new_key_is_readable_by_its_owner_alone_and_signs(tmp_path: Path) -> None:
    path = tmp_path / "north.nk"
    before = os.umask(0)
    try:
        public_key = write_new_seed(path)
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o600
    key = read_seed(path)
    assert key.public_key == public_key and len(public_key) == 56 and public_key.startswith("U")
    assert nkeys.from_seed(bytearray(key.seed.encode())).verify(
        b"x", nkeys.from_seed(bytearray(key.seed, "ascii")).sign(b"x")
    )


def test_a_key_that_is_there_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "north.nk"
    write_new_seed(path)
    text = path.read_text()
    with pytest.raises(KeyFileError, match="is not overwritten"):
        write_new_seed(path)
    assert path.read_text() == text


def test_a_key_that_others_may_read_and_what_is_no_key_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "north.nk"
    with pytest.raises(KeyFileError, match=r"does not exist; make it: skygcs federation keys north"):
        read_seed(path)
    write_new_seed(path)
    path.chmod(0o640)
    with pytest.raises(KeyFileError, match="others can read or change it"):
        read_seed(path)
    path.chmod(0o600)
    seed = path.read_text()
    for wrong in (
        *("", "SUAB", seed[:-5], seed[:20] + ("A" if seed[20] != "A" else "B") + seed[21:], seed * 2, seed.lower()),
        new_key().public_key,
        nkeys.encode_seed(bytes(32), nkeys.PREFIX_BYTE_ACCOUNT).decode(),
    ):
        path.write_text(wrong)
        with pytest.raises(KeyFileError, match="holds no seed of a key") as caught:
            read_seed(path)
        assert len(wrong) < 5 or wrong not in str(caught.value)
    path.unlink()
    os.mkfifo(path, 0o600)
    with pytest.raises(KeyFileError):
        read_seed(path)


@given(data=st.binary(max_size=200))
def test_any_content_is_a_key_or_an_error(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.nk"
    path.write_bytes(data)
    path.chmod(0o600)
    with pytest.raises(KeyFileError):
        read_seed(path)
