"""The time of a key on disk: whole or not at all, never back, and a fault of the disk is told."""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest

from skygcs.cancellation import ended
from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.signing import MAX_TIMESTAMP, TICKS_PER_S, key_id
from skygcs.disk_writer import DiskWriter
from skygcs.events import Event
from skygcs.runtime import signing_keys
from skygcs.runtime.signing_keys import AFTER_CRASH_S, Signing, SigningStore, default_state_dir
from support.inline_disk import inline_disk

NOW = 37_000_000_000_000


def test_an_exact_time_comes_back_as_it_was(tmp_path: Path) -> None:
    SigningStore(tmp_path / "new").save("ab", NOW, wall=NOW, exact=True)
    store = SigningStore(tmp_path / "new")
    assert store.load("ab").timestamp == NOW
    assert store.load("cd").timestamp == 0
    assert (tmp_path / "new").stat().st_mode & 0o077 == 0
    assert not store.problems


def test_after_a_crash_the_time_is_beyond_what_may_have_been_used(tmp_path: Path) -> None:
    store = SigningStore(tmp_path)
    store.save("ab", NOW, wall=NOW, exact=False)
    assert store.load("ab").timestamp == NOW + AFTER_CRASH_S * TICKS_PER_S
    store.save("ab", MAX_TIMESTAMP, wall=NOW, exact=False)
    assert store.load("ab").timestamp == MAX_TIMESTAMP


@pytest.mark.parametrize("content", ["", "{}", "[]", "7", '{"format": 2, "timestamp": 1, "exact": true}', "\0" * 50])
def test_a_broken_file_is_told_and_is_no_time(tmp_path: Path, content: str) -> None:
    (tmp_path / "ab.json").write_text(content)
    store = SigningStore(tmp_path)
    assert store.load("ab").timestamp == 0
    assert "ab.json cannot be read" in store.problems["ab"]
    store.save("ab", NOW, wall=NOW, exact=True)
    assert (store.load("ab").timestamp, store.problems) == (NOW, {})


def test_a_save_that_fails_leaves_the_old_time_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = SigningStore(tmp_path)
    store.save("ab", NOW, wall=NOW, exact=True)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    store.save("ab", NOW + 5, wall=NOW, exact=True)
    assert "ab.json cannot be written (No space left on device)" in store.problems["ab"]
    assert [p.name for p in tmp_path.iterdir()] == ["ab.json"]
    assert store.load("ab").timestamp == NOW


def test_without_a_folder_nothing_is_kept_and_that_is_told() -> None:
    store = SigningStore(None)
    store.save("ab", NOW, wall=NOW, exact=True)
    assert store.load("ab").timestamp == 0
    assert "no folder" in store.problems[""]


def test_the_folder_is_that_of_the_desktop_standard(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert default_state_dir() == tmp_path / "skygcs" / "signing"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_state_dir() == tmp_path / ".local" / "state" / "skygcs" / "signing"


def test_the_computers_clock_is_kept_and_files_of_before_have_none(tmp_path: Path) -> None:
    store = SigningStore(tmp_path)
    store.save("ab", NOW + 5, wall=NOW, exact=True)
    assert store.load("ab") == (NOW + 5, NOW)
    (tmp_path / "cd.json").write_text(f'{{"format": 1, "timestamp": {NOW}, "exact": true}}')
    assert store.load("cd") == (NOW, 0)


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "5",
        "null",
        '{"format": 1, "timestamp": 1e999, "exact": true}',
        '{"format": 1, "timestamp": 5, "exact": true, "wall": "x"}',
        '{"format": 1, "timestamp": 5, "exact": true, "wall": null}',
        '{"format": 1, "timestamp": {}, "exact": true}',
        "[" * 4000,
    ],
)
def test_a_file_that_is_no_state_is_told_and_not_believed(tmp_path: Path, text: str) -> None:
    (tmp_path / "ab.json").write_text(text)
    store = SigningStore(tmp_path)
    assert store.load("ab") == (0, 0)
    assert "cannot be read" in store.problems["ab"]


def test_times_beyond_the_range_are_brought_into_it(tmp_path: Path) -> None:
    (tmp_path / "ab.json").write_text(f'{{"format": 1, "timestamp": {1 << 60}, "exact": true, "wall": {-1 << 60}}}')
    assert SigningStore(tmp_path).load("ab") == (MAX_TIMESTAMP, 0)


async def test_a_clock_that_cannot_be_read_is_reported_before_it_is_replaced(tmp_path: Path) -> None:
    """The first save, a second later, took the problem with it: nobody learned that the key's time was lost."""
    secret = bytes(32)
    (tmp_path / f"{key_id(secret)}.json").write_text("")
    events: list[Event] = []
    signing = Signing(load_dialect("all"), events.append, SigningStore(tmp_path), lambda: 1.8e9)
    signing.disk = inline_disk(asyncio.get_running_loop())
    signing.key_of(secret)
    task = asyncio.create_task(signing.run())
    await asyncio.sleep(0)
    await ended(task)
    assert ["cannot be read" in event.text for event in events] == [True, False]
    assert events[1].text.endswith("saved again")


@pytest.mark.looptime
async def test_what_a_full_disk_does_to_several_keys_is_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each key's reason took the other's place: two lines for every ten seconds of a full disk."""
    events, wall = list[Event](), [1.8e9]

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    signing = Signing(load_dialect("all"), events.append, SigningStore(tmp_path), lambda: wall[0])
    signing.disk = inline_disk(asyncio.get_running_loop())
    keys = [signing.key_of(bytes([n]) * 32) for n in range(3)]
    task = asyncio.create_task(signing.run())
    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", full)
        for _ in range(100):
            await asyncio.sleep(11.0)
            wall[0] += 11.0
            for key in keys:
                key.clock.stamp(signing._wall())
    assert len(events) == len({event.text for event in events}) == 3
    await ended(task)
    assert [event.text for event in events[3:]] == ["signing: the clocks of the keys are saved again"]


@pytest.mark.looptime
async def test_a_computer_whose_clock_was_a_year_ahead_for_a_while_reports_it_when_that_is_set_back() -> None:
    """Its signatures stay a year ahead; only the next start reported that."""
    wall, events = [1.8e9], list[Event]()
    signing = Signing(load_dialect("all"), events.append, SigningStore(None), lambda: wall[0])
    signing.key_of(bytes(32))
    task = asyncio.create_task(signing.run())
    for step_s in (0.0, 365 * 86400.0, 0.0, -365 * 86400.0, 0.0):
        wall[0] += step_s
        signing.stamp(bytes(32))  # a message is sent
        await asyncio.sleep(15.0)
    await ended(task)
    (event,) = [event for event in events if "ahead_s" in event.data]
    assert "365 days ahead" in event.text and "reset-clock" in event.text


DAY = 86_400 * TICKS_PER_S


@pytest.mark.looptime
async def test_of_two_daemons_with_one_key_the_later_time_counts_whoever_saves_last(tmp_path: Path) -> None:
    """One has followed a vehicle that is most of a day ahead. What the other one saved last made it begin earlier than
    it had signed, and its vehicles refused that."""
    secret, events, wall = bytes(range(32)), list[Event](), [1.8e9]
    running = []
    for _ in range(2):
        signing = Signing(load_dialect("all"), events.append, SigningStore(tmp_path), lambda: wall[0])
        signing.disk = inline_disk(asyncio.get_running_loop())
        signing.key_of(secret)
        running.append((signing, asyncio.create_task(signing.run())))
    (one, of_one), (other, of_other) = running
    one.key_of(secret).clock.advance(ahead := one._wall() + DAY * 9 // 10)
    for _ in range(5):
        wall[0] += 15.0
        await asyncio.sleep(15.0)
        sent = max(one.stamp(secret), ahead)
        other.stamp(secret)
    await ended(of_one)
    await ended(of_other)
    assert SigningStore(tmp_path).load(key_id(secret)).timestamp > sent
    (told, again) = [event.text for event in events]
    assert told == again and f"another skygcs on this computer signs with key {key_id(secret)}" in told
    # a clock that is set back is set back in the file
    events.clear()
    one.reset_clock(key_id(secret))
    await asyncio.sleep(1.0)
    assert SigningStore(tmp_path).load(key_id(secret)).timestamp < ahead


@pytest.mark.parametrize("number", [errno.EWOULDBLOCK, errno.ENOLCK, errno.EBADF])
def test_a_lock_that_cannot_be_had_keeps_no_clock_from_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """A program that was stopped amid a save, whose lock is waited for once, and file systems that have none."""

    def flock(handle: int, kind: int) -> None:
        raise OSError(number, os.strerror(number))

    waits: list[float] = []
    monkeypatch.setattr("fcntl.flock", flock)
    monkeypatch.setattr("time.sleep", waits.append)
    store = SigningStore(tmp_path)
    for stamp in (1, 2, 3):
        store.save("key", stamp, wall=0, exact=True)
        assert store.load("key").timestamp == stamp and not store.problems
    assert sum(waits) < signing_keys.LOCK_TRIES * signing_keys.LOCK_EVERY_S
    assert not store.shared


async def test_at_the_end_every_clock_is_saved_however_often_the_task_is_cancelled(tmp_path: Path) -> None:
    class Disk:
        """One that takes a turn of the loop for each job."""

        async def run(self, _what: str, job: Callable[[], None], within_s: float) -> None:
            await asyncio.sleep(0)
            job()

    store = SigningStore(tmp_path)
    signing = Signing(load_dialect("all"), lambda event: None, store, lambda: 1.8e9)
    signing.disk = cast(DiskWriter, Disk())
    keys = [signing.key_of(bytes([number]) * 32) for number in range(3)]
    task = asyncio.create_task(signing.run())
    await asyncio.sleep(0)
    while not task.done():
        task.cancel()
        await asyncio.sleep(0)
    assert task.cancelled()
    assert [store.load(key.id).timestamp for key in keys] == [key.clock.timestamp for key in keys]
    assert all(key.clock.timestamp for key in keys)
