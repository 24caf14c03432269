"""Tables of initial and final positions of many vehicles: the file, and what is wrong with it.

CSV, a row for each vehicle (columns that nobody needs may be missing):

    vehicle,initial_x,initial_y,initial_z,initial_heading_deg,final_x,final_y,final_z,final_heading_deg
    alpha,0,0,5,,10,0,5,90

or TOML:

    [vehicles.alpha]
    initial = [0, 0, 5]
    final = [10, 0, 5]
    final_heading_deg = 90

Metres in the fleet's frame (x, y, up, as `goto --enu` takes them), headings clockwise from north (as `goto --yaw`).
"""

from __future__ import annotations

import csv
import io
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

from skygcs.errors import ConfigError, SkygcsError

Which = Literal["initial", "final"]
Point = tuple[float, float, float]

AXES = ("x", "y", "z")
LARGEST_FILE = 1 << 20
"""Bytes; 255 vehicles need some 20 kB."""

MOST_VEHICLES = 255
LARGEST_M = 1e5
"""100 km: beyond it somebody has mixed up metres and degrees or microdegrees."""


@dataclass(frozen=True, slots=True)
class Spot:
    """Where one vehicle shall be. ``heading_deg`` clockwise from north; None: as it is."""

    position_m: Point
    heading_deg: float | None = None


Table = dict[str, dict[Which, Spot]]
"""By vehicle as the file names it, in its order; a vehicle may have one of the two only."""


@dataclass(frozen=True, slots=True)
class Near:
    """Two that are, or come, closer than the separation."""

    one: str
    other: str
    distance_m: float
    at: float = 0.0
    """Of paths: how far on the way, in metres flown by each."""


def read_table(path: Path) -> Table:
    """Raises ConfigError with every problem, and SkygcsError if it cannot be read."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}") from None
    if len(data) > LARGEST_FILE:
        raise SkygcsError(f"{path}: larger than 1 MiB: no table of positions")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SkygcsError(f"{path}: not UTF-8 at byte {error.start}") from None
    problems: list[str] = []
    table = (_from_toml if path.suffix.lower() == ".toml" else _from_csv)(text, problems)
    if not table and not problems:
        problems.append("there is no vehicle in it")
    if len(table) > MOST_VEHICLES:
        problems.append(f"{len(table)} vehicles; there are at most {MOST_VEHICLES} system ids")
    if problems:
        raise ConfigError(str(path), problems)
    return table


def spots(table: Table, which: Which) -> dict[str, Spot]:
    """One column of it."""
    return {name: places[which] for name, places in table.items() if which in places}


def too_near(points: Mapping[str, Point], separation_m: float) -> list[Near]:
    """Pairs of places closer than the separation."""
    pairs = combinations(points.items(), 2)
    found = (Near(one, other, math.dist(p, q)) for (one, p), (other, q) in pairs)
    return [near for near in found if near.distance_m < separation_m]


def crossings(starts: Mapping[str, Point], goals: Mapping[str, Point], separation_m: float) -> list[Near]:
    """Pairs that come closer than the separation on their way, nearest first.

    The model: all set off at once, straight, at the same speed, and stay where they arrive; who has no goal stays where
    it starts. Pairs that only move apart are none, however close they begin, and two that stay neither.
    """
    found = []
    for one, other in combinations(starts, 2):
        legs = [(starts[name], goals.get(name, starts[name])) for name in (one, other)]
        if all(start == goal for start, goal in legs):
            continue
        distance, at = _closest(*legs)
        comes_closer = distance < math.dist(starts[one], starts[other]) - 0.01
        if comes_closer and distance < separation_m:
            found.append(Near(one, other, distance, at))
    return sorted(found, key=lambda near: near.distance_m)


def _closest(one: tuple[Point, Point], other: tuple[Point, Point]) -> tuple[float, float]:
    """Least distance of two legs flown at 1 m/s, and when. Between arrivals the relative motion is straight."""
    lengths = sorted(math.dist(*leg) for leg in (one, other))
    best = (math.dist(one[0], other[0]), 0.0)
    begin = 0.0
    for end in lengths:
        if end > begin:
            p, q = (_difference(_along(one, t), _along(other, t)) for t in (begin, end))
            d = _difference(q, p)
            square = sum(x * x for x in d)
            part = 0.0 if square == 0.0 else min(max(-sum(a * b for a, b in zip(p, d, strict=True)) / square, 0.0), 1.0)
            nearest = math.hypot(*(a + part * b for a, b in zip(p, d, strict=True)))
            best = min(best, (nearest, begin + part * (end - begin)))
        begin = end
    return best


def _along(leg: tuple[Point, Point], flown_m: float) -> Point:
    start, goal = leg
    length = math.dist(start, goal)
    part = 1.0 if flown_m >= length else flown_m / length
    x, y, z = (a + part * (b - a) for a, b in zip(start, goal, strict=True))
    return x, y, z


def _difference(p: Point, q: Point) -> Point:
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


# --- reading ---------------------------------------------------------------------------------------------------------


def _from_csv(text: str, problems: list[str]) -> Table:
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not lines:
        return {}
    rows = list(csv.reader(io.StringIO("\n".join(line for _, line in lines)), skipinitialspace=True))
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
            problems.append(f"line {number}: " + (f"{name} is there twice" if name else "no vehicle is named"))
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
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        problems.append(str(error))
        return {}
    vehicles = document.pop("vehicles", {})
    problems += [f"{key}: unknown; there are tables [vehicles.NAME]" for key in document]
    if not isinstance(vehicles, dict):
        problems.append("vehicles: tables [vehicles.NAME] are wanted")
        return {}
    table: Table = {}
    for name, places in vehicles.items():
        if not isinstance(places, dict):
            problems.append(f"vehicles.{name}: a table with initial and final is wanted")
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
            heading = _number(f"{where}: {heading_key}", given[heading_key], 360.0, problems)
        values = given.get(which)
        if values is None:
            if heading is not None:
                problems.append(f"{where}: {heading_key} without a position")
            continue
        if not isinstance(values, list) or len(values) != 3:
            problems.append(f"{where}: {which}: three numbers x, y, z are wanted")
            continue
        numbers = [_number(f"{where}: {which} {a}", v, LARGEST_M, problems) for a, v in zip(AXES, values, strict=True)]
        x, y, z = (0.0 if number is None else number for number in numbers)
        places[which] = Spot((x, y, z), heading)
    if not given.keys() & {"initial", "final"}:
        problems.append(f"{where}: neither an initial nor a final position")
    return places


def _number(where: str, value: Any, largest: float, problems: list[str]) -> float | None:
    """None, and a problem more, if it is none."""
    try:
        if value is None or isinstance(value, bool):
            raise ValueError
        number = float(value)
    except (TypeError, ValueError):
        problems.append(f"{where}: {'missing' if value is None else f'{value!r} is not a number'}")
        return None
    if not abs(number) <= largest:
        problems.append(f"{where}: {number:g} is not within ±{largest:g}")
        return None
    return number
