"""Files of map tiles for tests: MBTiles by its specification, PMTiles by its authors' package, and pictures."""

from __future__ import annotations

import math
import sqlite3
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

from pmtiles.tile import Compression, TileType, zxy_to_tileid
from pmtiles.writer import Writer

Tiles = Mapping[tuple[int, int, int], bytes]
"""Pictures by zoom, column and row from the north."""


def png(side_px: int, colour: tuple[int, int, int], *, edge: tuple[int, int, int] | None = None) -> bytes:
    """A square picture of one colour, with an edge of 4 pixels in another."""
    rows = bytearray()
    for y in range(side_px):
        rows.append(0)
        for x in range(side_px):
            outer = edge is not None and min(x, y, side_px - 1 - x, side_px - 1 - y) < 4
            rows += bytes(edge if outer and edge is not None else colour)
    return _png(side_px, side_px, zlib.compress(bytes(rows)))


def _png(width: int, height: int, packed: bytes) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def claimed_png(width: int, height: int) -> bytes:
    """A picture that says to be so large, and is not."""
    return _png(width, height, zlib.compress(b""))


def tile_at(lat_deg: float, lon_deg: float, zoom: int) -> tuple[int, int, int]:
    """The tile that a place is on."""
    x = (lon_deg / 360 + 0.5) * 2**zoom
    y = (0.5 - math.atanh(math.sin(math.radians(lat_deg))) / math.tau) * 2**zoom
    return zoom, math.floor(x), math.floor(y)


def tiles_about(lat_deg: float, lon_deg: float, zooms: range, reach: int = 3) -> dict[tuple[int, int, int], bytes]:
    """A chessboard of green and sand about a place, in which the tile of the place itself is red."""
    green, sand, red = (
        png(256, colour, edge=(70, 70, 70)) for colour in ((96, 150, 84), (206, 190, 140), (200, 60, 50))
    )
    found = {}
    for zoom in zooms:
        _, x0, y0 = tile_at(lat_deg, lon_deg, zoom)
        for x in range(max(x0 - reach, 0), min(x0 + reach + 1, 2**zoom)):
            for y in range(max(y0 - reach, 0), min(y0 + reach + 1, 2**zoom)):
                found[zoom, x, y] = red if (x, y) == (x0, y0) else green if (x + y) % 2 else sand
    return found


def write_mbtiles(path: Path, tiles: Tiles, **metadata: str) -> Path:
    base = sqlite3.connect(path)
    base.executescript(
        "CREATE TABLE metadata (name text, value text);"
        "CREATE TABLE tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob);"
        "CREATE UNIQUE INDEX tile_index ON tiles (zoom_level, tile_column, tile_row);"
    )
    base.executemany("INSERT INTO metadata VALUES (?, ?)", ({"name": "field", "format": "png"} | metadata).items())
    rows = [(zoom, x, (1 << zoom) - 1 - y, body) for (zoom, x, y), body in tiles.items()]
    base.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", rows)
    base.commit()
    base.close()
    return path


def write_pmtiles(
    path: Path,
    tiles: Tiles,
    kind: TileType = TileType.PNG,
    compression: Compression = Compression.NONE,
    attribution: str = "",
) -> Path:
    zooms = [zoom for zoom, _, _ in tiles]
    with open(path, "wb") as file:
        writer = Writer(file)
        for place, body in sorted((zxy_to_tileid(*place), body) for place, body in tiles.items()):
            writer.write_tile(place, body)
        west, south, east, north = -180, -85, 180, 85
        header = {
            "tile_type": kind,
            "tile_compression": compression,
            "min_zoom": min(zooms, default=0),
            "max_zoom": max(zooms, default=0),
            "min_lon_e7": west * 10**7,
            "min_lat_e7": south * 10**7,
            "max_lon_e7": east * 10**7,
            "max_lat_e7": north * 10**7,
            "center_zoom": 0,
            "center_lon_e7": 0,
            "center_lat_e7": 0,
        }
        writer.finalize(header, {"attribution": attribution})
    return path
