"""The time of each signing key on disk, so that it never goes back: not by a restart, a crash or a wrong clock."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import NamedTuple

from skygcs.core.mavlink.signing import MAX_TIMESTAMP, TICKS_PER_S

FORMAT = 1

AFTER_CRASH_S = 60.0
"""What may have been used since the last save. Saved is every 10 s or as soon as a clock jumps further; ArduPilot takes
a minute, too."""

MAX_FILE_BYTES = 4096


def default_state_dir() -> Path | None:
    """$XDG_STATE_HOME/skygcs/signing, by default below ~/.local/state; None for a user without a home."""
    base = os.environ.get("XDG_STATE_HOME")
    try:
        folder = Path(base) if base else Path.home() / ".local" / "state"
    except RuntimeError:
        return None
    return folder / "skygcs" / "signing"


class Kept(NamedTuple):
    """What was kept of a key."""

    timestamp: int
    """To go on from: later than any that was used."""
    wall: int
    """What this computer's clock showed then; 0 in files of before it was kept."""


class SigningStore:
    """One file per key, named by its id; it holds no key. ``problem`` says why the last access failed, or is empty."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self.problem = "" if folder is not None else "there is no folder to keep the time of the keys in"

    def load(self, key_id: str) -> Kept:
        """What was kept of the key; zeros if nothing was."""
        if self._folder is None:
            return Kept(0, 0)
        path = self._path(key_id)
        try:
            with open(path, "rb") as file:
                table = json.loads(file.read(MAX_FILE_BYTES))
            if table["format"] != FORMAT:
                raise ValueError(f"format {table['format']}")
            timestamp, exact = int(table["timestamp"]), bool(table["exact"])
            wall = min(max(int(table.get("wall", 0)), 0), MAX_TIMESTAMP)
        except FileNotFoundError:
            return Kept(0, 0)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            self.problem = f"{path} cannot be read ({error})"
            return Kept(0, 0)
        margin = 0 if exact else int(AFTER_CRASH_S * TICKS_PER_S)
        return Kept(min(max(timestamp, 0) + margin, MAX_TIMESTAMP), wall)

    def save(self, key_id: str, timestamp: int, *, wall: int, exact: bool) -> None:
        """Keep it, whole or not at all; ``exact``: none later will be used before the next `load`."""
        if self._folder is None:
            return
        path = self._path(key_id)
        name = None
        try:
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=self._folder, suffix=".tmp")
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                json.dump({"format": FORMAT, "timestamp": timestamp, "wall": wall, "exact": exact}, file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(name, path)
        except OSError as error:
            if name is not None:
                Path(name).unlink(missing_ok=True)
            self.problem = f"{path} cannot be written ({error.strerror})"
        else:
            self.problem = ""

    def _path(self, key_id: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{key_id}.json"
