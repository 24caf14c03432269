"""The contents of a report: plain figures, without how they were found. Pure.

Times are seconds since 1970 (UTC), positions metres along x, y of the report's origin, heights metres above home. NaN
or None is what the logs do not have.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from skygcs.core.alarms import BEFORE_FLIGHT
from skygcs.core.geo import Origin
from skygcs.core.quantile import median
from skygcs.core.vehicle.state import SEVERITY
from skygcs.ext.logs.tables import VehicleKey
from skygcs.ext.logs.trace_figures import TraceFigures

Line = tuple[list[float], list[float]]
"""Abscissae and ordinates to draw a line through; NaN where it is broken."""

WARNING = 4
"""MAV_SEVERITY_WARNING: texts of this severity and above it (smaller numbers) are troubles."""

LONGEST_SILENCE_S = 10.0
"""A longer silence of a vehicle in the air is worse than a text of severity error."""


class Drawing(NamedTuple):
    """The lines of one flight."""

    track: Line
    """x, y in metres."""
    height: Line
    """Time, metres above home."""
    percent: Line
    """Time, charge of the battery in percent."""
    volts: Line


@dataclass(frozen=True)
class FlightFigures:
    """One flight: from arming, or the first that was recorded of it, to disarming, or the last."""

    number: int
    """1-based, of this vehicle on this day."""
    begin_s: float
    end_s: float
    air_s: float
    """Time in the air."""
    distance_m: float
    """Length of its path in space; steps below half a metre are noise and do not count."""
    highest_m: float
    first_percent: float
    last_percent: float
    least_volts: float
    whole: bool
    """False if the recording began or ended while it was armed."""
    drawing: Drawing | None
    """None: the report has too many flights to draw all."""

    @property
    def used_percent(self) -> float:
        """Charge that the flight took; NaN if the battery does not report it."""
        return self.first_percent - self.last_percent


class EventKind(StrEnum):
    """Kinds of events of a vehicle."""

    TEXT = "text"
    MODE = "mode"
    ARMED = "armed"
    DISARMED = "disarmed"
    FAILSAFE = "failsafe"
    SILENT = "silent"
    REBOOT = "reboot"


@dataclass(frozen=True, slots=True)
class DayEvent:
    """Something that happened to a vehicle."""

    at_s: float
    kind: EventKind
    text: str
    severity: int | None = None
    """MAV_SEVERITY of a status text."""
    in_air: bool = False
    """True if the vehicle was armed."""
    duration_s: float = 0.0
    """How long a failsafe or a silence lasted."""

    @property
    def word(self) -> str:
        """The severity of a text, else the kind, for people."""
        if self.severity is None:
            return str(self.kind)
        return SEVERITY[self.severity] if self.severity < len(SEVERITY) else str(self.severity)

    @property
    def rank(self) -> int:
        """How bad it is: 0 is the worst, `HARMLESS` is no trouble. What an autopilot says while it may not be armed is
        the least of troubles, whatever its severity."""
        match self.kind:
            case EventKind.TEXT if self.severity is not None and self.severity <= WARNING:
                waits = not self.in_air and BEFORE_FLIGHT.match(self.text) is not None
                return 8 if waits else (0, 1, 2, 5, 7)[self.severity]
            case EventKind.FAILSAFE:  # ArduPilots report one on the ground until a ground station is heard
                return 3 if self.in_air else 8
            case EventKind.SILENT if self.in_air:
                return 4 if self.duration_s > LONGEST_SILENCE_S else 6
        return HARMLESS


HARMLESS = 9


@dataclass(frozen=True)
class Trace:
    """Figures of one control trace."""

    file: str
    vehicle: str
    measured: TraceFigures


@dataclass(frozen=True)
class DelayFigures:
    """Times from commands to a vehicle to their first answers. A command that is repeated counts once."""

    command: str
    asked: int
    answered: int
    repeats: int
    """How often one was sent again before it was answered."""
    median_ms: float
    p95_ms: float
    largest_ms: float


@dataclass(frozen=True)
class SourceFigures:
    """Frames of one source, and those that are missing between its sequence numbers."""

    sysid: int
    compid: int
    frames: int
    lost: int | None
    """None: its numbers do not show it."""

    @property
    def loss_ratio(self) -> float:
        """Lost / (received + lost), 0..1; NaN if that is not known."""
        if self.lost is None:
            return math.nan
        total = self.frames + self.lost
        return self.lost / total if total else 0.0


@dataclass(frozen=True)
class RadioFigures:
    """Figures that one radio reported by RADIO_STATUS and RADIO. Signals are counts of the radio, 0..254."""

    sysid: int
    compid: int
    reports: int
    rssi: tuple[float, float, float]
    """Least, median, greatest."""
    remote_rssi: tuple[float, float, float]
    noise: tuple[float, float, float]
    remote_noise: tuple[float, float, float]
    least_txbuf_percent: float
    median_txbuf_percent: float
    receive_errors: int
    rssi_line: Line
    noise_line: Line
    txbuf_line: Line


@dataclass(frozen=True)
class ApproachFigures:
    """How near two vehicles came while both were in the air."""

    first: VehicleKey
    second: VehicleKey
    at_s: float
    distance_m: float
    """Between their positions as reported."""
    level_m: float
    vertical_m: float
    separation_m: float
    """The least in the metric of the margin, in which heights count less; not necessarily at the same time."""
    margin_m: float

    @property
    def used(self) -> float:
        """Share of the margin that was left at the least: below 1 it was used up in part."""
        return self.separation_m / self.margin_m if self.margin_m else math.inf


@dataclass
class VehicleDay:
    """One vehicle on this day."""

    key: VehicleKey
    name: str
    """Its name in the fleet file, else its ids."""
    kind: str = ""
    firmware: str = ""
    first_s: float = math.nan
    last_s: float = math.nan
    reboots: int = 0
    flights: list[FlightFigures] = field(default_factory=list)
    flights_left_out: int = 0
    events: list[DayEvent] = field(default_factory=list)
    events_left_out: int = 0
    delays: list[DelayFigures] = field(default_factory=list)
    sources: list[SourceFigures] = field(default_factory=list)
    """Those of its system."""
    traces: list[Trace] = field(default_factory=list)
    plan: Line | None = None
    """The path that a plan has for it: x, y in metres."""
    plan_heights_m: tuple[float, float] | None = None
    """Least and greatest height of that path, above the plan's origin."""

    @property
    def air_s(self) -> float:
        return sum(flight.air_s for flight in self.flights)

    @property
    def distance_m(self) -> float:
        return sum(flight.distance_m for flight in self.flights)

    @property
    def highest_m(self) -> float:
        return most(flight.highest_m for flight in self.flights)

    @property
    def used_percent(self) -> float:
        """Sum over its flights; NaN if none is known."""
        used = [f.used_percent for f in self.flights if not math.isnan(f.used_percent)]
        return sum(used) if used else math.nan

    @property
    def worst(self) -> DayEvent | None:
        """The worst event, the first of several; None without trouble."""
        return min((e for e in self.events if e.rank < HARMLESS), key=lambda e: (e.rank, e.at_s), default=None)


@dataclass(frozen=True)
class AlarmFigures:
    """An alarm of the daemon, as its file has it."""

    raised_s: float
    severity: str
    vehicle: str
    kind: str
    text: str
    count: int
    acknowledged_by: str


class FileState(StrEnum):
    """How a file of the folder was used."""

    READ = "read"
    DAMAGED = "read, with faults"
    OTHER_DAY = "another day"
    LEFT_OUT = "left out"
    FAILED = "cannot be read"


@dataclass(frozen=True)
class FileNote:
    """A file of the folder: what was made of it, and what is missing therefore."""

    name: str
    state: FileState
    about: str
    size: int = 0


@dataclass
class DayReport:
    """Everything in the page."""

    title: str
    begin_s: float = math.nan
    end_s: float = math.nan
    origin: Origin | None = None
    vehicles: list[VehicleDay] = field(default_factory=list)
    other_sources: list[SourceFigures] = field(default_factory=list)
    """Sources that belong to no vehicle's system."""
    radios: list[RadioFigures] = field(default_factory=list)
    approaches: list[ApproachFigures] = field(default_factory=list)
    """The nearest first."""
    alarms: list[AlarmFigures] = field(default_factory=list)
    other_traces: list[Trace] = field(default_factory=list)
    """Those of vehicles that no tlog has."""
    files: list[FileNote] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    """A sentence for each thing that the report does not have, with the reason."""
    plan_name: str = ""
    plan_own_origin: bool = False
    """True: the plan's place on the ground is not known, so it is drawn beside the flown paths and not over them."""


def most(values: Iterable[float]) -> float:
    """The greatest of those that are no NaN; NaN without any."""
    return max((value for value in values if not math.isnan(value)), default=math.nan)


def least(values: Iterable[float]) -> float:
    """The least of those that are no NaN; NaN without any."""
    return min((value for value in values if not math.isnan(value)), default=math.nan)


def spread(ordered: Sequence[float]) -> tuple[float, float, float]:
    """Least, median and greatest of these, the least first; NaN without any."""
    if not ordered:
        return math.nan, math.nan, math.nan
    return ordered[0], median(ordered), ordered[-1]
