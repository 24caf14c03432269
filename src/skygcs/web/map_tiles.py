"""The tiles beneath the fleet view, from one local file: read in a thread of their own, one after the other.

    request -> waiting (MAX_WAITING at most, else busy) -> read -> a picture within the limits, none, or refused

No tile is kept here: the system keeps what was read of the file, a browser what it has drawn. A browser asks again for
one that was busy or refused, and keeps that there is none. The first one of each reason is logged, with the file and
the key.
"""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import structlog

from skygcs.config.files import open_regular
from skygcs.web import mbtiles_file, pmtiles_file
from skygcs.web.mbtiles_file import MbtilesFile
from skygcs.web.pmtiles_file import PmtilesFile
from skygcs.web.tile_set import TileFileError, TileRefusedError, TileSet, is_tile, picture_type

MAX_WAITING = 64
"""Requests for tiles of all pages at once; a page asks for six."""

RETRY_S = 1
"""After which a busy tile may be asked for again: more than it takes to read all that wait."""

MAX_REASONS = 20
"""That are remembered as logged."""

_log = structlog.get_logger(__name__)


class TilesBusyError(Exception):
    """Too many requests wait: ask again after `RETRY_S`."""


def open_tiles(path: Path) -> TileSet:
    """Open a file of tiles, by its first bytes. Raises TileFileError."""
    try:
        with open_regular(path) as file:
            begins = file.read(16)
    except OSError as error:
        raise TileFileError(path, error.strerror or str(error)) from None
    if begins.startswith(mbtiles_file.MAGIC):
        return MbtilesFile(path)
    if begins.startswith(pmtiles_file.MAGIC):
        return PmtilesFile(path)
    raise TileFileError(path, "is neither MBTiles nor PMTiles")


def _thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, thread_name_prefix="map tiles")


class MapTiles:
    """Serves the tiles of an open file. `close` ends it. Raises TileFileError."""

    @classmethod
    async def opened(cls, path: Path) -> MapTiles:
        """Open a file in the thread that will read it: an untrusted one may take seconds. Raises TileFileError."""
        thread = _thread()
        try:
            tiles = await asyncio.get_running_loop().run_in_executor(thread, open_tiles, path)
            return cls(tiles, path, thread)
        except BaseException:
            thread.shutdown(wait=False)
            raise

    def __init__(self, tiles: TileSet, path: Path, thread: ThreadPoolExecutor | None = None) -> None:
        self.counts = {"served": 0, "none": 0, "refused": 0, "overrun": 0}
        self._tiles = tiles
        self._path = path
        self._waiting = 0
        self._thread = thread or _thread()
        self._logged: set[str] = set()
        try:
            self._mtime_ns = path.stat().st_mtime_ns
        except OSError as error:
            raise TileFileError(path, error.strerror or str(error)) from None

    def as_dict(self) -> dict[str, Any]:
        """Description for pages. The address changes with the file: a browser keeps tiles."""
        info = self._tiles.info
        return {
            "url": f"/tiles/{self._mtime_ns:x}",
            "min_zoom": info.min_zoom,
            "max_zoom": info.max_zoom,
            "tile_px": info.tile_px,
            "bounds_deg": info.bounds_deg,
            "attribution": info.attribution,
        }

    async def read(self, zoom: int, x: int, y: int) -> tuple[str, bytes] | None:
        """Media type and body of a tile; None: it is not in the file. Raises TilesBusyError; TileRefusedError for one
        that cannot be read or is not drawn."""
        if not is_tile(zoom, x, y):
            return None
        if self._waiting >= MAX_WAITING:
            self.counts["overrun"] += 1
            raise TilesBusyError
        self._waiting += 1
        try:
            loop = asyncio.get_running_loop()
            found = await loop.run_in_executor(self._thread, self._read, zoom, x, y)
        except TileFileError as error:
            self._refuse(str(error), zoom, x, y)
            raise TileRefusedError("not readable") from None
        except TileRefusedError as error:
            self._refuse(str(TileFileError(self._path, f"a tile is {error}")), zoom, x, y)
            raise
        finally:
            self._waiting -= 1
        self.counts["none" if found is None else "served"] += 1
        return found

    def _read(self, zoom: int, x: int, y: int) -> tuple[str, bytes] | None:
        body = self._tiles.read(zoom, x, y)
        return None if body is None else (picture_type(body)[0], body)

    def _refuse(self, why: str, zoom: int, x: int, y: int) -> None:
        self.counts["refused"] += 1
        if why not in self._logged and len(self._logged) < MAX_REASONS:
            self._logged.add(why)
            _log.warning("a tile of the map is not drawn", reason=why, tile=f"{zoom}/{x}/{y}")

    def close(self) -> None:
        self._thread.shutdown(wait=True, cancel_futures=True)
        self._tiles.close()
