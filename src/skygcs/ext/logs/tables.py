"""Tables of a log: one of each message, or the UTIAS scripts' flight table of each vehicle."""

from __future__ import annotations

from typing import Any

from skygcs.core.mavlink.dialect import Dialect, FieldInfo, MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import HeartbeatChecks
from skygcs.core.mavlink.modes import mode_name
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.vehicle.decoding import Decoder, TelemetryGroup, decode_attitude, decode_position
from skygcs.terminal_text import visible
from skygcs.tlog.format import LogEntry

LONGEST_SPLIT = 32
"""A longer array of bytes is data (of a file, a log, a serial port): one cell in hexadecimal."""

Kind = str
"""Type of a column: a scalar type of MAVLink (uint8_t … double), or one of the three below."""

TEXT: Kind = "text"
TIME: Kind = "time"
NUMBER: Kind = "number"

FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""A spreadsheet takes text that begins so for a formula; texts come from outside."""

HEAD = (("time", TIME), ("sysid", "uint8_t"), ("compid", "uint8_t"))
"""The columns before the fields; ``time`` is microseconds since 1970, None in a raw capture."""


def csv_text(text: str, *, lines: bool = False) -> str:
    """A text of a vehicle as a cell of CSV: with an apostrophe before what a spreadsheet would take for a formula, and
    without what moves a terminal, or begins a row where it is not quoted. ``lines``: newlines and tabs stay."""
    shown = visible(text, lines=lines)
    return f"'{shown}" if text.startswith(FORMULA) else shown


class MessageColumns:
    """The table of one message: ``columns`` are (name, kind), `row` has a value for each."""

    def __init__(self, info: MessageInfo) -> None:
        self.name = info.name
        self._fields = tuple((field.name, _is_split(field), _is_hex(field)) for field in info.fields)
        columns: list[tuple[str, Kind]] = list(HEAD)
        taken = {name for name, _ in HEAD}
        for field in info.fields:
            columns += [(_free(name, taken), kind) for name, kind in _columns_of(field)]
        self.columns = tuple(columns)

    def row(self, entry: LogEntry, frame: Frame) -> list[Any]:
        """A time in microseconds since 1970 or None, numbers as decoded, text."""
        row: list[Any] = [entry.unix_us, frame.sysid, frame.compid]
        values = frame.fields()
        for name, split, is_hex in self._fields:
            value = values[name]
            if split:
                row += value
            elif is_hex:
                row.append(bytes(value).hex())
            else:
                row.append(value)
        return row


def _is_hex(field: FieldInfo) -> bool:
    return field.type == "uint8_t" and field.array_length > LONGEST_SPLIT


def _is_split(field: FieldInfo) -> bool:
    return bool(field.array_length) and field.type != "char" and not _is_hex(field)


def _columns_of(field: FieldInfo) -> list[tuple[str, Kind]]:
    if field.type == "char" or _is_hex(field):
        return [(field.name, TEXT)]
    if field.array_length:
        return [(f"{field.name}_{n}", field.type) for n in range(field.array_length)]
    return [(field.name, field.type)]


def _free(name: str, taken: set[str]) -> str:
    """A name that no other column of the table has: some messages have a field "time"."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


FLIGHT_COLUMNS: tuple[tuple[str, Kind], ...] = (
    ("time", TIME),
    ("mode", TEXT),
    *((name, NUMBER) for name in ("lat", "lon", "alt", "vx", "vy", "vz", "roll", "pitch", "yaw")),
)
"""Degrees; ``alt`` metres above home; ``vx``, ``vy``, ``vz`` m/s to the north, east and **down**, the axes of
GLOBAL_POSITION_INT; roll, pitch and compass heading (-180..180) in degrees."""

STALE_S = 5.0
"""Older values are left out of a row; slow links send attitude once a second and lose some."""

POSITION, ATTITUDES = "GLOBAL_POSITION_INT", ("ATTITUDE", "ATTITUDE_QUATERNION")

VehicleKey = tuple[int, int]
"""System and component."""


class FlightTables:
    """Rows of all vehicles: one for each position or, while no position comes, for each attitude.

    Vehicles are found as the daemon finds them (`core.mavlink.heartbeat`); frames before a vehicle's first heartbeat
    make no row.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._decoder = Decoder(dialect)
        self._position = self._decoder.msgid_of(POSITION)
        self._attitudes = {self._decoder.msgid_of(name): name for name in ATTITUDES}
        self._heartbeats = HeartbeatChecks()
        self._vehicles: dict[VehicleKey, _Newest] = {}

    def row(self, entry: LogEntry) -> tuple[VehicleKey, list[Any]] | None:
        """The vehicle and its next row, if this entry makes one. In a raw capture ``time`` is ``at_s``."""
        frame = entry.frame
        if frame is None or frame.info is None:
            return None
        key = frame.sysid, frame.compid
        own = self._heartbeats.own(frame, entry.at_s)
        if frame.msgid == HEARTBEAT:
            if own:
                self._vehicles.setdefault(key, _Newest()).mode = _mode(frame)
            return None
        vehicle = self._vehicles.get(key)
        if vehicle is None:
            return None
        now = entry.at_s
        if frame.msgid == self._position:
            vehicle.position = decode_position({POSITION: self._decoder.values(POSITION, frame.payload)}, self._decoder)
            vehicle.position_s = now
        elif frame.msgid in self._attitudes:
            name = self._attitudes[frame.msgid]
            vehicle.attitude = decode_attitude({name: self._decoder.values(name, frame.payload)}, self._decoder)
            vehicle.attitude_s = now
            if vehicle.position is not None and now - vehicle.position_s <= STALE_S:
                return None
        else:
            return None
        time = entry.unix_us if entry.unix_us is not None else round(now * 1e6)
        return key, [time, *vehicle.cells(now)]


class _Newest:
    """The newest values of one vehicle."""

    __slots__ = ("attitude", "attitude_s", "mode", "position", "position_s")

    def __init__(self) -> None:
        self.mode = ""
        self.position: TelemetryGroup | None = None
        self.position_s = 0.0
        self.attitude: TelemetryGroup | None = None
        self.attitude_s = 0.0

    def cells(self, now: float) -> list[Any]:
        place: list[Any] = [None] * 6
        angles: list[Any] = [None] * 3
        if self.position is not None and now - self.position_s <= STALE_S:
            east, north, up = self.position["vel_enu_mps"]
            place = [*(self.position[name] for name in ("lat_deg", "lon_deg", "alt_rel_m")), north, east, 0.0 - up]
        if self.attitude is not None and now - self.attitude_s <= STALE_S:
            angles = [self.attitude[name] for name in ("roll_deg", "pitch_deg", "yaw_deg")]
        return [self.mode, *place, *angles]


def _mode(frame: Frame) -> str:
    fields = frame.fields()
    return mode_name(fields["autopilot"], fields["type"], fields.get("base_mode", 0), fields.get("custom_mode", 0))
