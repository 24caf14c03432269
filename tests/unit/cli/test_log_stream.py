"""The log never holds its process up: a reader that stopped, one that is gone, a full disk, and no stderr at all."""

from __future__ import annotations

import contextlib
import fcntl
import io
import logging
import os
import re
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import pytest
import structlog

from skygcs.cli import log_stream
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


def test_a_line_is_written_by_its_caller_where_there_is_room(pipe: tuple[int, TextIO]) -> None:
    """An abrupt end must not take it along."""
    reader, file = pipe
    stream = LogStream(file)
    stream.write("said\nand part")
    assert os.read(reader, 100) == b"said\n"
    stream.flush()
    assert os.read(reader, 100) == b"and part"
    assert stream._thread is None
    os.close(reader)


def test_the_flag_of_another_process_loses_nothing(pipe: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch) -> None:
    """All that share the file share O_NONBLOCK: a full pipe is then an error, and not the end of it."""
    reader, file = pipe
    monkeypatch.setattr(log_stream, "_without_waiting", lambda descriptor: None)
    os.set_blocking(file.fileno(), False)
    stream = LogStream(file)
    lines = "".join(f"{number:05d} {LINE[:100]}\n" for number in range(400))
    for line in lines.splitlines(keepends=True):
        stream.write(line)
    assert read_until(reader, lines[-2000:].encode()) == lines.encode()
    os.close(reader)


def test_the_count_stands_where_the_lines_are_missing(pipe: tuple[int, TextIO]) -> None:
    reader, file = pipe
    stream = LogStream(file)
    for number in range(600):
        stream.write(f"{number:05d} {LINE}")
    found = read_until(reader, LINE[-100:].encode())
    while b"missing" not in found:
        stream.write("missing\n")  # after the gap, as soon as there is room
        found += os.read(reader, 65536)
    found += read_until(reader, b"missing\n") if not found.endswith(b"missing\n") else b""
    lines = found.decode().splitlines()
    notes = [at for at, line in enumerate(lines) if "could not" in line]
    assert notes
    lost = 0
    for at, line in enumerate(lines):
        if "could not" in line:
            lost += int(line[1:].split()[0])
        elif line[:5].isdigit():
            assert int(line[:5]) == at - len([note for note in notes if note < at]) + lost
    os.close(reader)


def test_the_end_writes_the_count_that_is_owed(pipe: tuple[int, TextIO]) -> None:
    reader, file = pipe
    stream = LogStream(file)
    for _ in range(600):
        stream.write(LINE)
    found = bytearray()

    def read() -> None:
        while data := os.read(reader, 65536):
            found.extend(data)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    assert stream.drain(60.0)
    end = b" lines of this log could not be written)\n"
    while not found.endswith(end):
        thread.join(0.01)


@pytest.mark.parametrize("at_once", [True, False])
def test_where_no_thread_can_be_started_the_line_is_counted(
    pipe: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch, at_once: bool
) -> None:
    reader, file = pipe
    if not at_once:
        monkeypatch.setattr(log_stream, "_without_waiting", lambda descriptor: None)
    stream, full = LogStream(file), b"z" * 4096
    os.write(file.fileno(), full)

    def start(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", start)
        stream.write("one\n")
        stream.write("two\n")
    assert os.read(reader, 65536) == full
    stream.write("three\n")
    assert read_until(reader, b"three\n") == b"(2 lines of this log could not be written)\nthree\n"
    os.close(reader)


def test_a_line_of_which_a_part_was_written_gets_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open(tmp_path / "log", "w") as file:
        stream, real, room = LogStream(file), os.write, 4

        def write(descriptor: int, data: bytes) -> int:
            nonlocal room
            if not room:
                raise OSError(28, "No space left on device")
            written = real(descriptor, data[:room])
            room -= written
            return written

        monkeypatch.setattr(os, "write", write)
        stream.write("torn apart\n")
        assert stream.drain(10.0)
        room = 1000
        stream.write("seen\n")
        assert stream.drain(10.0)
    assert (tmp_path / "log").read_text() == "torn\n(1 lines of this log could not be written)\nseen\n"


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
