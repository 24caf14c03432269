"""The lines that a person has typed at shells before, in a file of the user."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from skygcs.config.files import write_whole

MAX_LINES = 500
MAX_FILE_BYTES = 64 * 1024
"""Room for `MAX_LINES` of the longest that a shell takes; a longer file's end is read."""


def history_file() -> Path | None:
    """$XDG_STATE_HOME/skygcs/shell_history, by default below ~/.local/state; None for a user without a home."""
    base = os.environ.get("XDG_STATE_HOME")
    try:
        folder = Path(base) if base else Path.home() / ".local" / "state"
    except RuntimeError:
        return None
    return folder / "skygcs" / "shell_history"


def read_history(path: Path) -> list[str]:
    """The newest lines, oldest first; none if there is no such file or it cannot be read."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - MAX_FILE_BYTES))
            data = file.read(MAX_FILE_BYTES)
    except OSError:
        return []
    lines = data.decode("ascii", "replace").split("\n")
    whole = lines[1:] if size > MAX_FILE_BYTES else lines
    return [line for line in whole if line and line.isprintable()][-MAX_LINES:]


def write_history(path: Path, lines: list[str]) -> None:
    """Keep the newest; a file that cannot be written is no error."""
    kept = [line for line in lines if line.strip() and line.isascii() and line.isprintable()][-MAX_LINES:]
    with contextlib.suppress(OSError):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(path, "".join(f"{line}\n" for line in kept).encode("ascii", "replace"), 0o600, durable=False)
