"""Losses per source, signals of radios, and delays of commands, from the frames of a day. Pure.

Records of a tlog do not name the link that a frame came over, so there are no figures per link: a radio is known by its
reports, a source by its system and component.
"""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import COMMAND_ACK, COMMAND_INT, COMMAND_LONG, RADIO, RADIO_STATUS
from skygcs.core.routing.source_statistics import SourceStats
from skygcs.ext.logs.curves import Curve
from skygcs.ext.logs.report.day_figures import DelayFigures, RadioFigures, SourceFigures, spread
from skygcs.ext.logs.tables import VehicleKey
from skygcs.ext.logs.trace_figures import p95

MOST_SOURCES = 500
MOST_RADIOS = 20
"""More are an attack, and are left out."""

MOST_KINDS = 200
"""Different commands to one vehicle."""

MOST_DELAYS = 20_000
"""Answers to one command of one vehicle whose times are kept."""

MOST_OPEN = 1000
"""Commands that wait for an answer at a time; the oldest makes room."""

ANSWER_S = 15.0
"""A later answer belongs to no command: repeats end long before."""

UNKNOWN_SIGNAL = 255
"""RADIO_STATUS: the value is not known."""

CURVE_BUCKETS = 300

SIGNALS = ("rssi", "remrssi", "noise", "remnoise", "txbuf")
DRAWN = ("rssi", "noise", "txbuf")


class Sources:
    """Counts of every system and component."""

    def __init__(self) -> None:
        self._stats: dict[VehicleKey, SourceStats] = {}
        self.left_out = 0

    def add(self, frame: Frame, size: int, now: float) -> None:
        key = frame.sysid, frame.compid
        stats = self._stats.get(key)
        if stats is None:
            if frame.info is None:  # its CRC cannot be checked, and noise has any source
                return
            if len(self._stats) >= MOST_SOURCES:
                self.left_out += 1
                return
            stats = self._stats[key] = SourceStats(*key)
        stats.on_frame(frame.seq, size, now)

    def resume(self) -> None:
        """Go on after a while without a recording."""
        for stats in self._stats.values():
            stats.resume()

    def figures(self, lost: dict[VehicleKey, int]) -> list[SourceFigures]:
        """By system and component. ``lost``: of vehicles, whose reboots are known to their flight and not here."""
        return [
            SourceFigures(*key, stats.frames, lost.get(key, stats.lost) if stats.counts_loss else None)
            for key, stats in sorted(self._stats.items())
        ]


@dataclass
class _Radio:
    reports: int = 0
    errors: int = 0
    last_errors: int | None = None
    counts: dict[str, Counter[int]] = field(default_factory=lambda: {name: Counter() for name in SIGNALS})
    lines: dict[str, Curve] = field(default_factory=lambda: {n: Curve(CURVE_BUCKETS) for n in DRAWN})


class Radios:
    """Reports of radios on their links, by the source of the reports (SiK: 51/68)."""

    def __init__(self) -> None:
        self._radios: dict[VehicleKey, _Radio] = {}
        self.left_out = 0

    def add(self, frame: Frame, now: float) -> None:
        """A RADIO_STATUS or RADIO of a message that the dialect has."""
        key = frame.sysid, frame.compid
        radio = self._radios.get(key)
        if radio is None:
            if len(self._radios) >= MOST_RADIOS:
                self.left_out += 1
                return
            radio = self._radios[key] = _Radio()
        values = frame.fields()
        radio.reports += 1
        for name in SIGNALS:
            value = values[name]
            if value != UNKNOWN_SIGNAL:
                radio.counts[name][value] += 1
                if name in radio.lines:
                    radio.lines[name].add(now, value)
        errors = values["rxerrors"]
        if radio.last_errors is not None and errors >= radio.last_errors:  # else it was restarted
            radio.errors += errors - radio.last_errors
        radio.last_errors = errors

    def figures(self) -> list[RadioFigures]:
        found = []
        for key, radio in sorted(self._radios.items()):
            rssi, remote_rssi, noise, remote_noise, txbuf = (
                spread(sorted(radio.counts[name].elements())) for name in SIGNALS
            )
            lines = [radio.lines[name].points() for name in DRAWN]
            found.append(
                RadioFigures(
                    *key, radio.reports, rssi, remote_rssi, noise, remote_noise, *txbuf[:2], radio.errors, *lines
                )
            )
        return found


@dataclass(slots=True)
class _Asked:
    at_s: float
    asker: VehicleKey


@dataclass
class _Delays:
    asked: int = 0
    answered: int = 0
    repeats: int = 0
    seconds: array[float] = field(default_factory=lambda: array("d"))


class CommandDelays:
    """Pairs every COMMAND_LONG and COMMAND_INT to one system with the first COMMAND_ACK of that system for it.

    The time is that of the recorder, so it holds both ways of the link and the time in the vehicle. Two commands of one
    kind to one vehicle that wait at the same time cannot be told apart: the second counts as a repeat of the first.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._names = dialect.enums.get("MAV_CMD", {})
        self._open: dict[tuple[int, int], _Asked] = {}
        self._delays: dict[tuple[int, int], _Delays] = {}
        self._kinds: Counter[int] = Counter()
        """Different commands to each system."""

    def add(self, frame: Frame, now: float) -> None:
        """A COMMAND_LONG, COMMAND_INT or COMMAND_ACK."""
        values = frame.fields()
        if frame.msgid == COMMAND_ACK:
            self._answered(frame.sysid, values, now)
            return
        key = values["target_system"], values["command"]
        delays = self._delays.get(key)
        if not key[0]:  # to all: several answers, and nobody knows how many
            return
        if delays is None:
            if self._kinds[key[0]] >= MOST_KINDS:
                return
            self._kinds[key[0]] += 1
            delays = self._delays[key] = _Delays()
        waiting = self._open.get(key)
        if waiting is not None and now - waiting.at_s <= ANSWER_S:
            delays.repeats += 1
            return
        self._open.pop(key, None)
        if len(self._open) >= MOST_OPEN:
            del self._open[next(iter(self._open))]
        self._open[key] = _Asked(now, (frame.sysid, frame.compid))
        delays.asked += 1

    def close(self) -> None:
        """The recording ends here: what waits for an answer was not answered in it."""
        self._open.clear()

    def figures(self, system: int) -> list[DelayFigures]:
        """Those of this system, the most frequent command first."""
        found = [(command, delays) for (of, command), delays in self._delays.items() if of == system]
        return [self._figures(command, delays) for command, delays in sorted(found, key=lambda f: (-f[1].asked, f[0]))]

    def _answered(self, system: int, values: dict[str, int], now: float) -> None:
        key = system, values["command"]
        waiting = self._open.get(key)
        if waiting is None:
            return
        to = values.get("target_system", 0)  # 0 in MAVLink 1, which has no such field
        if to and to != waiting.asker[0]:
            return
        del self._open[key]
        if now - waiting.at_s <= ANSWER_S:
            delays = self._delays[key]
            delays.answered += 1
            if len(delays.seconds) < MOST_DELAYS:
                delays.seconds.append(now - waiting.at_s)

    def _figures(self, command: int, delays: _Delays) -> DelayFigures:
        ordered = sorted(1000 * s for s in delays.seconds)
        _, median_ms, largest_ms = spread(ordered)
        name = self._names.get(command, str(command)).removeprefix("MAV_CMD_")
        return DelayFigures(name, delays.asked, delays.answered, delays.repeats, median_ms, p95(ordered), largest_ms)


def msgids(dialect: Dialect) -> tuple[frozenset[int], frozenset[int]]:
    """Ids of the messages for `Radios.add` and for `CommandDelays.add`, of those that the dialect has."""
    known = dialect.messages.keys()
    return frozenset({RADIO_STATUS, RADIO} & known), frozenset({COMMAND_LONG, COMMAND_INT, COMMAND_ACK} & known)
