"""Notes of all vehicles' flights: kept in the journal while they fly, taken back by a daemon that begins anew or a
computer that has slept, with who flew each; and the consumption of their batteries, for the next plan."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterable, Mapping

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.vehicle.flight_note import KEPT_MESSAGES, FlightNote, FlightRecord, lost_place
from skygcs.core.vehicle.supply import MAYBE_FLYING_S, may_fly
from skygcs.events import Event
from skygcs.runtime.flight_journal import FlightJournal
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import MAX_VEHICLES, OnEvent

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
        """Return what is measured of this vehicle's battery in flight."""
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
