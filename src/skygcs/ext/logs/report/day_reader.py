"""Takes the entries of a day's tlogs, recording after recording, and makes the figures of the day. Pure.

A recording is what was recorded without a break, in one file or many. Times are seconds since 1970: whoever feeds the
entries has set their ``at_s`` so. Memory is bounded whatever the length: curves are thinned, lists have ends.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace

from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.separation import Footprint
from skygcs.core.vehicle.decoding import Decoder, decode_position
from skygcs.ext.logs.flight import RecordedFlight, VehicleFlight
from skygcs.ext.logs.report.approaches import Approaches
from skygcs.ext.logs.report.day_figures import DayEvent, DayReport, EventKind, VehicleDay
from skygcs.ext.logs.report.flight_book import DrawingRoom, FlightBook
from skygcs.ext.logs.report.link_figures import CommandDelays, Radios, Sources, msgids
from skygcs.ext.logs.tables import VehicleKey
from skygcs.tlog.format import LogEntry

POSITION = "GLOBAL_POSITION_INT"

MOST_EVENTS = 5000
"""Those of one vehicle that are kept; the rest is counted."""

MOST_DRAWN = 300
"""Flights of the whole day that are drawn: some 10 kB of the page each. Every vehicle has the same share of them."""

MOST_KEPT = 2000
"""Flights whose lines are kept while the logs are read: it is not known before the end how many vehicles there are."""


class DayReader:
    """`add` every entry, `end_recording` after each recording, then `finish`."""

    def __init__(
        self,
        dialect: Dialect,
        origin: Origin | None = None,
        names: Mapping[int, str] | None = None,
        footprint: Callable[[VehicleKey], Footprint] = lambda _: Footprint(),
    ) -> None:
        """``origin``: (0, 0) of the paths; None: the first position. ``names``: of system ids, from a fleet file."""
        self.origin = origin
        self._dialect = dialect
        self._names = dict(names or {})
        self._recorded = RecordedFlight(dialect, origin)
        self._decoder = Decoder(dialect)
        self._position_id = self._decoder.msgid_of(POSITION)
        self._frame: EnuFrame | None = None
        self._vehicles: dict[VehicleKey, VehicleDay] = {}
        self._books: dict[VehicleKey, FlightBook] = {}
        self._room = DrawingRoom(MOST_KEPT)
        self._lost: defaultdict[VehicleKey, int] = defaultdict(int)
        self._sources, self._radios = Sources(), Radios()
        self._delays = CommandDelays(dialect)
        self._approaches = Approaches(footprint)
        self._radio_ids, self._command_ids = msgids(dialect)
        self._begin_s, self._end_s = math.inf, -math.inf

    def add(self, entry: LogEntry) -> None:
        """The next entry; ``at_s`` never decreases, also from one recording to the next."""
        frame, now = entry.frame, entry.at_s
        self._begin_s, self._end_s = min(self._begin_s, now), max(self._end_s, now)
        self._recorded.add(entry)
        if frame is None:
            return
        self._sources.add(frame, len(entry.raw), now)
        if frame.info is None:
            return
        if frame.msgid in self._radio_ids:
            self._radios.add(frame, now)
        elif frame.msgid in self._command_ids:
            self._delays.add(frame, now)
        vehicle = self._recorded.vehicles.get((frame.sysid, frame.compid))
        if vehicle is not None:
            self._on_vehicle(vehicle, frame, now)

    def end_recording(self) -> None:
        """Nothing is recorded from here to the next entry: no flight, silence or loss lasts from one to the other."""
        self._recorded.finish()
        for key, vehicle in self._recorded.vehicles.items():
            self._lost[key] += vehicle.stats.lost
            self._take_over(self._day_of(vehicle), vehicle)
        for book in self._books.values():
            book.close()
        self._approaches.leave_all()
        self._delays.close()
        self._sources.resume()
        self._recorded = RecordedFlight(self._dialect, self.origin)

    def finish(self, title: str) -> DayReport:
        """The figures of all that was added; `end_recording` was the last call."""
        report = DayReport(title, origin=self.origin, approaches=self._approaches.figures())
        report.radios = self._radios.figures()
        if self._begin_s <= self._end_s:
            report.begin_s, report.end_s = self._begin_s, self._end_s
        report.vehicles = [self._vehicles[key] for key in sorted(self._vehicles)]
        share = max(MOST_DRAWN // max(sum(bool(book.flights) for book in self._books.values()), 1), 1)
        for day in report.vehicles:
            book = self._books.get(day.key)
            if book is not None:
                day.flights = [*book.flights[:share], *(replace(f, drawing=None) for f in book.flights[share:])]
                day.flights_left_out = book.left_out
            day.events.sort(key=lambda event: event.at_s)
            day.delays = self._delays.figures(day.key[0])
        self._share_sources(report)
        undrawn = sum(flight.drawing is None for day in report.vehicles for flight in day.flights)
        if undrawn:
            report.missing.append(f"drawings of {undrawn:,} flights: the first {share} of each vehicle are drawn")
        return report

    def _share_sources(self, report: DayReport) -> None:
        """Each source goes to the vehicle of its system; with several autopilots in one system, to the first."""
        owners: dict[int, VehicleDay] = {}
        for day in report.vehicles:
            owners.setdefault(day.key[0], day)
        for source in self._sources.figures(self._lost):
            owner = owners.get(source.sysid)
            (report.other_sources if owner is None else owner.sources).append(source)
        left_out = self._sources.left_out + self._radios.left_out
        if left_out:
            report.missing.append(f"{left_out:,} frames of more sources than any fleet has were not counted by source")

    # -- one frame of a vehicle

    def _on_vehicle(self, vehicle: VehicleFlight, frame: Frame, now: float) -> None:
        key = vehicle.sysid, vehicle.compid
        book = self._books.get(key)
        if book is None:
            book = self._books[key] = FlightBook(self._room)
        if self.origin is None:
            self.origin = self._recorded.origin
        book.step(now, vehicle, frame.name)
        if not book.in_air:
            self._approaches.left(key)
        elif frame.msgid == self._position_id:
            self._on_position(key, frame, now)

    def _on_position(self, key: VehicleKey, frame: Frame, now: float) -> None:
        values = self._decoder.values(POSITION, frame.payload)
        position = decode_position({POSITION: values}, self._decoder) if values else None
        if position is None or position["lat_deg"] is None:
            return
        place = position["lat_deg"], position["lon_deg"], position["alt_amsl_m"]
        if self._frame is None:  # true east and north, whatever the fleet's axes
            self._frame = EnuFrame(Origin(*place))
        self._approaches.placed(key, now, self._frame.from_geodetic(*place))

    # -- one vehicle of a recording

    def _day_of(self, vehicle: VehicleFlight) -> VehicleDay:
        key = vehicle.sysid, vehicle.compid
        day = self._vehicles.get(key)
        if day is None:
            name = self._names.get(key[0])
            shown = f"vehicle {vehicle.name}" if name is None else name
            day = self._vehicles[key] = VehicleDay(key, shown, first_s=vehicle.first_s)
        day.kind = f"{vehicle.autopilot} {vehicle.kind.replace('_', ' ')}"
        day.firmware = vehicle.firmware or day.firmware
        day.last_s = vehicle.last_s
        day.reboots += vehicle.reboots
        return day

    def _take_over(self, day: VehicleDay, vehicle: VehicleFlight) -> None:
        events = _events_of(vehicle)
        room = MOST_EVENTS - len(day.events)
        day.events += events[:room]
        day.events_left_out += vehicle.left_out + max(len(events) - room, 0)


def _events_of(vehicle: VehicleFlight) -> list[DayEvent]:
    """The events of one recording, by time."""
    events = [
        DayEvent(text.at_s, EventKind.TEXT, text.text, severity=text.severity, in_air=_armed_at(vehicle, text.at_s))
        for text in vehicle.texts
    ]
    armed: bool | None = None
    mode = ""
    for span in vehicle.modes:
        if span.armed != armed and (armed is not None or span.armed):
            kind = EventKind.ARMED if span.armed else EventKind.DISARMED
            events.append(DayEvent(span.begin_s, kind, span.mode if armed is not None else f"{span.mode}, already"))
        if span.mode != mode:
            events.append(DayEvent(span.begin_s, EventKind.MODE, span.mode))
        armed, mode = span.armed, span.mode
    for kind, spans in ((EventKind.SILENT, vehicle.silences), (EventKind.FAILSAFE, vehicle.failsafes)):
        for begin_s, end_s in spans:
            flew = _armed_at(vehicle, begin_s)
            text = f"for {end_s - begin_s:.1f} s{', armed' if flew else ''}"
            events.append(DayEvent(begin_s, kind, text, in_air=flew, duration_s=end_s - begin_s))
    return sorted(events, key=lambda event: event.at_s)


def _armed_at(vehicle: VehicleFlight, at_s: float) -> bool:
    return any(span.armed and span.begin_s <= at_s <= end_s for span, end_s in vehicle.spans())
