"""Plan files that a command is given: of one plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from skygcs.core.geo import Origin
from skygcs.core.plan.file_reading import MAX_FILE_BYTES
from skygcs.core.plan.plan_files import NamedFile, ReadPlan, read_together
from skygcs.core.trajectory import MotionLimits
from skygcs.errors import PlanFileError


def bytes_of(file: Path) -> bytes:
    """Return what a file holds, one byte more than is read at most. Raises PlanFileError."""
    try:
        with file.open("rb") as opened:
            return opened.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise PlanFileError(str(file), "", f"cannot be read: {error.strerror or error}") from None


def read_files(files: Sequence[Path], limits: MotionLimits, origin: Origin | None) -> ReadPlan:
    """One plan; several files are one timed plan together. Raises SkygcsError."""
    named = []
    for file in files:
        vehicle, given, path = str(file).partition("=")
        if given and vehicle and not file.exists():
            named.append(NamedFile(path, bytes_of(Path(path)), vehicle))
        else:
            named.append(NamedFile(str(file), bytes_of(file)))
    return read_together(named, limits, origin)
