"""Parameter files: QGroundControl's .params, and the .param / .parm of Mission Planner, MAVProxy and ArduPilot.

    QGroundControl   1<TAB>1<TAB>MPC_THR_HOVER<TAB>0.500000000000000000<TAB>9     vehicle, component, name, value, type
    the others       WPNAV_SPEED,500   or   WPNAV_SPEED 500   or with tabs, with or without "# why" after it

The format is found from the first parameter, not from the file's name. Comments keep their places, so that a file under
version control can be rewritten.

Some writers round. MAVProxy and pymavlink write `%f`, which turns 0.00012345 into 0.000123; Mission Planner writes
seven significant digits, but a 32-bit float may need nine; QGroundControl writes 18 decimals, which is exact except for
values below 1e-9. The digits of the whole file show the writer (`Rounding`). Only then does a value of the file match
all values that are rounded to it (`Entry.slack`); otherwise it is the number that is written.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Literal

from skygcs.core.mavlink.param_encoding import (
    NAME_CHARS,
    Param,
    ParamType,
    Value,
    float32,
    held_as,
    is_name,
    short_float,
)
from skygcs.errors import ConfigError

Kind = Literal["qgc", "plain"]

Rounding = Literal["exact", "6 decimals", "7 digits", "18 decimals"]
"""How the writer of a file rounds values that are not whole numbers."""

MAX_CHARS = 4_000_000
"""Most entries of one file: fifty times the largest set there is."""

MAX_PROBLEMS = 20
"""Problems reported at once; a file of another kind has one in each line."""

MAX_NUMBER_CHARS = 80
"""Longest text of a number: the largest float with QGroundControl's 18 decimals has 58 characters."""

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
_HEX = re.compile(r"0[xX][0-9a-fA-F]{1,8}", re.ASCII)
_PLAIN = re.compile(r"([^\s,=]++)(?:\s++[,=]?|[,=])\s*+([^\s,#]++)\s*+(.*+)")
"""Without a way back: a line of blanks takes no more than any other (100,000 of them took minutes)."""

_HEAD = re.compile(r"#\s*(Stack|Vehicle|Version|Git Revision)\s*:\s*(.+)")
_FOR_VEHICLE = re.compile(r"#\s*Onboard parameters for Vehicle (\d+)")

QGC_DECIMALS = 18
"""Decimals of a value that is not a whole number (`QString::number(value, 'f', 18)`)."""

MAVPROXY_DECIMALS = 6
"""`%f` of pymavlink's mavparm.py, with which MAVProxy writes, too."""

MISSION_PLANNER_DIGITS = 7
"""Significant digits: .NET's default for a float, the type of parameters in Mission Planner, without trailing zeros."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One line with a parameter. ``type``, ``sysid`` and ``compid`` come from a QGroundControl file, else None.

    ``slack``: half a unit of the digit that the file's writer rounds to; 0 if it is not known to round.
    ``comment`` follows the value, ``above`` are comment lines before it, both as they were written.
    """

    name: str
    value: Value
    type: ParamType | None = None
    sysid: int | None = None
    compid: int | None = None
    slack: float = field(default=0.0, compare=False)
    comment: str = ""
    above: tuple[str, ...] = ()
    line: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class ParamFile:
    """A file's contents. ``separator`` of a plain file: "," or " ". ``header``: the lines before the first entry."""

    kind: Kind
    entries: tuple[Entry, ...]
    separator: str = ","
    header: tuple[str, ...] = ()
    footer: tuple[str, ...] = ()
    rounding: Rounding = field(default="exact", compare=False)

    @property
    def about(self) -> dict[str, str]:
        """Stack, Vehicle, Version, Git Revision, as far as the header has them."""
        return {m[1]: m[2].strip() for line in self.header if (m := _HEAD.match(line)) is not None}

    @property
    def sysids(self) -> frozenset[int]:
        """Vehicles named in the file; empty if it names none."""
        named = {int(m[1]) for line in self.header if (m := _FOR_VEHICLE.match(line)) is not None}
        return frozenset(named | {e.sysid for e in self.entries if e.sysid is not None})

    def of_component(self, compid: int) -> tuple[Entry, ...]:
        """The entries for one component; if a file names no component, they are for any."""
        return tuple(e for e in self.entries if e.compid in (None, compid))


def parse(text: str, source: str) -> ParamFile:
    """Read a file. ``source`` names it in errors. Raises ConfigError with line and reason of every problem."""
    if len(text) > MAX_CHARS:
        raise ConfigError(source, [f"is too long for a parameter file ({len(text)} characters)"])
    reader = _Reader()
    for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        try:
            reader.take(number, line.strip())
        except ValueError as error:
            reader.problems.append(f"line {number}: {error}")
            if len(reader.problems) == MAX_PROBLEMS:
                reader.problems.append("… and perhaps more")
                break
    if not reader.entries and not reader.problems:
        reader.problems.append("has no parameters in it")
    if reader.problems:
        raise ConfigError(source, reader.problems)
    return reader.result()


class _Reader:
    def __init__(self) -> None:
        self.problems: list[str] = []
        self.entries: list[Entry] = []
        self._texts: list[str] = []
        """The text of each entry's value."""
        self._kind: Kind | None = None
        self._separator = ","
        self._comments: list[str] = []
        self._header: tuple[str, ...] = ()
        self._seen: dict[tuple[int | None, int | None, str], Entry] = {}

    def take(self, number: int, line: str) -> None:
        """Parse one line. Raises ValueError with the problem."""
        if not line or line.startswith("#"):
            self._comments.append(line)
            return
        if line.startswith("@"):
            word = line.split()[0].upper()
            hint = ": put both files' parameters into one" if word == "@INCLUDE" else ""
            raise ValueError(f"{word[:20]} is for files on board of an ArduPilot and not followed here{hint}")
        first = self._kind is None
        if first:
            words = line.split()
            self._kind = "qgc" if len(words) >= 4 and words[0].isdigit() and words[1].isdigit() else "plain"
        entry, text = _qgc_entry(number, line) if self._kind == "qgc" else self._plain_entry(number, line)
        if first:
            self._header, self._comments = tuple(self._comments), []
        key = (entry.sysid, entry.compid, entry.name)
        earlier = self._seen.setdefault(key, entry)
        if earlier is not entry:
            if earlier.value != entry.value:
                raise ValueError(
                    f"{entry.name} is {entry.value:g} here and {earlier.value:g} in line {earlier.line}: keep one"
                )
            return
        self.entries.append(replace(entry, above=tuple(self._comments)))
        self._texts.append(text)
        self._comments = []

    def result(self) -> ParamFile:
        assert self._kind is not None
        own = any(
            _FOR_VEHICLE.match(line) for line in self._header
        )  # a file of skygcs: as many digits as a float needs
        rounding: Rounding = "exact" if own and self._kind == "plain" else _rounding(self._kind, self._texts)
        entries = tuple(
            replace(entry, slack=_slack(rounding, entry.value, text))
            for entry, text in zip(self.entries, self._texts, strict=True)
        )
        return ParamFile(self._kind, entries, self._separator, self._header, tuple(self._comments), rounding)

    def _plain_entry(self, number: int, line: str) -> tuple[Entry, str]:
        match = _PLAIN.fullmatch(line)
        if match is None:
            raise ValueError(f"{_clip(line)} is not of the form NAME,VALUE or NAME VALUE")
        name, written, rest = match.groups()
        _check_name(name)
        value = _number(written)
        if rest and not rest.startswith(("#", "@READONLY")):
            raise ValueError(f"{_clip(rest)} follows the value; a comment begins with #")
        if not self.entries and not self._seen:
            self._separator = "," if "," in line[: line.index(written, len(name))] else " "
        return Entry(name, value, comment=rest, line=number), written


def _qgc_entry(number: int, line: str) -> tuple[Entry, str]:
    words = line.split("\t") if "\t" in line else line.split()
    if len(words) != 5:
        raise ValueError(f"has {len(words)} columns instead of 5 (vehicle, component, name, value, type)")
    vehicle, component, name, written, kind = (w.strip() for w in words)
    if not (vehicle.isdigit() and component.isdigit() and int(vehicle) < 256 and int(component) < 256):
        raise ValueError(f"vehicle {_clip(vehicle)} or component {_clip(component)} is not a number from 0 to 255")
    _check_name(name)
    if not kind.isdigit() or not 1 <= int(kind) <= ParamType.REAL64:
        raise ValueError(f"{name}: type {_clip(kind)} is not a MAV_PARAM_TYPE (6 is a whole number, 9 a float)")
    type_ = ParamType(int(kind))
    value = _number(written)
    if not type_.integer:
        value = float(value)
    try:
        if type_ not in (ParamType.INT64, ParamType.UINT64, ParamType.REAL64):
            value = held_as(value, type_)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    return Entry(name, value, type_, int(vehicle), int(component), line=number), written


def _check_name(name: str) -> None:
    if not is_name(name):
        long = f", at most {NAME_CHARS}" if len(name) > NAME_CHARS else ""
        raise ValueError(f"{_clip(name)} is not a parameter name (letters, digits and _{long})")


def _number(text: str) -> Value:
    """Raises ValueError."""
    if _HEX.fullmatch(text):
        return int(text, 16)
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"{_clip(text)} is not a number")
    if len(text) > MAX_NUMBER_CHARS:
        raise ValueError(f"{_clip(text)} has more digits than any parameter")
    if not any(c in text for c in ".eE"):
        return int(text)
    value = float(text)
    try:
        float32(value)
    except OverflowError:
        raise ValueError(f"{_clip(text)} is too large for a 32-bit float") from None
    return value


def _rounding(kind: Kind, texts: Iterable[str]) -> Rounding:
    """How the writer of a file with these values rounds, if its digits show that beyond doubt."""
    floats = [text for text in texts if any(c in text for c in ".eE") and not _HEX.fullmatch(text)]
    decimals = {-1 if "e" in text.lower() else len(text.partition(".")[2]) for text in floats}
    if decimals == {QGC_DECIMALS} and kind == "qgc":
        return "18 decimals"
    if decimals == {MAVPROXY_DECIMALS} and kind == "plain":
        return "6 decimals"
    if kind == "plain" and max(map(_digits, floats), default=0) == MISSION_PLANNER_DIGITS:
        return "7 digits"
    return "exact"


def _digits(text: str) -> int:
    """Significant digits of a number that has a point or an exponent."""
    mantissa = re.split("[eE]", text.lstrip("+-"), maxsplit=1)[0]
    return len(mantissa.replace(".", "").lstrip("0"))


def _slack(rounding: Rounding, value: Value, text: str) -> float:
    fraction = "." in text or "e" in text.lower()
    match rounding:
        case "6 decimals" if fraction:
            return 0.5 * 10.0**-MAVPROXY_DECIMALS
        case "18 decimals" if fraction:
            return 0.5 * 10.0**-QGC_DECIMALS
        case "7 digits" if value and (fraction or abs(value) < 10**MISSION_PLANNER_DIGITS):
            return 0.5 * 10.0 ** (math.floor(math.log10(abs(value))) + 1 - MISSION_PLANNER_DIGITS)
    return 0.0


def _clip(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:40] + "…")


def write(file: ParamFile) -> str:
    """The file's text; `parse` is the inverse."""
    lines = list(file.header)
    for entry in file.entries:
        lines += entry.above
        if file.kind == "qgc":
            lines.append(_qgc_line(entry))
        else:
            lines.append(_plain_line(entry, file.separator))
    lines += file.footer
    return "\n".join(lines) + "\n"


def _qgc_line(entry: Entry) -> str:
    type_ = entry.type or (ParamType.INT32 if isinstance(entry.value, int) else ParamType.REAL32)
    columns = (entry.sysid or 1, entry.compid or 1, entry.name, _qgc_value(entry.value), int(type_))
    return "\t".join(map(str, columns))


def _qgc_value(value: Value) -> str:
    if isinstance(value, int):
        return str(value)
    fixed = f"{value:.{QGC_DECIMALS}f}"
    return fixed if float(fixed) == value else repr(value)


def _plain_line(entry: Entry, separator: str) -> str:
    text = repr(entry.value)  # the shortest text that reads as the same number; a float has a point or an exponent
    line = f"{entry.name:<{NAME_CHARS}} {text}" if separator == " " else f"{entry.name},{text}"
    return f"{line}  {entry.comment}" if entry.comment else line


def of_vehicle(
    params: Iterable[Param], kind: Kind, *, sysid: int, compid: int, about: dict[str, str], separator: str = ","
) -> ParamFile:
    """A file of a vehicle's parameters, sorted by name. ``about``: Stack, Vehicle and Version for the header.

    A value that is not finite cannot be written and is left out.
    """
    header = [f"# Onboard parameters for Vehicle {sysid}", "#", *(f"# {k}: {v}" for k, v in about.items()), "#"]
    if kind == "qgc":
        header.append("# Vehicle-Id Component-Id Name Value Type")
    entries = [
        Entry(p.name, p.value, p.type, sysid, compid) if kind == "qgc" else Entry(p.name, _shortest(p.value))
        for p in sorted(params, key=lambda p: p.name)
        if math.isfinite(p.value)
    ]
    return ParamFile(kind, tuple(entries), separator, tuple(header))


def _shortest(value: Value) -> Value:
    """The shortest text of a 32-bit float, such as 0.1; read again it gives the same float."""
    return value if isinstance(value, int) else float(short_float(value))
