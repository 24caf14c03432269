"""Offsets for several vehicles that are sent to one place: they keep their positions relative to each other."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import TypeVar

from skygcs.core.geo import Origin, distance_m, enu_from_geodetic, geodetic_from_enu

K = TypeVar("K")

APART_M = 3.0
"""Two vehicles closer than this, horizontally and in height, may collide by a GPS error."""


def offsets_en_m(places: Mapping[K, tuple[float, float]]) -> dict[K, tuple[float, float]]:
    """East and north offset of each (lat_deg, lon_deg) from their mean, in metres; the offsets sum to zero."""
    if not places:
        return {}
    local_origin = next(iter(places.values()))
    origin = Origin(local_origin[0], local_origin[1], 0.0)
    flat = {key: enu_from_geodetic(lat, lon, 0.0, origin)[:2] for key, (lat, lon) in places.items()}
    east = sum(e for e, _ in flat.values()) / len(flat)
    north = sum(n for _, n in flat.values()) / len(flat)
    return {key: (e - east, n - north) for key, (e, n) in flat.items()}


def moved(lat_deg: float, lon_deg: float, offset_en_m: tuple[float, float]) -> tuple[float, float]:
    """(lat_deg, lon_deg) of a point that many metres east and north of another."""
    lat, lon, _ = geodetic_from_enu(*offset_en_m, 0.0, Origin(lat_deg, lon_deg, 0.0))
    return lat, lon


def too_close(places: Mapping[K, tuple[float, float, float]]) -> tuple[K, K, float] | None:
    """The first two of (lat_deg, lon_deg, alt_amsl_m) that are too close, and how many metres apart across."""
    for (a, here), (b, there) in itertools.combinations(places.items(), 2):
        if abs(here[2] - there[2]) < APART_M and (across_m := distance_m(*here[:2], *there[:2])) < APART_M:
            return a, b, across_m
    return None
