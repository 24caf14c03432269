"""Tables of initial and final positions: the one reader, for `skygcs-cli table` and for the page. Pure.

CSV, a row for each vehicle (columns that are not needed may be missing):

    vehicle,initial_x,initial_y,initial_z,initial_heading_deg,final_x,final_y,final_z,final_heading_deg
    alpha,0,0,5,,10,0,5,90

or TOML:

    [vehicles.alpha]
    initial = [0, 0, 5]
    final = [10, 0, 5]
    final_heading_deg = 90

Metres in the fleet's frame (x, y, up), headings in degrees clockwise from north.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from skygcs.errors import ConfigError
from skygcs.spelling import parse_toml

Which = Literal["initial", "final"]
WHICH: tuple[Which, Which] = ("initial", "final")
Point = tuple[float, float, float]

AXES = ("x", "y", "z")
LARGEST_FILE = 1 << 20
"""Bytes; 255 vehicles need some 20 kB."""

MAX_PROBLEMS = 50
"""Problems that are told at once; a file of another kind has one in each line."""

MOST_VEHICLES = 255
LARGEST_M = 1e5
"""100 km: a larger number is a mistake, such as degrees or microdegrees in place of metres."""


@dataclass(frozen=True, slots=True)
class Spot:
    """Target of one vehicle. ``heading_deg`` is clockwise from north; None: the heading it has."""

    position_m: Point
    heading_deg: float | None = None


Table = dict[str, dict[Which, Spot]]
"""By vehicle, with the names and in the order of the file; a vehicle may have only one of the two positions."""


def parse_table(source: str, data: bytes) -> Table:
    """Read either format, TOML where the name ``source`` ends in .toml. Raises ConfigError with all problems."""
    if len(data) > LARGEST_FILE:
        raise ConfigError(source, ["larger than 1 MiB: not a table of positions"])
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(source, [f"not UTF-8 at byte {error.start}"]) from None
    problems: list[str] = []
    table = (_from_toml if source.lower().endswith(".toml") else _from_csv)(text, problems)
    if not table and not problems:
        problems.append("it names no vehicle")
    if len(table) > MOST_VEHICLES:
        problems.append(f"{len(table)} vehicles; there are at most {MOST_VEHICLES} system ids")
    if problems:
        more = [f"and {len(problems) - MAX_PROBLEMS:,} more"] if len(problems) > MAX_PROBLEMS else []
        raise ConfigError(source, [*problems[:MAX_PROBLEMS], *more])
    return table


def spots(table: Table, which: Which) -> dict[str, Spot]:
    """The initial or the final positions."""
    return {name: places[which] for name, places in table.items() if which in places}


def _from_csv(text: str, problems: list[str]) -> Table:
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not lines:
        return {}
    try:
        rows = list(csv.reader(io.StringIO("\n".join(line for _, line in lines)), skipinitialspace=True))
    except csv.Error as error:  # a cell of more than 131,072 characters
        problems.append(f"not CSV: {error}")
        return {}
    header = [cell.strip() for cell in rows[0]]
    wanted = ("vehicle", *(f"{w}_{c}" for w in ("initial", "final") for c in (*AXES, "heading_deg")))
    unknown = [cell for cell in header if cell not in wanted]
    if unknown or "vehicle" not in header or len(set(header)) < len(header):
        problems.append(f"line {lines[0][0]}: the columns are {', '.join(wanted)}{_but(unknown)}")
        return {}
    table: Table = {}
    for (number, _), row in zip(lines[1:], rows[1:], strict=False):
        if len(row) > len(header):
            problems.append(f"line {number}: {len(row)} cells; the header has {len(header)}")
            continue
        cells = {column: cell.strip() for column, cell in zip(header, row, strict=False) if cell.strip()}
        name = cells.pop("vehicle", "")
        if not name or name in table:
            problems.append(f"line {number}: " + (f"{name} has a row already" if name else "it names no vehicle"))
            continue
        table[name] = _places(f"line {number}", _csv_places(cells), problems)
    return table


def _but(unknown: Sequence[str]) -> str:
    return f"; not {unknown[0][:40]!r}" if unknown else ""


def _csv_places(cells: Mapping[str, str]) -> dict[str, Any]:
    places: dict[str, Any] = {}
    for which in ("initial", "final"):
        given = [cells.get(f"{which}_{axis}") for axis in AXES]
        if any(value is not None for value in given):
            places[which] = given
        if f"{which}_heading_deg" in cells:
            places[f"{which}_heading_deg"] = cells[f"{which}_heading_deg"]
    return places


def _from_toml(text: str, problems: list[str]) -> Table:
    try:
        document = parse_toml(text)
    except ValueError as error:
        problems.append(str(error))
        return {}
    vehicles = document.pop("vehicles", {})
    problems += [f"{key}: unknown; there are tables [vehicles.NAME]" for key in document]
    if not isinstance(vehicles, dict):
        problems.append("vehicles: must be tables [vehicles.NAME]")
        return {}
    table: Table = {}
    for name, places in vehicles.items():
        if not isinstance(places, dict):
            problems.append(f"vehicles.{name}: must be a table with initial and final")
            continue
        table[name] = _places(f"vehicles.{name}", places, problems)
    return table


def _places(where: str, given: Mapping[str, Any], problems: list[str]) -> dict[Which, Spot]:
    places: dict[Which, Spot] = {}
    known = {"initial", "final", "initial_heading_deg", "final_heading_deg"}
    problems += [f"{where}: no key {key[:40]!r}; there are {', '.join(sorted(known))}" for key in given.keys() - known]
    which: Which
    for which in ("initial", "final"):
        heading_key = f"{which}_heading_deg"
        heading = None
        if given.get(heading_key) is not None:
            heading = _coordinate(f"{where}: {heading_key}", given[heading_key], 360.0, problems)
        values = given.get(which)
        if values is None:
            if heading is not None:
                problems.append(f"{where}: {heading_key} without a position")
            continue
        if not isinstance(values, list) or len(values) != 3:
            problems.append(f"{where}: {which}: must be three numbers x, y, z")
            continue
        numbers = [
            _coordinate(f"{where}: {which} {a}", v, LARGEST_M, problems) for a, v in zip(AXES, values, strict=True)
        ]
        x, y, z = (0.0 if number is None else number for number in numbers)
        places[which] = Spot((x, y, z), heading)
    if not given.keys() & {"initial", "final"}:
        problems.append(f"{where}: neither an initial nor a final position")
    return places


def _coordinate(where: str, value: Any, largest: float, problems: list[str]) -> float | None:
    """The number; None if it is not one, with one more problem."""
    try:
        if value is None or isinstance(value, bool):
            raise ValueError
        number = float(value)
    except OverflowError:  # an integer of TOML beyond every float
        number = math.inf
    except (TypeError, ValueError):
        problems.append(f"{where}: {'missing' if value is None else f'{value!r} is not a number'}")
        return None
    if not abs(number) <= largest:
        problems.append(f"{where}: {number:g} is not within ±{largest:g}")
        return None
    return number
