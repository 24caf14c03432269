"""The log never holds its process up: a reader that stopped, one that is gone, a full disk, and no stderr at all."""

from __future__ import annotations

import contextlib
import fcntl
import io
import logging
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import pytest
import structlog

from skygcs.cli.log_limit import LibraryLog, LogLimit
from skygcs.cli.log_stream import MAX_WAITING_BYTES, LogStream
from skygcs.cli.process import configure_logging

LINE = "x" * 999 + "\n"


@pytest.fixture
def pipe() -> Iterator[tuple[int, TextIO]]:
    """One that holds 4 kB."""
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    with os.fdopen(writer, "w") as file:
        yield reader, file


def read_until(reader: int, end: bytes) -> bytes:
    found = b""
    while not found.endswith(end):
        found += os.read(reader, 65536)
    return found


def test_a_reader_that_stopped_delays_nothing_and_what_it_missed_is_counted(pipe: tuple[int, TextIO]) -> None:
    reader, file = pipe
    stream = LogStream(file)
    for _ in range(1000):  # 1 MB: each would wait for ever
        stream.write(LINE)
    assert not stream.drain(0.05)
    found = b""
    os.set_blocking(reader, False)
    while not stream.drain(0.001):
        with contextlib.suppress(BlockingIOError):
            found += os.read(reader, 65536)
    os.set_blocking(reader, True)
    stream.write("later\n")
    found += read_until(reader, b"later\n")
    came, missed = found.count(b"x\n"), sum(map(int, re.findall(rb"\((\d+) lines", found)))
    assert came + missed == 1000 and MAX_WAITING_BYTES // len(LINE) <= came < 1000
    os.close(reader)


def test_a_reader_that_is_gone_and_a_full_disk_raise_nothing(pipe: tuple[int, TextIO]) -> None:
    reader, file = pipe
    os.close(reader)
    with open("/dev/full", "w") as full:
        for stream in (LogStream(file), LogStream(full)):
            stream.write("lost\n")
            assert stream.drain(10.0)


def test_a_disk_that_has_room_again_gets_lines_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open(tmp_path / "log", "w") as file:
        stream = LogStream(file)
        real, full = os.write, True

        def write(descriptor: int, data: bytes) -> int:
            if full:
                raise OSError(28, "No space left on device")
            return real(descriptor, data)

        monkeypatch.setattr(os, "write", write)
        for _ in range(3):
            stream.write("lost\n")
            assert stream.drain(10.0)
        full = False
        stream.write("seen\n")
        assert stream.drain(10.0)
    assert (tmp_path / "log").read_text() == "(3 lines of this log could not be written)\nseen\n"


def test_without_stderr_and_in_memory() -> None:
    LogStream(None).write("nowhere\n")
    memory = io.StringIO()
    LogStream(memory).write("here\n")
    assert memory.getvalue() == "here\n"


def test_both_logs_of_a_process_go_through_it(pipe: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch) -> None:
    """structlog's lines and those of libraries: neither waits for a terminal that stands."""
    reader, file = pipe
    before, handlers = structlog.get_config(), logging.root.handlers[:]
    monkeypatch.setattr(sys, "stderr", file)
    try:
        configure_logging()
        for number in range(300):
            structlog.get_logger("x").warning(f"line {number} {LINE[:100]}")
            logging.getLogger("y").warning(f"library {number} {LINE[:100]}")
        structlog.get_logger("x").error("the last")
        found = read_until(reader, b"the last\n")
        assert b"line 299" in found and b"library 299" in found
        assert isinstance(LibraryLog(LogLimit(), LogStream(None)).stream, LogStream)
    finally:
        structlog.configure(**before)
        logging.root.handlers[:] = handlers
        os.close(reader)
