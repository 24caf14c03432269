"""Parts that all readers of plan files share: bounds, text, numbers, JSON. Nothing but PlanFileError leaves a
reader."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from typing import Any

from skygcs.core.trajectory.piecewise import MAX_POSITION_M, Trajectory
from skygcs.errors import PlanFileError, TrajectoryError

Trajectories = dict[str, Trajectory]
"""By the vehicle's name, in the order of the file; all on one clock that begins at 0."""

MAX_FILE_BYTES = 32 << 20
"""100 vehicles with 1000 pieces of degree 7 are about 25 MB as JSON."""

MAX_VEHICLES = 255
"""There are that many system ids."""

MAX_FLEET_PIECES = 100_000
"""Most pieces of all vehicles together: 100 vehicles for ten minutes at 1.6 pieces a second. Certifying them takes
seconds."""

MAX_NAME = 64
"""Characters of a vehicle's name."""


def text_of(source: str, data: bytes) -> str:
    """UTF-8 text, a byte order mark removed. Raises PlanFileError."""
    if len(data) > MAX_FILE_BYTES:
        raise PlanFileError(source, "", f"larger than {MAX_FILE_BYTES >> 20} MiB")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise PlanFileError(source, "", f"not UTF-8 at byte {error.start}") from None


def rows(source: str, text: str) -> Iterator[tuple[int, list[str]]]:
    """(line number, cells) of each line that is neither empty nor a comment (#). Raises PlanFileError."""
    for number, line in enumerate(io.StringIO(text), 1):
        stripped = line.strip()
        if not stripped or stripped.startswith("#"):
            continue
        try:
            cells = next(csv.reader([stripped], skipinitialspace=True, strict=True))
        except (csv.Error, StopIteration) as error:
            raise PlanFileError(source, f"line {number}", f"not CSV: {error}") from None
        yield number, [cell.strip() for cell in cells]


def number_of(source: str, where: str, what: str, value: Any, largest: float = MAX_POSITION_M) -> float:
    """A finite number of at most ``largest``; from text or JSON. Raises PlanFileError."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise PlanFileError(source, where, f"{what} is not a number")
    try:
        number = float(value)
    except (ValueError, OverflowError):
        raise PlanFileError(source, where, f"{what} is not a number: {str(value)[:40]!r}") from None
    if not abs(number) <= largest:  # also for NaN
        raise PlanFileError(source, where, f"{what} of {number:g} is not within ±{largest:g}")
    return number


def vehicle_name(source: str, where: str, name: Any) -> str:
    """A name that can be typed and printed. Raises PlanFileError."""
    if not isinstance(name, str) or not name.strip() or len(name) > MAX_NAME or not name.isprintable():
        raise PlanFileError(source, where, f"a vehicle's name has 1 to {MAX_NAME} printable characters")
    return name.strip()


def require_vehicles(source: str, count: int) -> None:
    """Raise PlanFileError for an empty list or too many."""
    if not count:
        raise PlanFileError(source, "", "it names no vehicle")
    if count > MAX_VEHICLES:
        raise PlanFileError(source, "", f"{count} vehicles; there are at most {MAX_VEHICLES} system ids")


def require_pieces(source: str, where: str, count: int) -> None:
    """Raise PlanFileError above `MAX_FLEET_PIECES`."""
    if count > MAX_FLEET_PIECES:
        raise PlanFileError(source, where, f"more than {MAX_FLEET_PIECES} pieces of all vehicles together")


def refused(source: str, where: str, error: TrajectoryError) -> PlanFileError:
    """The error of a trajectory as one of its file."""
    return PlanFileError(source, where, str(error))


def json_of(source: str, data: bytes) -> Any:
    """JSON in which no object has a key twice (one path of two would silently win). Raises PlanFileError."""
    try:
        return json.loads(text_of(source, data), object_pairs_hook=_unique, parse_constant=_no_constant)
    except RecursionError:
        raise PlanFileError(source, "", "nested too deeply") from None
    except ValueError as error:
        raise PlanFileError(source, "", f"not JSON: {str(error)[:200]}") from None


def require_unique_keys(source: str, text: str) -> None:
    """Raise PlanFileError for text that is not JSON, or in which an object has a key twice; NaN passes."""
    try:
        json.loads(text, object_pairs_hook=_unique)
    except RecursionError:
        raise PlanFileError(source, "", "nested too deeply") from None
    except ValueError as error:
        raise PlanFileError(source, "", f"not JSON: {str(error)[:200]}") from None


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        for key, _ in pairs:
            if key in seen:
                raise ValueError(f"the key {key[:40]!r} is there twice")
            seen.add(key)
    return found


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number")
