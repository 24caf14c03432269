"""The journal of what flies: what a daemon that begins anew reads, whatever became of the file."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from skygcs.core.vehicle.flight_note import FlightNote
from skygcs.disk_writer import DiskWriter
from skygcs.events import Event
from skygcs.runtime import flight_notes
from skygcs.runtime.flight_notes import FILE, FORMAT, PERIOD_S, FlightJournal
from skygcs.runtime.vehicle_services import MAX_VEHICLES
from support.inline_disk import inline_disk

NOTE = FlightNote(1, 1, "alpha", True, "this station's setpoints", ((1.5, b"\xfd\x00"),), 246.0, 40.0)


def journal(
    folder: Path, events: list[Event] | None = None, clock: Callable[[], float] = time.monotonic
) -> FlightJournal:
    on_event = ([] if events is None else events).append
    return FlightJournal(folder, DiskWriter(asyncio.get_running_loop(), on_event), on_event, clock)


async def written(made: FlightJournal, *notes: FlightNote) -> None:
    made.note(notes, (len(notes),), 0.0)
    await made._disk.close()


async def test_what_was_noted_is_recalled(tmp_path: Path) -> None:
    await written(journal(tmp_path / "new"), NOTE)
    again = journal(tmp_path / "new")
    (found,) = again.recall()
    ((at, raw),) = found.frames
    assert replace(found, frames=NOTE.frames) == NOTE and not again.unreadable
    assert raw == NOTE.frames[0][1] and at == pytest.approx(NOTE.frames[0][0], abs=1.0)  # the wall clock is read twice


async def test_without_a_file_nothing_is_recalled_and_nothing_is_wrong(tmp_path: Path) -> None:
    events: list[Event] = []
    made = journal(tmp_path, events)
    assert made.recall() == [] and not made.unreadable and not events


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"[]",
        b"null",
        json.dumps({"format": FORMAT + 1, "notes": []}).encode(),
        json.dumps({"format": FORMAT}).encode(),
        json.dumps({"format": FORMAT, "notes": [{}]}).encode(),
        json.dumps({"format": FORMAT, "notes": [{**NOTE.as_json(), "sysid": 999}]}).encode(),
        json.dumps({"format": FORMAT, "notes": [{**NOTE.as_json(), "frames": [["x", "fd"]]}]}).encode(),
        json.dumps({"format": FORMAT, "notes": [{**NOTE.as_json(), "frames": [[1.0, 7]]}]}).encode(),
        json.dumps({"format": FORMAT, "notes": [{**NOTE.as_json(), "flown_s": 1e400}]}).encode(),
        b"[" * 100_000,
    ],
)
async def test_a_file_that_cannot_be_read_is_reported_and_remembered(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FILE).write_bytes(content)
    events: list[Event] = []
    made = journal(tmp_path, events)
    assert made.recall() == [] and made.unreadable
    (event,) = events
    assert str(tmp_path / FILE) in event.text and "ordered to hold" in event.text


async def test_more_notes_than_vehicles_are_left_out(tmp_path: Path) -> None:
    notes = [NOTE.as_json()] * (MAX_VEHICLES + 50)
    (tmp_path / FILE).write_text(json.dumps({"format": FORMAT, "notes": notes}))
    assert len(journal(tmp_path).recall()) == MAX_VEHICLES


async def test_a_disk_that_is_full_leaves_no_old_note_to_be_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    await written(journal(tmp_path), NOTE)

    monkeypatch.setattr(flight_notes, "write_whole", _full)
    events: list[Event] = []
    made = journal(tmp_path, events)
    made.note([], (), 0.0)
    await made._disk.close()
    assert "cannot be written" in events[0].text
    again = journal(tmp_path)
    assert again.recall() == [] and again.unreadable


async def test_what_a_full_disk_did_not_take_is_written_when_there_is_room_also_on_the_ground(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the landing nothing changed any more: the file said for ever that it is out of date."""
    events: list[Event] = []
    loop = asyncio.get_running_loop()
    made = FlightJournal(tmp_path, inline_disk(loop), events.append, time.monotonic)
    with monkeypatch.context() as full:
        full.setattr(flight_notes, "write_whole", _full)
        for now in (0.0, PERIOD_S, 2 * PERIOD_S):
            assert made.due(("landed",), now, flying=False)
            made.note([], ("landed",), now)
            await made._disk.settled()
            assert not made.due(("landed",), now + 0.1, flying=False)
    assert made.due(("landed",), 3 * PERIOD_S, flying=False)
    made.note([], ("landed",), 3 * PERIOD_S)
    await made._disk.settled()
    assert not made.due(("landed",), 99.0, flying=False)
    assert [event.text.rpartition(FILE)[2][:21] for event in events] == [" cannot be written: [", " is written again"]
    assert journal(tmp_path).recall() == []


def _full(*_: object, **__: object) -> None:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize(("boot", "moved_s"), [("of this start", 0.0), ("of another start", 7200.0)])
async def test_a_wall_clock_that_was_set_makes_no_note_of_the_same_start_older(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, boot: str, moved_s: float
) -> None:
    """A step of two hours forward between the last note and a restart: the flight was forgotten."""
    monkeypatch.setattr(flight_notes, "boot_id", lambda: "of this start")
    wall = [1_700_000_000.0]
    monkeypatch.setattr(flight_notes, "time", SimpleNamespace(time=lambda: wall[0]))
    at = wall[0] - 3.0
    await written(journal(tmp_path, clock=lambda: 500.0), replace(NOTE, frames=((at, b"\xfd\x00"),)))
    wall[0] += 7200.0 + 5.0
    monkeypatch.setattr(flight_notes, "boot_id", lambda: boot)
    ((heard_at, _),) = journal(tmp_path, clock=lambda: 505.0).recall()[0].frames
    assert wall[0] - heard_at == pytest.approx(8.0 + moved_s)


@pytest.mark.parametrize("more", [{}, {"boot_id": "", "unix_less_boot_s": 0.0}, {"boot_id": 7, "unix_less_boot_s": []}])
async def test_a_journal_that_does_not_say_its_start_is_read_by_the_wall_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: dict[str, object]
) -> None:
    monkeypatch.setattr(flight_notes, "boot_id", lambda: "")
    (tmp_path / FILE).write_text(json.dumps({"format": FORMAT, "notes": [NOTE.as_json()], **more}))
    assert journal(tmp_path).recall() == [NOTE]
