"""The recorder: whole records in files that rotate, and a disk that fails in every way."""

from __future__ import annotations

import asyncio
import errno
import io
import os
import shutil
import stat
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from skygcs.events import Event
from skygcs.runtime.recorder import Recorder
from skygcs.tlog.format import LogEntry, encode_record
from skygcs.tlog.reading import LogReader
from support.frames import dialect, heartbeat

T0 = 1_700_000_000_000_000
"""2023-11-14 22:13:20 UTC"""


class Disk:
    """Files that fail on request. ``room`` is how many bytes still fit; None is enough for all."""

    def __init__(self) -> None:
        self.room: int | None = None
        self.refuse_open: OSError | None = None
        self.refuse_truncate = False
        self.fault = errno.ENOSPC
        self.hold = threading.Event()
        self.hold.set()
        self.opened: list[Path] = []

    def open(self, path: Path) -> io.FileIO:
        if self.refuse_open is not None:
            raise self.refuse_open
        self.opened.append(path)
        return _File(path, self)


class _File(io.FileIO):
    def __init__(self, path: Path, disk: Disk) -> None:
        super().__init__(path, "xb")
        self._disk = disk

    def write(self, data: bytes | memoryview) -> int:  # type: ignore[override]
        disk = self._disk
        disk.hold.wait(20)
        if disk.room is None:
            return super().write(data)
        if not disk.room:
            raise OSError(disk.fault, "No space left on device")
        written = super().write(data[: disk.room])
        disk.room -= written
        return written

    def truncate(self, size: int | None = None) -> int:
        if self._disk.refuse_truncate:
            raise OSError(errno.EIO, "Input/output error")
        return super().truncate(size)


class Bench:
    """A recorder at work, and what became of it."""

    def __init__(
        self, folder: Path, *, max_bytes: int = 1_000_000, max_age_s: float = 3600.0, max_buffer_bytes: int = 1 << 20
    ) -> None:
        self.folder = folder
        self.disk = Disk()
        self.events: list[Event] = []
        self.count = 0
        self.recorder = Recorder(
            folder,
            max_bytes=max_bytes,
            max_age_s=max_age_s,
            on_event=self.events.append,
            open_file=self.disk.open,
            max_buffer_bytes=max_buffer_bytes,
        )

    def offer(self, count: int = 1) -> None:
        for _ in range(count):
            self.recorder.offer(heartbeat(1 + self.count % 200, seq=self.count & 0xFF), T0 + self.count * 1000)
            self.count += 1

    def files(self) -> list[Path]:
        return sorted(self.folder.glob("*"))

    def records(self) -> list[LogEntry]:
        """Of all files, each without a broken record but at its very end."""
        found = []
        for path in self.files():
            data = path.read_bytes()
            reader = LogReader(data, dialect())
            records = list(reader)
            assert all(r.verdict == "ok" for r in records)
            assert sum(8 + len(r.raw) for r in records) == (records[-1].offset + 8 + len(records[-1].raw))
            found += records
        return found

    def times(self) -> list[int]:
        return [(r.unix_us - T0) // 1000 for r in self.records()]

    async def until(self, condition: Callable[[], bool]) -> None:
        for _ in range(2000):
            if condition():
                return
            await asyncio.sleep(0.01)
        raise AssertionError(f"never came about: {self.recorder.status()}, {self.events}")


@asynccontextmanager
async def at_work(bench: Bench) -> AsyncIterator[Bench]:
    task = asyncio.create_task(bench.recorder.run())
    try:
        yield bench
    finally:
        bench.disk.hold.set()
        task.cancel()
        await bench.recorder.close()


async def test_records_are_in_the_file_within_a_second_without_closing_it(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path)) as bench:
        bench.offer(3)
        await bench.until(lambda: bool(bench.files()) and bench.files()[0].stat().st_size == 3 * 29)
        assert bench.times() == [0, 1, 2]
        bench.offer()
        await bench.until(lambda: bench.recorder.status()["records"] == 4)
    assert bench.times() == [0, 1, 2, 3]
    assert bench.events == []


@pytest.mark.looptime
async def test_a_record_waits_a_quarter_of_a_second_at_most(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path)) as bench:
        bench.offer()
        await asyncio.sleep(0.3)
        await bench.until(lambda: bench.recorder.status()["records"] == 1)
        assert asyncio.get_running_loop().time() < 0.5


async def test_closing_writes_what_waits(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path)) as bench:
        bench.offer(1000)
    assert bench.times() == list(range(1000))
    status = bench.recorder.status()
    assert (status["state"], status["records"], status["lost_records"], status["buffered_bytes"]) == (
        "closed",
        1000,
        0,
        0,
    )
    await bench.recorder.close()


async def test_a_tlog_and_its_folder_are_nobody_elses_to_read(tmp_path: Path) -> None:
    """Outside of systemd, whose UMask takes it, everybody could read them."""
    before = os.umask(0)
    try:
        bench = Bench(tmp_path / "logs")  # with a file of its own, as in the daemon
        bench.recorder = Recorder(bench.folder, max_bytes=1_000_000, max_age_s=3600.0, on_event=bench.events.append)
        async with at_work(bench):
            bench.offer()
            await bench.recorder.close()
    finally:
        os.umask(before)
    (file,) = (tmp_path / "logs").iterdir()
    assert stat.S_IMODE(file.stat().st_mode) == 0o640 and not (tmp_path / "logs").stat().st_mode & 0o007


async def test_nothing_offered_leaves_no_file(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path / "logs")):
        await asyncio.sleep(0)
    assert not (tmp_path / "logs").exists()


async def test_a_new_file_by_size_named_by_the_time_of_its_first_record(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path, max_bytes=2900)) as bench:
        for _ in range(40):
            bench.offer(25)
            await asyncio.sleep(0)
    assert bench.times() == list(range(1000))
    sizes = [path.stat().st_size for path in bench.files()]
    assert max(sizes) <= 2900 and len(sizes) >= 10
    names = [path.name for path in bench.files()]
    assert names[0] == "20231114T221320Z-0001.tlog"
    assert names == [p.name for p in bench.disk.opened]  # they sort in the order of writing
    assert all(name.endswith(f"Z-{n:04d}.tlog") for n, name in enumerate(names, start=1))


@pytest.mark.looptime
async def test_a_new_file_by_age(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path, max_age_s=60.0)) as bench:
        for _ in range(5):
            bench.offer()
            await bench.until(lambda: bench.recorder.status()["records"] == bench.count)
            await asyncio.sleep(25)
    assert [len(path.read_bytes()) // 29 for path in bench.files()] == [3, 2]


async def test_files_of_an_earlier_run_are_never_overwritten(tmp_path: Path) -> None:
    for _ in range(3):
        async with at_work(Bench(tmp_path)) as bench:
            bench.offer(2)
    assert [path.name[-9:] for path in bench.files()] == ["0001.tlog", "0002.tlog", "0003.tlog"]
    assert bench.times() == [0, 1] * 3


async def test_a_full_disk_is_one_warning_and_one_event_when_it_is_over(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path, max_buffer_bytes=29 * 50)) as bench:
        bench.offer(10)
        await bench.until(lambda: bench.recorder.status()["records"] == 10)
        bench.disk.room = 29 * 3 + 11  # the next piece fits partly, and ends in the middle of a record
        bench.offer(20)
        await bench.until(lambda: bench.recorder.status()["state"] == "failing")
        assert bench.times() == list(range(10))  # nothing of the piece that did not fit whole
        assert bench.files()[0].stat().st_size == 290
        bench.disk.room = 0
        bench.offer(100)  # 30 of them fit in memory
        bench.disk.room = None
        await bench.until(lambda: bench.recorder.status()["state"] == "recording")
        bench.offer(5)
    assert bench.times() == [*range(60), *range(130, 135)]
    assert [e.kind for e in bench.events] == ["recorder", "recorder"]
    assert "No space left" in bench.events[0].text
    assert "70 records lost" in bench.events[1].text and bench.events[1].data["lost"] == 70
    assert bench.recorder.status()["lost_records"] == 70
    assert len(bench.files()) == 1


@pytest.mark.looptime
async def test_a_disk_that_stays_full_is_told_once_and_tried_ever_more_rarely(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path)) as bench:
        bench.disk.room = 0
        bench.offer(3)
        await asyncio.sleep(600)
        attempts = len(bench.disk.opened)
        assert 30 < attempts < 80
        assert bench.files() == []  # no empty file left behind by any of them
        bench.disk.room = None
        await asyncio.sleep(15)
        await bench.until(lambda: bench.recorder.status()["records"] == 3)
    assert len(bench.events) == 2
    assert bench.times() == [0, 1, 2]


@pytest.mark.looptime
async def test_a_file_that_can_not_be_cut_back_is_left_and_a_new_one_is_begun(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path)) as bench:
        bench.offer(2)
        await bench.until(lambda: bench.recorder.status()["records"] == 2)
        bench.disk.refuse_truncate, bench.disk.room, bench.disk.fault = True, 40, errno.EIO
        bench.offer(3)
        await bench.until(lambda: bench.recorder.status()["state"] == "failing")
        bench.disk.room = None
        await asyncio.sleep(5)
        await bench.until(lambda: bench.recorder.status()["records"] == 5)
    assert len(bench.files()) == 2
    assert bench.times() == [0, 1, 2, 2, 3, 4]  # one was written twice, none was lost, both files are readable
    assert bench.recorder.status()["lost_records"] == 0


@pytest.mark.looptime
async def test_a_removed_folder_is_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "logs"
    async with at_work(Bench(folder)) as bench:
        bench.offer(2)
        await bench.until(lambda: bench.recorder.status()["records"] == 2)
        shutil.rmtree(tmp_path / "a")
        bench.offer(2)
        await bench.until(lambda: bench.recorder.status()["records"] == 4)
    assert bench.times() == [2, 3]
    assert bench.events == []


@pytest.mark.looptime
async def test_a_folder_that_can_not_be_made_is_a_fault_until_it_can(tmp_path: Path) -> None:
    (tmp_path / "logs").write_text("a file in the way")
    async with at_work(Bench(tmp_path / "logs")) as bench:
        bench.offer(2)
        await bench.until(lambda: bench.recorder.status()["state"] == "failing")
        assert "File exists" in bench.events[0].text
        (tmp_path / "logs").unlink()
        await asyncio.sleep(15)
        await bench.until(lambda: bench.recorder.status()["records"] == 2)
    assert bench.times() == [0, 1]


async def test_a_stuck_disk_never_blocks_the_loop_and_memory_is_bounded(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path, max_buffer_bytes=29 * 1000)) as bench:
        bench.disk.hold.clear()
        bench.offer(500)
        await bench.until(lambda: bool(bench.disk.opened))  # the writer thread hangs in its write from now on
        begun = time.process_time()
        bench.offer(5000)
        assert time.process_time() - begun < 5.0  # it did not wait for the disk: that would be 20 s
        status = bench.recorder.status()
        assert status["buffered_bytes"] <= 29 * 1000
        assert status["lost_records"] == 4500
        assert len(bench.events) == 1 and "too slow" in bench.events[0].text
        bench.disk.hold.set()
        await bench.until(lambda: bench.recorder.status()["state"] == "recording")
    assert bench.times() == list(range(1000))
    assert bench.events[1].data["lost"] == 4500


@pytest.mark.looptime
async def test_closing_on_a_full_disk_ends_and_says_what_is_lost(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path)) as bench:
        bench.disk.room = 0
        bench.offer(7)
        await bench.until(lambda: bool(bench.events))
    assert "7 records unwritten" in bench.events[-1].text
    assert bench.recorder.status()["lost_records"] == 7


async def test_an_error_nobody_thought_of_is_a_fault_too(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    def broken(path: Path) -> io.FileIO:
        raise RuntimeError("surprise")

    bench.recorder._files._open_file = broken
    async with at_work(bench):
        bench.offer(1)
        await bench.until(lambda: bench.recorder.status()["error"] == "surprise")


async def test_a_time_before_1970_is_dropped_and_counted(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path)) as bench:
        bench.recorder.offer(heartbeat(1), -5)
        bench.offer(1)
    assert bench.times() == [0]
    assert bench.recorder.status()["lost_records"] == 1


async def test_the_time_never_goes_backwards_unless_the_clock_was_set(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path)) as bench:
        for unix_us in (T0, T0 + 500, T0 + 100, T0 + 600):  # an answer of ours between two frames of one datagram
            bench.recorder.offer(heartbeat(1), unix_us)
        bench.recorder.offer_many(encode_record(T0 + 700, heartbeat(1)) + encode_record(T0 + 700, heartbeat(2)), 2)
        bench.recorder.offer(heartbeat(1), T0 + 650)
        bench.recorder.offer(heartbeat(1), T0 - 3_600_000_000)
        bench.recorder.offer(heartbeat(1), T0 - 3_599_999_000)
        await bench.recorder.close()
        assert [r.unix_us - T0 for r in bench.records()] == [
            *(0, 500, 500, 600, 700, 700, 700, -3_600_000_000, -3_599_999_000)
        ]


async def test_offers_after_the_end_are_counted_only(tmp_path: Path) -> None:
    async with at_work(Bench(tmp_path)) as bench:
        bench.offer(1)
    bench.offer(3)
    assert bench.times() == [0]
    assert bench.recorder.status()["lost_records"] == 3
    assert bench.events == []
