"""Files that the daemon keeps for its next start: whatever stands in their place, reading them does not block, and a
damaged file is reported and left out."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from skygcs.config.models import AlarmsConfig
from skygcs.core.vehicle.flight_note import FlightNote
from skygcs.runtime import alarm_book, flight_notes
from skygcs.runtime.alarm_book import AlarmBook
from skygcs.runtime.event_log import EventLog
from skygcs.runtime.flight_notes import FlightJournal
from skygcs.runtime.param_cache import CacheKey, ParamCache
from skygcs.runtime.signing_keys import SigningStore
from skygcs.runtime.undo_journal import UndoJournal
from support.inline_disk import inline_disk

KEY = CacheKey("px4", 3, 1, "00ff", "1.16.0")


def flights(folder: Path) -> str:
    told: list[str] = []
    disk = inline_disk(asyncio.get_running_loop())
    FlightJournal(folder, disk, lambda event: told.append(event.text), lambda: 1.0).recall()
    return told[0]


def alarms(folder: Path) -> str:
    told: list[str] = []
    events = EventLog(lambda: 0.0)
    events.subscribe(lambda event: told.append(event["text"]))
    AlarmBook(AlarmsConfig(), events, list, folder, inline_disk(asyncio.get_running_loop())).recall()
    return told[0]


def undo(folder: Path) -> str:
    journal = UndoJournal(folder)
    assert journal.left() == []
    return journal.problems[0]


def signing(folder: Path) -> str:
    store = SigningStore(folder)
    assert store.load("ab") == (0, 0)
    return store.problems["ab"]


def parameters(folder: Path) -> str:
    assert ParamCache(folder).load(KEY) is None
    return "cannot be read"  # and is not reported: it is read from the vehicle again


@pytest.mark.parametrize(
    "content",
    [None, b"", b"\0" * 4096, b"[" * 60_000, b'{"format":' + b"9" * 5_000, b'{"format": 1e999}', b"[1]", b"\xff\xfe"],
    ids=lambda content: "a pipe" if content is None else str(content[:12]),
)
@pytest.mark.parametrize(
    ("name", "read"),
    [
        (flight_notes.FILE, flights),
        (alarm_book.FILE, alarms),
        ("7-x.json", undo),
        ("ab.json", signing),
        ("px4-3-1-00ff.json", parameters),
    ],
)
async def test_a_damaged_file_is_reported_and_is_none(
    tmp_path: Path, name: str, read: Callable[[Path], str], content: bytes | None
) -> None:
    if content is None:
        os.mkfifo(tmp_path / name)
    else:
        (tmp_path / name).write_bytes(content)
    assert "cannot be read" in read(tmp_path)


async def test_a_number_beyond_every_integer_is_no_note_of_a_flight(tmp_path: Path) -> None:
    note = FlightNote(1, 1, "alpha", True, None, ()).as_json()
    text = f'{{"format": {flight_notes.FORMAT}, "notes": [{note}]}}'.replace("'", '"').replace("None", "null")
    (tmp_path / flight_notes.FILE).write_text(text.lower().replace('"sysid": 1', '"sysid": 1e999'))
    assert "cannot be read" in flights(tmp_path)
