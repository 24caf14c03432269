"""Metadata of autopilot parameters: unit, range, meanings of values and bits, reboot, in a table that is searched.

A table is text with one line per parameter, sorted by name; fields are separated by tabs:

    name  unit  least  greatest  flags  values  bits  description
    MPC_XY_CRUISE   m/s  3  20                          Default horizontal velocity in autonomous modes
    NAV_RCL_ACT          1  6      1=Hold mode|2=Return mode|3=Land mode|…       Set RC loss failsafe mode

The first line begins with # and names the source. Flags: r: a change takes effect after a reboot; z: 0 is no value of
the range but switches it off, as in most parameters of ArduPilot. A name with # for its
numbers (SERVO#_MIN) holds for all instances that have no line of their own. A table is never unpacked: a lookup reads
the lines that it needs, so that 8,000 parameters cost no memory but the bytes of the file while it is read.

The files that tables are made of are PX4's (the one of MAVLink's component metadata), which a vehicle has on board and
names in a general one (`general_file`), and ArduPilot's, which it publishes. Whatever is not as specified is passed
over: one entry, one bound, one meaning.
"""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

from skygcs.core.mavlink.param_encoding import NAME_CHARS, Value, float32, is_name, value_text
from skygcs.spelling import enumerated

MAX_PARAMS = 10_000
"""In a vehicle's own file: PX4 has some 1800."""

MAX_TEXT_CHARS = 100
MAX_MEANINGS = 300
"""Meanings of one parameter that are kept: SERVO1_FUNCTION of ArduPilot has some 170."""

MAX_BITS = 64
MAX_FLOAT = 3.4e38
"""Largest float of 32 bits, rounded down."""

MAX_NAMED = 8
"""Meanings that a sentence names."""

_DIGITS = re.compile(r"\d+")
_FIELDS = 8


@dataclass(frozen=True, slots=True)
class ParamMetadata:
    """Metadata of one parameter. ``least`` and ``greatest``: its range in ``unit``, as the firmware's authors recommend
    it; None: no bound is named. ``values``: meanings of whole values; ``bits``: of the bits of a mask, by their index.
    ``reboot``: a change takes effect after a reboot. ``zero_is_off``: 0 is right although it is not in the range."""

    name: str
    unit: str = ""
    least: float | None = None
    greatest: float | None = None
    reboot: bool = False
    values: Mapping[float, str] = field(default_factory=dict)
    bits: Mapping[int, str] = field(default_factory=dict)
    description: str = ""
    zero_is_off: bool = False

    def range_text(self) -> str:
        """The range with its unit: "3 to 20 m/s", "at least 0 s"; empty without a bound."""
        unit = f" {self.unit}" if self.unit else ""
        if self.least is None:
            return "" if self.greatest is None else f"at most {value_text(self.greatest)}{unit}"
        if self.greatest is None:
            return f"at least {value_text(self.least)}{unit}"
        return f"{value_text(self.least)} to {value_text(self.greatest)}{unit}"

    def outside(self, value: Value) -> str:
        """The reason why a value is outside its range, as a sentence; empty: it is not. A value with a meaning of its
        own, such as -1 for "off", is never outside. Bounds are compared as 32-bit floats, as on the vehicle."""
        low = self.least is not None and value < float32(self.least) and value < self.least
        high = self.greatest is not None and value > float32(self.greatest) and value > self.greatest
        if not (low or high) or (self.zero_is_off and value == 0) or self._listed(value) is not None:
            return ""
        return f"{value_text(value)} is outside its range of {self.range_text()}"

    def without_meaning(self, value: Value) -> str:
        """The reason why a value inside the range is no good choice; empty: it has a meaning, or needs none."""
        numbered = bool(self.values) and all(v == int(v) for v in self.values if math.isfinite(v))
        if not numbered or self.range_text() or self._listed(value) is not None:
            return ""
        known = [f"{value_text(v)} {text}" for v, text in self.values.items()]
        return f"{value_text(value)} has no known meaning; there are: {enumerated(known, MAX_NAMED)}"

    def meaning(self, value: Value) -> str:
        """The meaning of a value, or the bits of a mask that are set; empty if neither is known."""
        if (listed := self._listed(value)) is not None:
            return listed
        if not self.bits or not math.isfinite(value) or value != int(value) or value < 0:
            return ""
        return ", ".join(text for bit, text in self.bits.items() if int(value) >> bit & 1)

    def _listed(self, value: Value) -> str | None:
        """The meaning of a value that is listed, compared as 32-bit floats; None: it is not."""
        return next((text for key, text in self.values.items() if _as32(key) == _as32(value)), None)


class MetadataTable:
    """One table. ``data``: the bytes of it; see the module. Lines that are not well-formed are passed over."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    @property
    def source(self) -> str:
        """The line about its source, without the mark."""
        head = self._data.partition(b"\n")[0]
        return head[1:].decode("utf-8", "replace").strip() if head.startswith(b"#") else ""

    def of(self, names: Iterable[str]) -> dict[str, ParamMetadata]:
        """Metadata of parameters, by their own names, of those that the table has; in one pass."""
        wanted: defaultdict[bytes, list[str]] = defaultdict(list)
        for name in names:
            for key in dict.fromkeys((name, _DIGITS.sub("#", name))):
                wanted[key.encode()].append(name)
        known: dict[str, ParamMetadata] = {}
        for line in self._data.split(b"\n"):
            for name in wanted.get(line.partition(b"\t")[0], ()):
                entry = decode(line.decode("utf-8", "replace"))
                if entry is not None and (name not in known or entry.name == name):  # its own line before a general one
                    known[name] = entry
        return {name: replace(entry, name=name) for name, entry in known.items()}

    def outside(self, values: Mapping[str, Value]) -> dict[str, str]:
        """The sentences about those of many values that are outside their range, by name."""
        reasons = {name: entry.outside(values[name]) for name, entry in self.of(values).items()}
        return {name: why for name, why in reasons.items() if why}


def encode(known: ParamMetadata) -> str:
    """The line of one parameter, without its end."""

    def bound(value: float | None) -> str:
        return "" if value is None or not abs(value) <= MAX_FLOAT else value_text(value)

    return "\t".join(
        (
            known.name,
            _plain(known.unit),
            bound(known.least),
            bound(known.greatest),
            ("r" if known.reboot else "") + ("z" if known.zero_is_off else ""),
            "|".join(f"{_key(v)}={_plain(text)}" for v, text in list(known.values.items())[:MAX_MEANINGS]),
            "|".join(f"{bit}={_plain(text)}" for bit, text in list(known.bits.items())[:MAX_MEANINGS]),
            _plain(known.description),
        )
    )


def decode(line: str) -> ParamMetadata | None:
    """The parameter of a line; None if it is not well-formed."""
    parts = line.split("\t")
    if len(parts) != _FIELDS or not 0 < len(parts[0]) <= NAME_CHARS:
        return None
    name, unit, least, greatest, flags, values, bits, description = parts
    try:
        return ParamMetadata(
            name,
            unit,
            _bound(least),
            _bound(greatest),
            "r" in flags,
            {float(value): text for value, text in _pairs(values)},
            {int(bit): text for bit, text in _pairs(bits) if 0 <= int(bit) < MAX_BITS},
            description,
            "z" in flags,
        )
    except ValueError:
        return None


def table(known: Iterable[ParamMetadata], source: str) -> bytes:
    """A whole table. Instances of one parameter (SERVO1_MIN, SERVO2_MIN) whose metadata are equal, but for numbers in
    their descriptions, become one line; those that differ from most keep lines of their own."""
    instances: defaultdict[str, list[ParamMetadata]] = defaultdict(list)
    for entry in known:
        instances[_DIGITS.sub("#", entry.name)].append(entry)
    lines = []
    for pattern, entries in instances.items():
        general = [encode(_general(entry, pattern)) for entry in entries]
        common, count = Counter(general).most_common(1)[0]
        if count > 1:
            lines.append(common)
        lines.extend(encode(e) for e, line in zip(entries, general, strict=True) if count == 1 or line != common)
    return "\n".join((f"# {_plain(source, 400)}", *sorted(lines), "")).encode()


def merged(entries: Iterable[ParamMetadata]) -> Iterator[ParamMetadata]:
    """One entry per name, of several versions and vehicle types: the first counts, the range is the widest, and all
    meanings are kept. Where the units differ no range holds for all, and none is kept."""
    for _, group in groupby(sorted(entries, key=lambda entry: entry.name), key=lambda entry: entry.name):
        versions = list(group)
        first = versions[0]
        units = {entry.unit.lower() for entry in versions}
        least = [entry.least for entry in versions if entry.least is not None]
        greatest = [entry.greatest for entry in versions if entry.greatest is not None]
        yield replace(
            first,
            unit=first.unit if len(units) == 1 else "",
            least=min(least) if len(least) == len(versions) and len(units) == 1 else None,
            greatest=max(greatest) if len(greatest) == len(versions) and len(units) == 1 else None,
            reboot=any(entry.reboot for entry in versions),
            zero_is_off=any(entry.zero_is_off for entry in versions),
            values={value: text for entry in reversed(versions) for value, text in entry.values.items()},
            bits={bit: text for entry in reversed(versions) for bit, text in entry.bits.items()},
        )


def _general(entry: ParamMetadata, pattern: str) -> ParamMetadata:
    return replace(entry, name=pattern, description=_DIGITS.sub("#", entry.description))


def _as32(value: float) -> float:
    return float32(value) if abs(value) <= MAX_FLOAT else value


def _key(value: float) -> str:
    """A value with all its digits: some are baud rates and masks."""
    return str(int(value)) if math.isfinite(value) and value == int(value) else repr(value)


def _bound(text: str) -> float | None:
    value = float(text) if text else math.nan
    return value if abs(value) <= MAX_FLOAT else None


def _pairs(text: str) -> Iterator[tuple[str, str]]:
    for pair in text.split("|") if text else ():
        key, _, meaning = pair.partition("=")
        yield key, meaning


def _plain(text: str, most: int = MAX_TEXT_CHARS) -> str:
    """One line without the marks of a table, and without control characters: a vehicle's file may have any."""
    words = "".join(c if c.isprintable() else " " for c in text).replace("|", "/").split()
    line = " ".join(words)
    return line if len(line) <= most else line[: most - 1] + "…"


PARAMETER_TYPE = 1
"""COMP_METADATA_TYPE_PARAMETER."""

FTP_SCHEME = "mftp"
_URI = re.compile(rf"{FTP_SCHEME}:(?://)?(?:\[;comp=(\d+)\])?(/?[^\s\x00/][^\s\x00]*)")


def ftp_path(uri: str) -> str | None:
    """The path on the vehicle of a URI such as mftp://etc/extras/parameters.json.xz; None for another scheme, or for a
    file of another component than the autopilot."""
    match = _URI.fullmatch(uri.rstrip("\x00").strip())
    return None if match is None or match[1] not in (None, "1") else match[2]


@dataclass(frozen=True, slots=True)
class FileEntry:
    """A file on the vehicle, and its CRC as MAVLink FTP reckons it; None if that is not given."""

    path: str
    crc: int | None


def general_file(document: Any) -> FileEntry | None:
    """The file of the parameter metadata that general metadata (general.schema.json) names; None: none is on board."""
    types = document.get("metadataTypes") if isinstance(document, dict) else None
    for entry in types if isinstance(types, list) else ():
        if not isinstance(entry, dict) or entry.get("type") != PARAMETER_TYPE:
            continue
        for uri in (entry.get("uri"), entry.get("uriFallback")):
            path = ftp_path(uri) if isinstance(uri, str) else None
            if path is not None:
                crc = entry.get("fileCrc")
                return FileEntry(path, crc if isinstance(crc, int) and 0 <= crc < 1 << 32 else None)
    return None


def of_px4(document: Any) -> Iterator[ParamMetadata]:
    """The parameters of a file in the format of MAVLink's parameter.schema.json, version 1."""
    entries = document.get("parameters") if isinstance(document, dict) else None
    for entry in entries[:MAX_PARAMS] if isinstance(entries, list) else ():
        if not isinstance(entry, dict) or not is_name(str(entry.get("name", ""))):
            continue
        yield ParamMetadata(
            entry["name"],
            _text(entry.get("units")),
            _number(entry.get("min")),
            _number(entry.get("max")),
            entry.get("rebootRequired") is True,
            dict(_meanings(entry.get("values"), "value")),
            _bits(_meanings(entry.get("bitmask"), "index")),
            _text(entry.get("shortDesc")),
        )


def of_ardupilot(document: Any) -> Iterator[ParamMetadata]:
    """The parameters of an apm.pdef.json: groups of parameters by name. Parameters of the simulator are left out.

    0 is taken for "off" where the range begins above it: 18 of the 1,009 values that an ArduCopter 4.7 begins with.
    """
    for group in document.values() if isinstance(document, dict) else ():
        for name, entry in group.items() if isinstance(group, dict) else ():
            if not isinstance(entry, dict) or not is_name(name) or name.startswith("SIM_"):
                continue
            bounds = entry.get("Range")
            bounds = bounds if isinstance(bounds, dict) else {}
            least = _number(bounds.get("low"))
            yield ParamMetadata(
                name,
                _text(entry.get("Units")),
                least,
                _number(bounds.get("high")),
                entry.get("RebootRequired") == "True",
                dict(_numbered(entry.get("Values"))),
                _bits(_numbered(entry.get("Bitmask"))),
                _text(entry.get("DisplayName")),
                zero_is_off=least is not None and least > 0,
            )


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if abs(number) <= MAX_FLOAT else None


def _meanings(entries: Any, key: str) -> Iterator[tuple[float, str]]:
    for entry in entries if isinstance(entries, list) else ():
        number = _number(entry.get(key)) if isinstance(entry, dict) else None
        if number is not None:
            yield number, _text(entry.get("description"))


def _bits(meanings: Iterable[tuple[float, str]]) -> dict[int, str]:
    return {int(bit): text for bit, text in meanings if bit == int(bit) and 0 <= bit < MAX_BITS}


def _numbered(meanings: Any) -> Iterator[tuple[float, str]]:
    """Meanings in the order of their numbers."""
    entries: Mapping[Any, Any] = meanings if isinstance(meanings, dict) else {}
    found = [(number, _text(text)) for key, text in entries.items() if (number := _number(key)) is not None]
    yield from sorted(found)
