"""The file of orders: appended, bounded, and read again after whatever ended the process."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from skygcs.ext.federation.bridge import audit_file
from skygcs.ext.federation.bridge.audit_file import AuditFile
from skygcs.ext.federation.protocol.audit import AuditRecord, record
from skygcs.ext.federation.protocol.order_messages import OrderReply, OrderRequest, Status


def made(number: int, status: Status = "running") -> AuditRecord:
    request = OrderRequest(f"{number:032x}", "alpha", "vehicles.land", {}, 10.0, "mia@south", "operator", "r", number)
    return record(request, OrderReply(request.key, status, ""), 9.0)


def test_what_is_written_is_remembered_by_the_next_process(tmp_path: Path) -> None:
    file = AuditFile(tmp_path / "logs" / "orders.jsonl")
    assert file.remembered() == ([], True)
    assert [file.append(made(1)), file.append(made(1, "done")), file.append(made(2))] == [None] * 3
    file.close()
    found, complete = AuditFile(file.path).remembered()
    assert [(r.reply.key[-1], r.reply.status, r.seq) for r in found] == [
        ("1", "running", 1),
        ("1", "done", 1),
        ("2", "running", 2),
    ]
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
