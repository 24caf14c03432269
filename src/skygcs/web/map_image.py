"""The image beneath the fleet view, pinned to the ground by two points."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from skygcs.config.files import open_regular
from skygcs.errors import SkygcsError

MAX_IMAGE_BYTES = 32 << 20
"""An aerial picture of 8000 x 8000 pixels as JPEG is some 20 MB; the page keeps it decoded."""

LEAST_APART_PX = 10.0
"""Nearer points give no direction."""

SIGNATURES = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"))
"""No SVG, which can hold scripts."""


@dataclass(frozen=True, slots=True)
class MapPoint:
    """A pixel of the image (from its upper left corner) and where on Earth it is."""

    x_px: float
    y_px: float
    lat_deg: float
    lon_deg: float


@dataclass(frozen=True, slots=True)
class MapImage:
    """An image that was read, and its two points."""

    body: bytes
    content_type: str
    points: tuple[MapPoint, MapPoint]

    def as_dict(self) -> dict[str, Any]:
        return {"url": "/map", "points": [asdict(point) for point in self.points]}


def read_map(path: Path, points: Sequence[Sequence[float]]) -> MapImage:
    """Read the image. ``points``: two of [x_px, y_px, lat_deg, lon_deg]. Raises SkygcsError."""
    if len(points) != 2 or any(len(point) != 4 or not all(map(math.isfinite, point)) for point in points):
        raise SkygcsError(f"map {path}: give two points, each [x_px, y_px, lat_deg, lon_deg]")
    first, second = (MapPoint(*map(float, point)) for point in points)
    if math.dist((first.x_px, first.y_px), (second.x_px, second.y_px)) < LEAST_APART_PX:
        raise SkygcsError(f"map {path}: the two points are less than {LEAST_APART_PX:g} pixels apart")
    if (first.lat_deg, first.lon_deg) == (second.lat_deg, second.lon_deg):
        raise SkygcsError(f"map {path}: the two points are at the same place on Earth")
    for point in (first, second):
        if not (abs(point.lat_deg) <= 90 and abs(point.lon_deg) <= 180):
            raise SkygcsError(f"map {path}: {point.lat_deg}, {point.lon_deg} is not a place on Earth")
    try:
        with open_regular(path) as file:
            body = file.read(MAX_IMAGE_BYTES + 1)
    except OSError as error:
        raise SkygcsError(f"map {path}: {error.strerror or error}") from None
    if len(body) > MAX_IMAGE_BYTES:
        raise SkygcsError(f"map {path}: larger than {MAX_IMAGE_BYTES >> 20} MiB")
    content_type = next((kind for signature, kind in SIGNATURES if body.startswith(signature)), None)
    if content_type is None:
        raise SkygcsError(f"map {path}: neither PNG nor JPEG")
    return MapImage(body, content_type, (first, second))


def parse_points(texts: Sequence[str]) -> list[list[float]]:
    """The points of --map-point X,Y,LAT,LON options. Raises SkygcsError."""
    points = []
    for text in texts:
        try:
            points.append([float(part) for part in text.split(",")])
        except ValueError:
            raise SkygcsError(f"map point {text}: give X,Y,LAT,LON, as 120,80,43.7806,-79.4653") from None
    return list(itertools.islice(points, 3))
