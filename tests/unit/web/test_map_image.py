"""The image beneath the view: a real image, pinned by two points that say something."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.errors import SkygcsError
from skygcs.web.map_image import parse_points, read_map
from support.table import each

POINTS = [[0, 0, 43.78, -79.47], [1000, 500, 43.77, -79.46]]


def test_an_image_and_its_points(tmp_path: Path) -> None:
    path = tmp_path / "field.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\nrest")
    image = read_map(path, parse_points(["0,0,43.78,-79.47", "1000,500,43.77,-79.46"]))
    assert image.content_type == "image/png"
    assert image.as_dict()["points"][1] == {"x_px": 1000.0, "y_px": 500.0, "lat_deg": 43.77, "lon_deg": -79.46}


@each(
    "points",
    [
        [],
        POINTS[:1],
        [*POINTS, POINTS[0]],
        [[0, 0, 43.78], POINTS[1]],
        [[0, 0, 43.78, -79.47], [3, 3, 43.77, -79.46]],
        [[0, 0, 43.78, -79.47], [500, 3, 43.78, -79.47]],
        [[0, 0, 91, -79.47], POINTS[1]],
        [[0, float("nan"), 43.78, -79.47], POINTS[1]],
    ],
)
def test_points_that_pin_nothing_are_refused(tmp_path: Path, points: list[list[float]]) -> None:
    path = tmp_path / "field.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\nrest")
    with pytest.raises(SkygcsError):
        read_map(path, points)


def test_what_is_no_picture_is_refused(tmp_path: Path) -> None:
    svg = tmp_path / "field.png"
    svg.write_bytes(b"<svg onload='alert(1)'/>")
    with pytest.raises(SkygcsError, match="neither PNG nor JPEG"):
        read_map(svg, POINTS)
    with pytest.raises(SkygcsError):
        read_map(tmp_path, POINTS)
    with pytest.raises(SkygcsError):
        read_map(Path("/dev/zero"), POINTS)
    with pytest.raises(SkygcsError, match="X,Y,LAT,LON"):
        parse_points(["a,b"])
