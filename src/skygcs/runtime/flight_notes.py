"""Notes of what flies, and their journal on disk.

`FlightNotes` has all vehicles' flights, with who flew each, and the consumption of their batteries for the next plan.
Notes of vehicles in flight are taken back by a daemon that begins anew, or when this computer has slept.

`FlightJournal` keeps them for the daemon that begins after this one was killed: one small file in `log_dir`. It is
written beside the loop (`DiskWriter`), at changes of state and every `PERIOD_S` while a vehicle is in the air; while
the disk is stuck only the newest content waits for it.

Times in it are Unix time. Beside them stand the id of this start of the computer, and how far Unix time was ahead of
the clock of that start: a wall clock that was set meanwhile (by NTP, or by a person) makes no note of the same start
older or newer.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from skygcs.config.files import boot_id, make_log_folder, read_state, write_whole
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.vehicle.flight_evidence import MAYBE_FLYING_S, may_fly
from skygcs.core.vehicle.flight_note import KEPT_MESSAGES, FlightNote, FlightRecord, lost_place
from skygcs.disk_writer import DiskWriter
from skygcs.events import Event
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import MAX_VEHICLES, OnEvent
from skygcs.spelling import is_number

# --- journal ----------------------------------------------------------------------------------------------------------

FORMAT = 2

FILE = "flights.json"

OUT_OF_DATE = b"out of date: the disk did not take the newest notes\n"
"""Written over the begin of a file that could not be replaced."""

PERIOD_S = 2.0
"""Between two notes of places; what a vehicle does in that time is within the space that a lost one is given."""

MAX_BYTES = 1_000_000
"""Notes of 1 kB for `MAX_VEHICLES`, and some room."""


class FlightJournal:
    """`recall` once, at the start; then `note` a few times a second."""

    def __init__(
        self, folder: Path, disk: DiskWriter, on_event: Callable[[Event], None], clock: Callable[[], float]
    ) -> None:
        """``clock``: `loop_clock.boot_clock`."""
        self._path = folder / FILE
        self._disk = disk
        self._on_event = on_event
        self._states: tuple[Any, ...] = ()
        self._noted_at = -PERIOD_S
        self._writing = False
        self._waiting: bytes | None = None
        self._failed = False
        self._clock = clock
        self._boot_id = boot_id()
        self.unreadable = False
        """There is a journal of the daemon before, and it cannot be read: anything may have been flown."""

    def recall(self) -> list[FlightNote]:
        """The notes of the daemon before; none, with a report, if the file cannot be read."""
        try:
            return read_state(self._path, MAX_BYTES, self._notes_of)
        except FileNotFoundError:
            return []
        except (OSError, ValueError) as error:
            self.unreadable = True
            self._report(
                f"{self._path} cannot be read: {error}; a vehicle that is in the air and follows setpoints when it is "
                "heard first is ordered to hold, unless another station flies it"
            )
            return []

    def due(self, states: tuple[Any, ...], now: float, *, flying: bool) -> bool:
        """True if a note has to be made: ``states`` differ from those of the last note, one is in the air, or the last
        note is not on disk."""
        return states != self._states or ((flying or self._failed) and now - self._noted_at >= PERIOD_S)

    def note(self, notes: Sequence[FlightNote], states: tuple[Any, ...], now: float) -> None:
        """Write these notes, as soon as the disk takes them."""
        self._states, self._noted_at = states, now
        table = {
            "format": FORMAT,
            "boot_id": self._boot_id,
            "unix_less_boot_s": time.time() - self._clock(),
            "notes": [note.as_json() for note in notes[:MAX_VEHICLES]],
        }
        self._waiting = json.dumps(table).encode()
        self._write_next()

    def _write_next(self) -> None:
        if self._writing or self._waiting is None:
            return
        content, self._waiting = self._waiting, None
        written = self._disk.offer("the journal of flights", partial(_write, self._path, content), len(content))
        if written is None:  # stuck: `DiskWriter` has reported it
            self._waiting = content
            return
        self._writing = True
        written.add_done_callback(self._written)

    def _written(self, written: asyncio.Future[None]) -> None:
        self._writing = False
        error = None if written.cancelled() else written.exception()
        if error is not None and not self._failed:
            self._report(f"{self._path} cannot be written: {error}; a restart will not know what flies")
        elif error is None and self._failed:
            self._report(f"{self._path} is written again")
        self._failed = error is not None
        self._write_next()

    def _notes_of(self, table: Any) -> list[FlightNote]:
        if table["format"] != FORMAT:
            raise ValueError(f"format {table['format']!r}")
        notes = [FlightNote.from_json(note) for note in table["notes"][:MAX_VEHICLES]]
        return self._by_wall_clock(table, notes)

    def _by_wall_clock(self, table: Mapping[str, Any], notes: list[FlightNote]) -> list[FlightNote]:
        """The notes with their times as the wall clock would have shown them that is right now, if they are of this
        start of the computer; those of another start, or of a version before, as they are."""
        ahead_s = table.get("unix_less_boot_s")
        if not self._boot_id or table.get("boot_id") != self._boot_id or not is_number(ahead_s):
            return notes
        set_by_s = time.time() - self._clock() - ahead_s
        return [replace(note, frames=tuple((at + set_by_s, raw) for at, raw in note.frames)) for note in notes]

    def _report(self, text: str) -> None:
        self._on_event(Event("warning", None, None, text, {"file": str(self._path)}))


def _write(path: Path, content: bytes) -> None:
    """Raises OSError; the file then says that it is out of date, which a full disk still takes: its blocks are there.
    An old note would be believed, and one that is missing would be taken for a daemon's first start."""
    try:
        make_log_folder(path.parent)
        write_whole(path, content, 0o600, durable=False)
    except OSError:
        with contextlib.suppress(OSError), path.open("r+b") as file:
            file.write(OUT_OF_DATE)
        raise


# --- notes of all vehicles --------------------------------------------------------------------------------------------


CHARGE_S = 5.0
"""Between two looks at the charges of all vehicles."""

UNKNOWN_S = 60.0
"""After a start with a journal that cannot be read, a vehicle that is heard within this time may have been flown by the
daemon before; later ones have flown without us for as long."""


class ChargeRecords:
    """A `FlightRecord` of each of the vehicles."""

    def __init__(self, vehicles: Mapping[int, VehicleActor]) -> None:
        self.recalled: dict[int, FlightRecord] = {}
        """By key, records of the daemon before, of vehicles that were not heard yet."""
        self._vehicles = vehicles
        self._records: dict[int, FlightRecord] = {}
        self._charged_at = -math.inf

    def record(self, actor: VehicleActor) -> FlightRecord:
        """The record of this vehicle's battery in flight."""
        key = actor.vehicle.key
        if key not in self._records:
            self._records[key] = self.recalled.pop(key, FlightRecord())
        return self._records[key]

    def tick(self, now: float) -> None:
        """Note the charges every `CHARGE_S`."""
        if now - self._charged_at < CHARGE_S:
            return
        self._charged_at = now
        for actor in self._vehicles.values():
            battery = actor.vehicle.telemetry("battery")
            percent = None if battery is None else battery["percent"]
            self.record(actor).charge(now, percent, in_air=actor.vehicle.armed and actor.vehicle.in_air(now) is True)
        if len(self._records) > len(self._vehicles):
            self._records = {key: record for key, record in self._records.items() if key in self._vehicles}


class FlightNotes:
    """`tick` at 1 to 10 Hz. What flies is noted in the journal; `recall_journal` and `recall` bring back what flew, and
    `flown_before` who flew a vehicle that is added."""

    def __init__(
        self,
        vehicles: Mapping[int, VehicleActor],
        add: Callable[[int, int, str, str | None], VehicleActor],
        waits: Callable[[int], bool],
        journal: FlightJournal,
        timeout_s: float,
        dialect: Dialect,
        loop: asyncio.AbstractEventLoop,
        on_event: OnEvent,
    ) -> None:
        """``vehicles``: of the fleet, by key. ``add``: adds a vehicle with these ids, heard on this link, flown by
        this before. ``waits``: `Returns.waits`. ``timeout_s``: how long a vehicle that was recalled may stay unheard
        before it is reported as lost."""
        self.charges = ChargeRecords(vehicles)
        self._vehicles = vehicles
        self._add = add
        self._waits = waits
        self._journal = journal
        self._dialect = dialect
        self._loop = loop
        self._on_event = on_event
        self._timeout_s = timeout_s
        self._recalled: dict[int, tuple[float, str]] = {}
        """By key, until when a vehicle that was recalled may be heard before it is reported as lost, and what it flew
        before."""
        self._owed: dict[int, str] = {}
        """By key, who flew a vehicle that was dropped in the air, for when it is heard again."""
        self._unknown_until = -math.inf
        """Until when a vehicle that is heard first may have been flown by the daemon before."""

    def tick(self, now: float) -> None:
        """Note the charges and what flies, and report what was recalled and is not heard."""
        self.charges.tick(now)
        if self._recalled:
            self._report_recalled(now)
        self.note_flights(now)

    def flown_before(self, key: int, now: float) -> str | None:
        """Take the note who flew a vehicle (sysid << 8 | compid) that is now heard and added; None: nobody of ours."""
        unknown = "nobody knows who, as the journal cannot be read," if now < self._unknown_until else None
        return self._owed.pop(key, unknown)

    def dropped(self, actor: VehicleActor) -> None:
        """Keep who flew a vehicle that leaves the fleet and may be in the air."""
        owed_to = actor.unattended.watch.owed_to
        if owed_to is not None and may_fly(actor.vehicle, self._loop.time()) and len(self._owed) < MAX_VEHICLES:
            self._owed[actor.vehicle.key] = owed_to

    def recall_journal(self) -> None:
        """`recall` what the journal of the daemon before has. If it cannot be read, any vehicle may have been flown."""
        self.recall(self._journal.recall(), "a restart")
        if self._journal.unreadable:
            self._unknown_until = self._loop.time() + UNKNOWN_S

    def recall(self, notes: Iterable[FlightNote], pause: str) -> None:
        """Take back what flew before ``pause`` ("a restart"): a vehicle that was in the air counts as lost there until
        it is heard, and one that our setpoints flew is held then."""
        now, unix_now = self._loop.time(), time.time()
        for note in notes:
            self.charges.recalled[note.key] = FlightRecord(note.flown_s, note.dropped_percent)
            parser = FrameParser(self._dialect)
            frames = [(f, at) for at, raw in note.frames for f in parser.feed_datagram(raw) if f.info is not None]
            heard_at = max((at for frame, at in frames if frame.msgid == HEARTBEAT), default=-math.inf)
            # a clock that was set back meanwhile, as on a computer without a battery for it, makes no note too old
            if not note.in_air or note.key in self._vehicles or not unix_now - heard_at < MAYBE_FLYING_S:
                continue
            self._owed.pop(note.key, None)  # the note has it
            actor = self._add(note.sysid, note.compid, "", note.flown_by and f"{note.flown_by} before {pause}")
            actor.vehicle.recall((frame, now - max(0.0, unix_now - at)) for frame, at in frames)
            self._recalled[note.key] = now + self._timeout_s, pause
            if note.waits:
                text = f"rtl: it held until its way home was clear before {pause}, and nobody sends it home now"
                data = {"order": "rtl", "result": "failed"}
                self._on_event(Event("command", actor.name, actor.sysid, text, data))

    def _report_recalled(self, now: float) -> None:
        """Report vehicles of the journal that were not heard meanwhile."""
        for key, (due, pause) in list(self._recalled.items()):
            actor = self._vehicles.get(key)
            if actor is None or actor.vehicle.connected or now >= due:
                del self._recalled[key]
                if actor is not None and not actor.vehicle.connected:
                    text = f"{lost_place(actor.vehicle, now)}; it was flying before {pause}"
                    self._on_event(Event("vehicle_lost", actor.name, actor.sysid, text, {"in_air": True}))

    def note_flights(self, now: float) -> None:
        """Note in the journal what flies."""
        actors = [a for a in self._vehicles.values() if not a.vehicle.replayed]
        states = tuple(
            (a.vehicle.key, is_flying(a.vehicle, now), a.unattended.watch.owed_to, self._waits(a.vehicle.key))
            for a in actors
        )
        if not self._journal.due(states, now, flying=any(flying for _, flying, _, _ in states)):
            return
        self._journal.note(self.of_flights(now, time.time() - now), states, now)

    def of_flights(self, now: float, to_unix_s: float) -> list[FlightNote]:
        """The notes of what flies, or has flown. ``to_unix_s``: from the loop's clock to Unix time."""
        notes = []
        for actor in (a for a in self._vehicles.values() if not a.vehicle.replayed):
            flying, flown_by = is_flying(actor.vehicle, now), actor.unattended.watch.owed_to
            vehicle, (flown_s, dropped) = actor.vehicle, self.charges.record(actor).consumption
            frames = tuple((at + to_unix_s, f.raw) for f, at in vehicle.last_frames(KEPT_MESSAGES))
            if flying or flown_s > 0.0:
                ids, waits = (vehicle.sysid, vehicle.compid), self._waits(vehicle.key)
                notes.append(FlightNote(*ids, vehicle.name, flying, flown_by, frames, flown_s, dropped, waits))
        return notes
