"""Files of parameter metadata: PX4's (the one of MAVLink's component metadata) and ArduPilot's, decoded.

PX4 has its file on board and names it in a general one (`general_file`); ArduPilot publishes its file. Whatever is not
as specified is passed over: one entry, one bound, one meaning.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from skygcs.core.mavlink.param_encoding import is_name
from skygcs.core.params.metadata import MAX_BITS, MAX_FLOAT, MAX_PARAMS, ParamMetadata

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
