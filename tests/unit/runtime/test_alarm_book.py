"""The daemon's alarms as clients see them: fed by events, kept in a file over a restart, logged once."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from skygcs.config.models import AlarmsConfig
from skygcs.disk_writer import DiskWriter
from skygcs.events import Event
from skygcs.runtime.alarm_book import FILE, AlarmBook
from skygcs.runtime.event_log import EventLog
from support.hosts import until


class Bench:
    """A book over a folder, and a vehicle with a battery."""

    def __init__(self, folder: Path) -> None:
        loop = asyncio.get_running_loop()
        self.percent: float | None = 80.0
        self.vehicle: Any = SimpleNamespace(
            name="a", armed=True, connected=True, replayed=False, telemetry=lambda group: {"percent": self.percent}
        )
        self.events = EventLog(loop.time)
        self.disk = DiskWriter(loop, self.events.publish)
        self.told: list[dict[str, Any]] = []
        self.events.subscribe(self.told.append)
        self.book = AlarmBook(AlarmsConfig(), self.events, lambda: [self.vehicle], folder, self.disk)
        self.book.recall()

    def changes(self) -> list[str]:
        return [event["data"]["change"] for event in self.told if event["kind"] == "alarm"]

    async def settled(self, path: Path, there: Callable[[bytes], bool]) -> None:
        """Until what has changed is in the file."""

        def written() -> bool:
            self.book.tick()
            return path.exists() and there(path.read_bytes())

        await until(written)


async def test_alarms_are_shared_acknowledged_by_name_and_known_after_a_restart(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.events.publish(Event("vehicle_lost", "b", 2, "no heartbeat for 3.0 s", {"age_s": 3.0}))
    bench.events.publish(
        Event("command", "a", 1, "stop: denied", {"order": "stop", "ok": False, "message": "denied: x"})
    )
    bench.percent = 0.0
    bench.book.tick()
    bench.book.tick()
    assert [(a["kind"], a["vehicle"], a["severity"]) for a in bench.book.all()] == [
        ("battery", "a", "alarm"),
        ("stop", "a", "alarm"),
        ("lost", "b", "alarm"),
    ]
    assert bench.changes() == ["raised", "raised", "raised"]
    (done,) = bench.book.acknowledge([1], "mia@field")
    assert done["acknowledged_by"] == "mia@field" and bench.changes()[-1] == "acknowledged"
    await bench.settled(tmp_path / FILE, lambda content: b"mia@field" in content)
    bench.book.close()
    # another daemon
    again = Bench(tmp_path)
    assert [(a["kind"], a["acknowledged_by"]) for a in again.book.all()] == [
        ("battery", None),
        ("stop", None),
        ("lost", "mia@field"),
    ]
    again.events.publish(Event("vehicle_back", "b", 2, "back", {}))
    assert [a["kind"] for a in again.book.all()] == ["battery", "stop"] and again.changes() == ["over"]
    again.book.acknowledge(None, "tom")
    again.percent = 90.0
    again.book.tick()
    assert [a["kind"] for a in again.book.all()] == ["stop"], "its condition lasts"
    again.book.close()


async def test_a_broken_file_is_reported_and_a_stuck_or_full_disk_stops_nothing(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b'{"format": 1, "alarms": [{"number": "x"}], "last": 1}')
    bench = Bench(tmp_path)
    assert [event["kind"] for event in bench.told] == ["warning"] and bench.book.all() == []
    (tmp_path / "folder").write_bytes(b"a file where the folder should be")
    stuck = Bench(tmp_path / "folder")
    stuck.events.publish(Event("fault", None, None, "x", {}))
    stuck.book.tick()
    await until(lambda: [event for event in stuck.told if "cannot be written" in event["text"]])
    (tmp_path / "folder").unlink()  # there is room again, and no alarm changes
    for _ in range(2):
        stuck.book.tick()
    await stuck.settled(tmp_path / "folder" / FILE, lambda content: b"fault" in content)
    assert len(stuck.book.all()) == 1
    await until(lambda: stuck.told[-1]["text"].endswith("is written again"))
    bench.book.close()
    stuck.book.close()


async def test_a_recording_raises_no_alarm(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.vehicle.replayed = True
    bench.percent = 0.0
    bench.events.publish(Event("failsafe", "a", 1, "failsafe", {"failsafe": True}))
    bench.book.tick()
    assert bench.book.all() == []
    bench.book.close()


async def test_an_alarm_of_the_recorder_is_over_when_the_daemon_starts_anew(tmp_path: Path) -> None:
    """The next daemon's recorder fails or works by itself; nobody would end the alarm of the last one's."""
    bench = Bench(tmp_path)
    full = Event("recorder", None, None, "recording stopped: No space left on device", {"recording": False})
    bench.events.publish(full)
    bench.events.publish(full)
    bench.events.publish(Event("recorder", None, None, "x.tlog cannot be written", {"error": "x"}))
    assert [(a["kind"], a["severity"], a["active"]) for a in bench.book.all()] == [("recorder", "alarm", True)]
    await bench.settled(tmp_path / FILE, lambda content: b"No space left" in content)
    again = Bench(tmp_path)
    assert [(a["kind"], a["active"]) for a in again.book.all()] == [("recorder", False)]
    again.events.publish(full)
    assert [a["active"] for a in again.book.all()] == [True]
