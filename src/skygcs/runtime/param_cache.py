"""Parameters of vehicles as they were read last, one file per vehicle, so that a reconnect transfers none.

A file that is missing, broken, of another format or of another firmware is no cache; one that cannot be written costs
the next connect a list, not a flight.
"""

from __future__ import annotations

import json
import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skygcs.core.mavlink.param_encoding import Param, ParamType, is_name
from skygcs.core.protocols.parameter_list import MAX_COUNT

FORMAT = 1
"""Raised whenever the file changes shape: older ones are then never read."""

MAX_FILES = 256
"""One per vehicle of the largest fleet; the ones unused for longest are removed first."""

MAX_FILE_BYTES = 2_000_000
"""Ten times the largest there is."""


@dataclass(frozen=True, slots=True)
class CacheKey:
    """Whose parameters: ``board`` is the autopilot's unique id, ``firmware`` its version and commit."""

    autopilot: str
    sysid: int
    compid: int
    board: str
    firmware: str


@dataclass(frozen=True, slots=True)
class CachedParams:
    """What was read. ``hash`` is PX4's over them, None for an autopilot without one: then only their number speaks."""

    params: tuple[Param, ...]
    hash: int | None


def default_cache_dir() -> Path | None:
    """$XDG_CACHE_HOME/skygcs/params, by default below ~/.cache; None for a user without a home."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = Path(base) if base else Path.home() / ".cache"
    except RuntimeError:
        return None
    return folder / "skygcs" / "params"


class ParamCache:
    """``folder`` None: nothing is kept."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def load(self, key: CacheKey) -> CachedParams | None:
        """What was stored for this vehicle with this firmware."""
        path = self._path(key)
        if path is None:
            return None
        try:
            if path.stat().st_size > MAX_FILE_BYTES:
                return None
            cached = _decode(json.loads(path.read_text(encoding="utf-8")), key)
            os.utime(path)
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return cached

    def store(self, key: CacheKey, cached: CachedParams) -> None:
        """Whole or not at all: written beside and renamed."""
        path = self._path(key)
        if path is None or len(cached.params) > MAX_COUNT:
            return
        handle, name = -1, None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                json.dump(_encode(cached, key), file, separators=(",", ":"))
            os.replace(name, path)
            self._prune(path.parent)
        except OSError:
            if name is not None:
                Path(name).unlink(missing_ok=True)

    def _path(self, key: CacheKey) -> Path | None:
        if self._folder is None:
            return None
        board = re.sub(r"[^0-9A-Za-z]", "", key.board)[:40] or "board"
        return self._folder / f"{key.autopilot}-{key.sysid}-{key.compid}-{board}.json"

    @staticmethod
    def _prune(folder: Path) -> None:
        files = sorted(folder.glob("*.json"), key=lambda p: p.stat().st_mtime)
        for path in files[: max(0, len(files) - MAX_FILES)]:
            path.unlink(missing_ok=True)


def _encode(cached: CachedParams, key: CacheKey) -> dict[str, Any]:
    """Floats as hexadecimal text: exact, and JSON has no NaN."""
    params = [[p.name, int(p.type), p.value if isinstance(p.value, int) else p.value.hex()] for p in cached.params]
    return {"format": FORMAT, "firmware": key.firmware, "hash": cached.hash, "params": params}


def _decode(table: dict[str, Any], key: CacheKey) -> CachedParams | None:
    """Raises KeyError, TypeError or ValueError on a table of another shape."""
    if table["format"] != FORMAT or table["firmware"] != key.firmware:
        return None
    params = tuple(
        Param(name, float.fromhex(value) if isinstance(value, str) else int(value), ParamType(kind))
        for name, kind, value in table["params"]
    )
    if not params or not all(is_name(p.name) for p in params):
        return None
    known = table["hash"]
    return CachedParams(params, None if known is None else int(known))
