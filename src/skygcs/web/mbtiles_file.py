"""Tiles of an MBTiles file: an SQLite database with the tables metadata and tiles (specification 1.3).

It is not trusted: it is opened to be read only, and `tiles` may be a view that joins without an index, never ends, or
makes what it returns. A query may read the tables of a map (`TABLES`) and do nothing else: no function, no recursion. A
value has a bounded size, SQLite a bounded heap and no file for what it sorts, and a query a bounded time and number of
steps.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
import time
from pathlib import Path
from typing import Any
from urllib.parse import quote

from skygcs.web.tile_set import (
    MAX_TILE_BYTES,
    TileFileError,
    TileRefusedError,
    TileSetInfo,
    attribution_of,
    bounds_of,
    picture_type,
    zooms_of,
)

MAGIC = b"SQLite format 3\0"

STEPS_A_LOOK, MAX_LOOKS = 1_000, 5_000
"""Steps of SQLite's machine between two looks at the query, and how many looks it may take: half a second of a
processor. A tile that an index finds takes some twenty steps."""

MOST_S = 3.0
"""Time for opening the file, and for each tile: looked at every `STEPS_A_LOOK`, as a step that copies a large value
takes long."""

CACHE_KIB = 2048

HEAP_BYTES = 64 << 20
"""Largest heap of SQLite in this process, once a file is open; the limit cannot be raised again."""

TABLES = frozenset({"metadata", "tiles", "map", "images", "tiles_shallow", "tiles_data"})
"""Those of the specification, and those that `tiles` is a view of where programs keep each picture once."""

RASTER = ("png", "jpg", "jpeg", "webp")

_METADATA = "SELECT name, value FROM metadata WHERE name IN ('format', 'bounds', 'attribution') LIMIT 10"
_LEAST = "SELECT zoom_level FROM tiles ORDER BY zoom_level LIMIT 1"
_MOST = "SELECT zoom_level FROM tiles ORDER BY zoom_level DESC LIMIT 1"
_FIRST = "SELECT tile_data FROM tiles WHERE zoom_level = ? LIMIT 1"
_TILE = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ? LIMIT 1"


class MbtilesFile:
    """An open MBTiles file. Raises TileFileError."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._looks = 0
        self._until = time.monotonic() + MOST_S
        self._denied = ""
        try:
            where = f"file:{quote(os.fsencode(path.absolute()))}?mode=ro&immutable=1"
            self._base = sqlite3.connect(where, uri=True, check_same_thread=False)
        except sqlite3.Error as error:
            raise TileFileError(path, str(error)) from None
        try:
            self.info = self._opened()
        except TileRefusedError as error:
            self.close()
            raise TileFileError(path, f"its first tile or a value of its metadata is {error}") from None
        except BaseException:
            self.close()
            raise

    def _opened(self) -> TileSetInfo:
        # what an untrusted database may cost
        self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_TILE_BYTES)
        self._base.set_progress_handler(self._on_steps, STEPS_A_LOOK)
        self._base.text_factory = lambda text: text.decode(errors="replace")
        for pragma in ("trusted_schema = OFF", "query_only = ON", "mmap_size = 0", f"cache_size = -{CACHE_KIB}"):
            self._ask(f"PRAGMA {pragma}")
        for pragma in ("temp_store = MEMORY", f"hard_heap_limit = {HEAP_BYTES}"):
            self._ask(f"PRAGMA {pragma}")
        self._base.set_authorizer(self._authorize)
        # what it says of itself
        told = {str(name): value for name, value in self._ask(_METADATA)}
        kind = str(told.get("format", "")).lower()
        if kind in ("pbf", "mvt"):
            raise TileFileError(self._path, "holds vector tiles (pbf); only pictures are drawn: png, jpg or webp")
        if kind not in ("", *RASTER):
            raise TileFileError(self._path, f"holds tiles of the format {kind[:20]!r}; drawn are png, jpg and webp")
        # what it has
        least = self._ask(_LEAST)
        if not least:
            raise TileFileError(self._path, "has no tiles")
        least_zoom, most_zoom = zooms_of(self._path, least[0][0], self._ask(_MOST)[0][0])
        _, tile_px = picture_type(_blob(self._ask(_FIRST, least_zoom)))
        bounds = bounds_of(str(told.get("bounds", "")).split(","))
        return TileSetInfo(least_zoom, most_zoom, tile_px, bounds, attribution_of(told.get("attribution")))

    def read(self, zoom: int, x: int, y: int) -> bytes | None:
        """A tile; None: there is none. Rows of MBTiles count from the south."""
        self._until = time.monotonic() + MOST_S
        found = self._ask(_TILE, zoom, x, (1 << zoom) - 1 - y)
        return _blob(found) if found else None

    def close(self) -> None:
        with contextlib.suppress(sqlite3.Error):
            self._base.close()

    def _on_steps(self) -> int:
        self._looks += 1
        return int(self._is_too_long())

    def _is_too_long(self) -> bool:
        return self._looks > MAX_LOOKS or time.monotonic() > self._until

    def _authorize(self, action: int, one: str | None, _two: str | None, base: str | None, _via: str | None) -> int:
        """SQLite's question while it prepares a query, also for each part of a view."""
        if action == sqlite3.SQLITE_SELECT:
            return sqlite3.SQLITE_OK
        # no base: a table of which no column is read
        if action == sqlite3.SQLITE_READ and base in ("main", None) and one is not None and one.lower() in TABLES:
            return sqlite3.SQLITE_OK
        self._denied = "a recursion" if action == sqlite3.SQLITE_RECURSIVE else repr((one or _two or "")[:40])
        return sqlite3.SQLITE_DENY

    def _ask(self, query: str, *values: int) -> list[tuple[Any, ...]]:
        """All rows; each query has a limit of them. Raises TileFileError; TileRefusedError for a value too large."""
        self._looks = 0
        try:
            return self._base.execute(query, values).fetchall()
        except sqlite3.DataError:
            raise TileRefusedError(f"larger than {MAX_TILE_BYTES >> 20} MiB") from None
        except MemoryError:
            raise TileFileError(self._path, f"needs more than {HEAP_BYTES >> 20} MiB to find a tile") from None
        except (sqlite3.Error, OverflowError) as error:
            if self._denied:
                what = f"its tiles need {self._denied}; only tables of a map are read: {', '.join(sorted(TABLES))}"
                raise TileFileError(self._path, what) from None
            if self._is_too_long():
                raise TileFileError(self._path, "a tile takes too long to find: its table has no index") from None
            raise TileFileError(self._path, f"is no MBTiles file that can be read: {error}") from None


def _blob(rows: list[tuple[Any, ...]]) -> bytes:
    value = rows[0][0] if rows else None
    if not isinstance(value, bytes):
        raise TileRefusedError("no picture")
    return value
