"""Raster tiles of the map beneath the fleet view: what a file of them holds, and which pictures are drawn.

Tiles are those of Web Mercator (EPSG:3857) by zoom, column from the west and row from the north ("XYZ"). A picture is
known by its first bytes, never by its name, and drawn only within limits: a browser keeps it decoded.
"""

from __future__ import annotations

import html
import re
from dataclasses import dataclass
from typing import Any, Protocol

from skygcs.errors import SkygcsError

MAX_TILE_BYTES = 1 << 20
"""A photograph of 512 x 512 pixels is some 100 kB as JPEG, 500 kB as PNG."""

MAX_TILE_PX = 1024
"""Decoded 4 MB. Usual are 256 and 512."""

MAX_ZOOM = 24
"""Tiles of this zoom are less than 2.4 m wide."""

MAX_ATTRIBUTION = 200
"""Characters of it that are shown."""

KEY = "web.tiles"

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_GZIP = b"\x1f\x8b"

_SIZES = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
"""Markers of JPEG that give the size: ITU-T T.81, table B.1, start of frame."""


class TileFileError(SkygcsError):
    """A file of tiles that cannot be used, or one that cannot be read any more; names the file and the key."""

    def __init__(self, path: Any, what: str) -> None:
        super().__init__(f"{KEY} {path}: {what}")


class TileRefusedError(Exception):
    """A single tile that is not drawn; the text says why."""


@dataclass(frozen=True, slots=True)
class TileSetInfo:
    """Contents of a file. ``tile_px``: pixels across one tile. ``bounds_deg``: west, south, east, north, if known."""

    min_zoom: int
    max_zoom: int
    tile_px: int
    bounds_deg: tuple[float, float, float, float] | None
    attribution: str


class TileSet(Protocol):
    """An open file of tiles. `read` blocks; one thread at a time."""

    info: TileSetInfo

    def read(self, zoom: int, x: int, y: int) -> bytes | None:
        """A tile as it is in the file; None: there is none. Raises TileFileError, TileRefusedError."""

    def close(self) -> None: ...


def is_tile(zoom: int, x: int, y: int) -> bool:
    """True if there is such a tile on Earth, at a zoom that is used."""
    return 0 <= zoom <= MAX_ZOOM and 0 <= x < 1 << zoom and 0 <= y < 1 << zoom


def zooms_of(path: Any, least: Any, most: Any) -> tuple[int, int]:
    """The zooms of a file as it gives them. Raises TileFileError."""
    if not (isinstance(least, int) and isinstance(most, int) and 0 <= least <= most):
        raise TileFileError(path, f"zooms {least} to {most} are not possible; make the tiles again")
    if least > MAX_ZOOM:
        raise TileFileError(path, f"its zooms begin at {least}; up to {MAX_ZOOM} are drawn")
    return least, min(most, MAX_ZOOM)


def bounds_of(numbers: Any) -> tuple[float, float, float, float] | None:
    """West, south, east, north in degrees; None for what is no area."""
    try:
        west, south, east, north = (float(number) for number in numbers)
    except (TypeError, ValueError):
        return None
    if not (-180 <= west < east <= 180 and -90 <= south < north <= 90):
        return None
    return west, south, east, north


def attribution_of(text: Any) -> str:
    """Credit line of the tiles as plain text."""
    if not isinstance(text, str):
        return ""
    return " ".join(html.unescape(re.sub(r"<[^<>]*>", " ", text[: 10 * MAX_ATTRIBUTION])).split())[:MAX_ATTRIBUTION]


def picture_type(body: bytes) -> tuple[str, int]:
    """Media type and width in pixels of a tile. Raises TileRefusedError for what is not drawn."""
    if len(body) > MAX_TILE_BYTES:
        raise TileRefusedError(f"larger than {MAX_TILE_BYTES >> 20} MiB")
    if body.startswith(_GZIP):
        raise TileRefusedError("a vector tile, as it seems; only pictures are drawn (png, jpg, webp)")
    content_type, size = _size_of(body)
    if size is None:
        raise TileRefusedError(f"a {content_type} without a size" if content_type else "neither PNG, JPEG nor WebP")
    if not all(0 < side <= MAX_TILE_PX for side in size):
        raise TileRefusedError(f"{size[0]} x {size[1]} pixels; at most {MAX_TILE_PX} x {MAX_TILE_PX} are drawn")
    return content_type, size[0]


def _size_of(body: bytes) -> tuple[str, tuple[int, int] | None]:
    if body.startswith(_PNG):
        known = len(body) >= 24 and body[12:16] == b"IHDR"
        return "image/png", (_big(body[16:20]), _big(body[20:24])) if known else None
    if body.startswith(_JPEG):
        return "image/jpeg", _jpeg_size(body)
    if body[:4] == b"RIFF" and body[8:12] == b"WEBP":
        return "image/webp", _webp_size(body)
    return "", None


def _jpeg_size(body: bytes) -> tuple[int, int] | None:
    """Width and height of the frame's header, after the segments before it."""
    at = 2
    while at + 9 <= len(body):
        if body[at] != 0xFF:
            return None
        marker = body[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
        elif marker in _SIZES:
            return _big(body[at + 7 : at + 9]), _big(body[at + 5 : at + 7])
        else:
            at += 2 + max(_big(body[at + 2 : at + 4]), 2)
    return None


def _webp_size(body: bytes) -> tuple[int, int] | None:
    """Width and height of the first chunk: lossy, lossless, or the extended header (RFC 9649)."""
    kind = body[12:16]
    if len(body) < 30:
        return None
    if kind == b"VP8 " and body[23:26] == b"\x9d\x01\x2a":
        return _little(body[26:28]) & 0x3FFF, _little(body[28:30]) & 0x3FFF
    if kind == b"VP8L" and body[20] == 0x2F:
        bits = _little(body[21:25])
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X":
        return _little(body[24:27]) + 1, _little(body[27:30]) + 1
    return None


def _big(data: bytes) -> int:
    return int.from_bytes(data, "big")


def _little(data: bytes) -> int:
    return int.from_bytes(data, "little")
