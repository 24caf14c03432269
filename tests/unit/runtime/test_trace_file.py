"""The trace on disk: whole rows, nobody's file overwritten, and errors that the caller can give it up for."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.core.control.cascade import Estimate, Memory, Reference, step
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.trace import TraceHead, TraceRow, decode, rerun
from skygcs.runtime import trace_file
from skygcs.runtime.trace_file import TraceFile

HEAD = TraceHead("alpha", 47.4, 8.5, 488.0)
LAW = ControlConfig()


def written(trace: TraceFile, count: int, first_s: float = 0.0) -> None:
    memory = Memory()
    for i in range(count):
        estimate, reference = Estimate((0.1 * i, 0.0, 0.0), (1.0, 0.0, 0.0)), Reference((5.0, 0.0, 1.0))
        row = TraceRow(first_s + 0.02 * i, 0.02, "attitude", True, reference, estimate, 0.01)
        output, after = step(LAW, memory, estimate, reference, 0.02, following=True)
        trace.write(trace.encode(row.with_output(output, after), LAW, memory, after))
        memory = after


def test_what_was_written_can_be_run_again_bit_for_bit(tmp_path: Path) -> None:
    trace = TraceFile(tmp_path / "logs" / "deep", HEAD)
    written(trace, 120)
    trace.close()
    with trace.path.open(encoding="ascii", newline="") as lines:
        read = decode(lines)
        assert read.head == HEAD
        entries = list(read)
    assert len(entries) == 120 and list(rerun(entries)) == []


def test_two_of_one_second_are_two_files_named_after_the_vehicle(tmp_path: Path) -> None:
    head = TraceHead("../quad nr.1", 47.4, 8.5, 488.0)
    traces = [TraceFile(tmp_path, head) for _ in range(3)]
    for trace in traces:
        written(trace, 1)
    assert len({trace.path for trace in traces}) == 3
    for trace in traces:
        assert trace.path.parent == tmp_path and trace.path.name.startswith("control-___quad_nr_1-2")
        trace.close()


def test_a_crash_loses_no_more_than_a_second(tmp_path: Path) -> None:
    trace = TraceFile(tmp_path, HEAD)
    written(trace, 51, first_s=1000.0)
    rows = [line for line in trace.path.read_text().splitlines() if line.startswith("10")]
    assert len(rows) == 51  # the row of 1001.0 was flushed with all before it
    trace.close()


def test_it_ends_at_its_largest_size_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trace_file, "LARGEST_BYTES", 5_000)
    trace = TraceFile(tmp_path, HEAD)
    with pytest.raises(OSError, match="has reached"):
        written(trace, 200)
    trace.close()
    assert trace.path.stat().st_size <= 5_000


def test_a_disk_that_cannot_be_written_is_an_oserror(tmp_path: Path) -> None:
    (tmp_path / "logs").write_text("a file, no folder")
    with pytest.raises(OSError):
        written(TraceFile(tmp_path / "logs", HEAD), 1)
