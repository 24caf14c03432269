"""Tiles of a PMTiles file, version 3 (specification 3.4): a header, directories of tile ids, and the tiles.

    header (127 bytes)   where directories, metadata and tiles are; compressions; zooms; bounds
    root directory       entries: of a tile id, a run of ids with one tile, or a leaf directory
    leaf directories     the same, of what the root has no room for

It is not trusted: what is read of it at once, what it may become when it is decompressed, the entries of a directory,
and the directories kept are bounded. A tile's id is its place along a Hilbert curve through all tiles of all zooms.
"""

from __future__ import annotations

import bisect
import contextlib
import json
import os
import struct
import zlib
from array import array
from collections import OrderedDict
from pathlib import Path
from typing import Any, NamedTuple

from skygcs.config.files import open_regular
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

MAGIC = b"PMTiles"

MAX_DIRECTORY_BYTES, MAX_ENTRIES = 2 << 20, 1 << 16
"""Decompressed. A leaf of the usual writers has 4096 entries, of the whole world's tiles 30,000."""

MAX_METADATA_BYTES = 1 << 20
MAX_DEPTH = 4
"""Directories on the way to a tile; writers make two of them."""
KEPT_LEAVES = 8

_HEADER = struct.Struct("<7sB11Q6B4i")
_COMPRESSIONS = {0: "an unknown compression", 3: "Brotli", 4: "Zstandard"}
_NONE, _GZIP = 1, 2
_TILE_TYPES = {1: "vector tiles (mvt)", 5: "AVIF pictures", 6: "vector tiles (mlt)"}


class _Header(NamedTuple):
    magic: bytes
    version: int
    root_at: int
    root_bytes: int
    metadata_at: int
    metadata_bytes: int
    leaves_at: int
    leaves_bytes: int
    tiles_at: int
    tiles_bytes: int
    addressed: int
    entries: int
    contents: int
    clustered: int
    compression: int
    tile_compression: int
    tile_type: int
    min_zoom: int
    max_zoom: int
    west_e7: int
    south_e7: int
    east_e7: int
    north_e7: int


class _Directory(NamedTuple):
    """Columns of a directory's entries, by growing tile id; a run of 0 is a leaf directory."""

    ids: array[int]
    runs: array[int]
    sizes: array[int]
    offsets: array[int]


class PmtilesFile:
    """An open PMTiles file. Raises TileFileError."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._leaves: OrderedDict[int, _Directory] = OrderedDict()
        try:
            self._file = open_regular(path)
        except OSError as error:
            raise TileFileError(path, error.strerror or str(error)) from None
        try:
            self._header = self._read_header()
            self._root = self._directory(self._header.root_at, self._header.root_bytes)
            self.info = self._described()
        except BaseException:
            self.close()
            raise

    def read(self, zoom: int, x: int, y: int) -> bytes | None:
        """A tile; None: there is none."""
        wanted = tile_id(zoom, x, y)
        directory = self._root
        for _ in range(MAX_DEPTH):
            n = bisect.bisect_right(directory.ids, wanted) - 1
            if n < 0:
                return None
            if directory.runs[n] > 0:
                return self._tile(directory, n) if wanted < directory.ids[n] + directory.runs[n] else None
            directory = self._leaf(directory.offsets[n], directory.sizes[n])
        raise TileFileError(self._path, f"more than {MAX_DEPTH} directories on the way to a tile")

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._file.close()

    # -- parts of the file

    def _read_header(self) -> _Header:
        header = _Header(*_HEADER.unpack(self._bytes(0, _HEADER.size)))
        if header.magic != MAGIC or header.version != 3:
            raise TileFileError(self._path, f"is PMTiles of version {header.version}; version 3 is read")
        if header.tile_type in _TILE_TYPES:
            kind = _TILE_TYPES[header.tile_type]
            raise TileFileError(self._path, f"holds {kind}; only pictures are drawn: png, jpg or webp")
        for what, compression in (("directories", header.compression), ("tiles", header.tile_compression)):
            if compression not in (_NONE, _GZIP) and not (what == "tiles" and compression == 0):
                name = _COMPRESSIONS.get(compression, f"compression {compression}")
                raise TileFileError(self._path, f"its {what} have {name}; none and gzip are read")
        return header

    def _described(self) -> TileSetInfo:
        header = self._header
        least, most = zooms_of(self._path, header.min_zoom, header.max_zoom)
        try:
            first = self._first_tile(self._root)
            if first is None:
                raise TileFileError(self._path, "has no tiles")
            _, tile_px = picture_type(first)
        except TileRefusedError as error:
            raise TileFileError(self._path, f"its first tile is {error}") from None
        bounds = bounds_of([e7 / 1e7 for e7 in (header.west_e7, header.south_e7, header.east_e7, header.north_e7)])
        return TileSetInfo(least, most, tile_px, bounds, attribution_of(self._metadata().get("attribution")))

    def _metadata(self) -> dict[str, Any]:
        """The file's own words; {} where they are no JSON, which only costs the attribution."""
        header = self._header
        try:
            packed = self._bytes(header.metadata_at, min(header.metadata_bytes, MAX_METADATA_BYTES))
            told = json.loads(self._unpacked(packed, header.compression, MAX_METADATA_BYTES))
        except (ValueError, RecursionError, TileFileError):
            return {}
        return told if isinstance(told, dict) else {}

    def _first_tile(self, directory: _Directory) -> bytes | None:
        for _ in range(MAX_DEPTH):
            if not directory.ids:
                return None
            if directory.runs[0] > 0:
                return self._tile(directory, 0)
            directory = self._leaf(directory.offsets[0], directory.sizes[0])
        return None

    def _tile(self, directory: _Directory, n: int) -> bytes:
        size = directory.sizes[n]
        if size > MAX_TILE_BYTES:
            raise TileRefusedError(f"larger than {MAX_TILE_BYTES >> 20} MiB")
        body = self._bytes(self._header.tiles_at + directory.offsets[n], size)
        return self._unpacked(body, self._header.tile_compression or _NONE, MAX_TILE_BYTES)

    def _leaf(self, offset: int, size: int) -> _Directory:
        found = self._leaves.get(offset)
        if found is None:
            found = self._leaves[offset] = self._directory(self._header.leaves_at + offset, size)
            if len(self._leaves) > KEPT_LEAVES:
                self._leaves.popitem(last=False)
        self._leaves.move_to_end(offset)
        return found

    def _directory(self, at: int, size: int) -> _Directory:
        if size > MAX_DIRECTORY_BYTES:
            raise TileFileError(self._path, f"a directory of {size:,} bytes; {MAX_DIRECTORY_BYTES:,} are read")
        packed = self._bytes(at, size)
        try:
            return directory_of(self._unpacked(packed, self._header.compression, MAX_DIRECTORY_BYTES))
        except (ValueError, OverflowError) as error:
            raise TileFileError(self._path, f"a directory cannot be read: {error}") from None

    def _bytes(self, at: int, size: int) -> bytes:
        try:
            data = os.pread(self._file.fileno(), size, at)
        except (OSError, OverflowError, ValueError) as error:
            raise TileFileError(self._path, f"cannot be read: {error}") from None
        if len(data) != size:
            raise TileFileError(self._path, "ends too early: copy it anew")
        return data

    def _unpacked(self, data: bytes, compression: int, most: int) -> bytes:
        if compression == _NONE:
            return data
        unpacker = zlib.decompressobj(wbits=31)
        try:
            found = unpacker.decompress(data, most)
        except zlib.error as error:
            raise TileFileError(self._path, f"gzip: {error}") from None
        if not unpacker.eof:
            raise TileFileError(self._path, f"a part of it is cut off, or larger than {most:,} bytes")
        return found


def tile_id(zoom: int, x: int, y: int) -> int:
    """Its number: tiles of all lower zooms, and its place along the Hilbert curve of its own."""
    number = ((1 << 2 * zoom) - 1) // 3
    side = 1 << zoom
    at = side >> 1
    while at > 0:
        right, low = int(bool(x & at)), int(bool(y & at))
        number += at * at * ((3 * right) ^ low)
        # turn the quarter, so that the curve begins and ends where its neighbours do
        if low == 0:
            if right == 1:
                x, y = side - 1 - x, side - 1 - y
            x, y = y, x
        at >>= 1
    return number


def directory_of(data: bytes) -> _Directory:
    """The entries of a decompressed directory. Raises ValueError, OverflowError."""
    count, at = _varint(data, 0)
    if count > MAX_ENTRIES:
        raise ValueError(f"{count:,} entries; {MAX_ENTRIES:,} are read")
    columns: list[list[int]] = []
    for _ in range(4):
        column = []
        for _ in range(count):
            value, at = _varint(data, at)
            column.append(value)
        columns.append(column)
    steps, runs, sizes, places = columns
    # ids are differences; a place of 0 follows the entry before it, others are one more than the offset
    ids, offsets, last = array("Q"), array("Q"), 0
    for n, step in enumerate(steps):
        last += step
        ids.append(last)
        offsets.append(offsets[n - 1] + sizes[n - 1] if places[n] == 0 and n > 0 else places[n] - 1)
    return _Directory(ids, array("Q", runs), array("Q", sizes), offsets)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, the low ones first, and where it ends."""
    value = shift = 0
    while True:
        if at >= len(data) or shift > 63:
            raise ValueError("it is cut off")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
