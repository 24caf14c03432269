"""Files beside the loop: a disk that is stuck stops nothing, is reported once, and does not grow memory."""

from __future__ import annotations

import ast
import asyncio
import errno
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any
from unittest import mock

import pytest

from skygcs import disk_writer
from skygcs.disk_writer import MAX_JOBS, DiskWriter
from skygcs.events import Event
from support.process import ROOT
from support.source_trees import SRC, source_files, tree_of

ON_THE_LOOP = {
    "src/skygcs/runtime/alarm_book.py": "`_write` is given to `DiskWriter.offer`",
    "src/skygcs/runtime/undo_journal.py": "called by `DiskWriter.run`",
    "src/skygcs/runtime/fence_orders.py": "`_write` is given to `DiskWriter.run`",
    "src/skygcs/runtime/flight_notes.py": "`_write` is given to `DiskWriter.offer`",
    "src/skygcs/runtime/param_cache.py": "`_store` and `_touch` are given to `DiskWriter.offer`",
    "src/skygcs/runtime/signing_keys.py": "`SigningStore.save` is given to `DiskWriter`",
    "src/skygcs/runtime/trace_file.py": "`TraceFile.write` is given to `DiskWriter.offer`",
    "src/skygcs/ext/onboard_logs/vehicle_logs.py": "`_File` works in a thread of its own",
    "src/skygcs/runtime/recorder.py": "`TlogFiles` works in a thread of its own",
    "src/skygcs/ext/federation/bridge/audit_file.py": "`AuditFile.append` is given to `DiskWriter`",
    "src/skygcs/ext/federation/bridge/hub_process.py": "before the hub's server is started",
    "src/skygcs/ext/federation/program.py": "a command writes the configuration of a hub",
    "src/skygcs/ext/federation/bridge/logs.py": "`LogCollector` is a command's, in its own process",
    "src/skygcs/ext/federation/bridge/nkeys_files.py": "a command makes a key",
}
"""Modules of the running daemon and of the bridge that write files, and why not on the loop."""

EXTENSIONS = {"ext/federation", "ext/fence", "ext/missions", "ext/onboard_logs"}
"""Those that write files while vehicles fly."""

WRITES = {
    "write_whole",
    "write_text",
    "write_bytes",
    "mkdir",
    "unlink",
    "fsync",
    "utime",
    "open_new",
    "make_log_folder",
}


class Stuck:
    """A disk that takes nothing until it is let go."""

    def __init__(self) -> None:
        self.let_go = threading.Event()
        self.done: list[int] = []

    def write(self, number: int) -> int:
        self.let_go.wait(30)
        self.done.append(number)
        return number


async def until(condition: Any) -> None:
    async with asyncio.timeout(20):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


async def test_a_stuck_disk_is_reported_once_and_drops_what_is_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk_writer, "STUCK_S", 0.02)
    events: list[Event] = []
    now = [0.0]
    disk, stuck = DiskWriter(asyncio.get_running_loop(), events.append, lambda: now[0]), Stuck()
    try:
        for number in range(MAX_JOBS + 100):
            disk.offer("a trace", lambda number=number: stuck.write(number), 10)
        assert disk.status()["dropped"] == 100
        now[0] = 1.0
        with pytest.raises(OSError, match="too much waits") as refused:
            await disk.run("the undo journal", lambda: stuck.write(-1))
        assert refused.value.errno == errno.EBUSY
        await until(lambda: events)
        await asyncio.sleep(0.1)
        assert [event.text for event in events] == [
            "the disk is stuck: a trace is not written; everything else goes on"
        ]
        stuck.let_go.set()
        await until(lambda: disk.status()["waiting"] == 0)
        assert stuck.done == list(range(MAX_JOBS))
        assert [event.kind for event in events] == ["warning", "warning"] and "takes files again" in events[1].text
        assert await disk.run("the undo journal", lambda: stuck.write(7)) == 7
    finally:
        stuck.let_go.set()
        await disk.close()


class SteppedLoop:
    """A loop at a clock that the test sets; its one timer rings when the test says so, and no job ever ends."""

    def __init__(self) -> None:
        self.now = 100.0
        self.ring: Callable[[], None] = print
        self.due = 0.0

    def time(self) -> float:
        return self.now

    def call_later(self, delay_s: float, ring: Callable[[], None]) -> mock.Mock:
        self.ring, self.due = ring, self.now + delay_s
        return mock.Mock()

    def run_in_executor(self, *_: object) -> asyncio.Future[None]:
        return asyncio.get_running_loop().create_future()

    def go_on(self, late_s: float = 0.0) -> None:
        self.now = self.due + late_s
        self.ring()


async def test_a_process_that_stood_still_takes_no_disk_for_stuck() -> None:
    events: list[Event] = []
    loop: Any = SteppedLoop()
    disk = DiskWriter(loop, events.append, loop.time, mock.Mock())
    disk.offer("a trace", print)
    loop.go_on(late_s=60.0)
    assert not events and not disk.status()["stuck"]
    loop.go_on(late_s=0.01)
    assert [event.text for event in events] == ["the disk is stuck: a trace is not written; everything else goes on"]
    loop.go_on(late_s=60.0)
    assert disk.status()["stuck"] and len(events) == 1


async def test_what_waits_for_the_disk_before_an_order_gives_up_in_time_and_the_end_waits_briefly(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(disk_writer, "CLOSE_S", 0.05)
    events: list[Event] = []
    disk, stuck = DiskWriter(asyncio.get_running_loop(), events.append), Stuck()
    with pytest.raises(OSError, match="does not accept it"):
        await disk.run("the undo journal", lambda: stuck.write(1), within_s=0.05)
    await disk.close()
    assert "unwritten, as the disk is stuck: the undo journal" in events[-1].text
    assert disk.offer("a trace", lambda: stuck.write(2)) is None
    stuck.let_go.set()


def test_a_write_that_never_returns_does_not_keep_the_process() -> None:
    """Threads of `concurrent.futures` and of asyncio are joined when the interpreter ends."""
    program = """
import asyncio, threading
from skygcs.disk_writer import DiskWriter
async def main():
    disk = DiskWriter(asyncio.get_running_loop(), print)
    disk.offer("a file", threading.Event().wait)
    await asyncio.sleep(0.1)
asyncio.run(main())
"""
    assert subprocess.run([sys.executable, "-c", program], timeout=60, check=False).returncode == 0


def test_no_module_of_the_running_daemon_or_bridge_writes_a_file_on_the_loop() -> None:
    found = set()
    for path in source_files():
        parts = path.relative_to(SRC).parts
        if parts[0] not in ("runtime", "links", "core", "planning") and "/".join(parts[:2]) not in EXTENSIONS:
            continue
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Call):
                called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                if called in WRITES:
                    found.add(str(path.relative_to(ROOT)))
    assert found == set(ON_THE_LOOP)
