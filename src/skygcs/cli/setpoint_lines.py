"""Setpoints as lines of text, from the user's own program: one JSON object or one row of CSV each. Pure.

{"pos": [1, 2, 5], "yaw_deg": 90}                 also "vel", "acc", "vehicle"
{"vehicle": "bravo", "vel": [0.5, 0, 0]}
x,y,z,yaw_deg                                     a header names the columns of the rows below it
1,2,5,90
1,2,5                                             without a header: x, y, z and perhaps the yaw
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from skygcs.cli.parsing import parse_json

LARGEST_LINE = 1024
"""Bytes. A setpoint with all its numbers has some 300."""

VECTORS = {
    "pos": ("pos_enu_m", ("x", "y", "z")),
    "vel": ("vel_enu_mps", ("vx", "vy", "vz")),
    "acc": ("acc_enu_mps2", ("ax", "ay", "az")),
}
"""By the key in JSON: the parameter of control.setpoint, and its columns in CSV."""

YAW = "yaw_deg"
VEHICLE = "vehicle"
COLUMNS = (*(column for _, columns in VECTORS.values() for column in columns), YAW, VEHICLE)
DEFAULT_COLUMNS = ("x", "y", "z", YAW)


class LineError(Exception):
    """One line that is no setpoint; says why."""


class SplitLines:
    """Bytes as they come, to lines with their numbers. One that is too long is told as such and skipped."""

    def __init__(self) -> None:
        self._rest = b""
        self._number = 0
        self._skipping = False

    def feed(self, data: bytes) -> Iterator[tuple[int, str | None]]:
        """Number and text of every line that is complete now; None for one that was too long."""
        *lines, rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._number += 1
            too_long, self._skipping = self._skipping or len(line) > LARGEST_LINE, False
            yield self._number, None if too_long else line.decode("utf-8", "replace").strip()
        self._skipping = self._skipping or len(rest) > LARGEST_LINE
        self._rest = b"" if self._skipping else rest

    def end(self) -> Iterator[tuple[int, str | None]]:
        """A last line without its newline is one, too."""
        if self._rest or self._skipping:
            yield from self.feed(b"\n")


class LineReader:
    """Lines to parameters of control.setpoint, remembering the columns that a header named."""

    def __init__(self) -> None:
        self._columns: tuple[str, ...] | None = None
        self._began = False

    def read(self, line: str) -> tuple[str | None, dict[str, Any]] | None:
        """The vehicle it is for (None: all that were named) and the setpoint; None if there is none in the line.

        Raises LineError.
        """
        if not line or line.startswith("#"):
            return None
        if line.startswith("{"):
            return _from_json(line)
        cells = [cell.strip() for cell in line.split(",")]
        first, self._began = not self._began, True
        if first and any(cell in COLUMNS for cell in cells) and not any(_is_text_of_number(cell) for cell in cells):
            self._columns = _header(cells)
            return None
        return _from_cells(line, cells, self._columns)


def _from_json(line: str) -> tuple[str | None, dict[str, Any]]:
    try:
        given = parse_json(line)
    except (ValueError, RecursionError) as error:
        raise LineError(f"not JSON: {error}") from None
    unknown = [key for key in given if key not in (*VECTORS, YAW, VEHICLE)]
    if unknown:
        raise LineError(f"no key {unknown[0][:40]!r}; there are: {', '.join((*VECTORS, YAW, VEHICLE))}")
    setpoint: dict[str, Any] = {}
    for key, (parameter, _) in VECTORS.items():
        if key in given:
            value = given[key]
            if not (isinstance(value, list) and len(value) == 3 and all(x is None or _is_number(x) for x in value)):
                raise LineError(f"{key}: three numbers are wanted (null: not given)")
            setpoint[parameter] = [None if x is None else float(x) for x in value]
    if given.get(YAW) is not None:
        if not _is_number(given[YAW]):
            raise LineError(f"{YAW}: a number is wanted")
        setpoint[YAW] = float(given[YAW])
    vehicle = given.get(VEHICLE)
    if vehicle is not None and not isinstance(vehicle, str | int):
        raise LineError(f"{VEHICLE}: a name or a system id is wanted")
    return (None if vehicle is None else str(vehicle)), checked(setpoint)


def _header(cells: list[str]) -> tuple[str, ...]:
    unknown = [cell for cell in cells if cell not in COLUMNS]
    if unknown:
        raise LineError(f"no column {unknown[0][:40]!r}; there are: {', '.join(COLUMNS)}")
    if len(set(cells)) != len(cells):
        raise LineError("a column is there twice")
    return tuple(cells)


def _from_cells(line: str, cells: list[str], columns: tuple[str, ...] | None) -> tuple[str | None, dict[str, Any]]:
    if columns is None:
        if len(cells) not in (3, 4):
            raise LineError(f"{line[:40]!r} is neither JSON nor a row x,y,z or x,y,z,yaw_deg")
        columns = DEFAULT_COLUMNS[: len(cells)]
    if len(cells) != len(columns):
        raise LineError(f"{len(cells)} cells; the header has {len(columns)}")
    row = {column: cell for column, cell in zip(columns, cells, strict=True) if cell}
    vehicle = row.pop(VEHICLE, None)
    values = {column: _number(column, cell) for column, cell in row.items()}
    setpoint: dict[str, Any] = {}
    for parameter, names in VECTORS.values():
        if any(name in values for name in names):
            setpoint[parameter] = [values.get(name) for name in names]
    if YAW in values:
        setpoint[YAW] = values[YAW]
    return vehicle, checked(setpoint)


def checked(setpoint: Mapping[str, Any]) -> dict[str, Any]:
    """The setpoint, if every axis is told where to go or how fast. Raises LineError."""
    position = setpoint.get("pos_enu_m") or [None] * 3
    velocity = setpoint.get("vel_enu_mps") or [None] * 3
    if not any(value is not None for value in (*position, *velocity)):
        raise LineError("neither a position nor a velocity")
    if (position[0] is None) != (position[1] is None):
        raise LineError("a position of x or y alone: give both, or neither")
    for axis, p, v in zip("xyz", position, velocity, strict=True):
        if p is None and v is None:
            raise LineError(f"{axis} has neither a position nor a velocity")
    if None in setpoint.get("acc_enu_mps2", ()):
        raise LineError("an acceleration needs all three axes")
    return dict(setpoint)


def _number(column: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise LineError(f"{column}: {cell[:40]!r} is not a number") from None
    if not math.isfinite(value):
        raise LineError(f"{column}: {cell[:40]!r} is not a finite number")
    return value


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_text_of_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
