"""Files of `control record`, read row by row."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from skygcs.core.control.trace import LARGEST_LINE, Trace, decode
from skygcs.errors import SkygcsError, TraceError


@contextlib.contextmanager
def read_trace(path: Path) -> Iterator[Trace]:
    """An open trace. Raises SkygcsError, here and while it is read, that names the file and the line."""
    try:
        with path.open(encoding="utf-8", errors="replace", newline="") as file:
            yield decode(_lines(file))
    except TraceError as error:
        raise SkygcsError(f"{path}:{error.line}: {error.reason}") from None
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}") from None


def _lines(file: TextIO) -> Iterator[str]:
    """Lines with their newlines; a file without any is not read whole."""
    while line := file.readline(LARGEST_LINE + 2):
        yield line
